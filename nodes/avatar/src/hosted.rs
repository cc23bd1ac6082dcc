//! The engine's context as the host of a long computation.

use std::ops::ControlFlow;

use heartian_graph::Context;
use heartian_space::{Host, Progress};

/// Reports, and keeps states, under the key of the running node.
pub(crate) struct Hosted<'a>(pub &'a Context);

impl Host for Hosted<'_> {
    fn progress(&mut self, report: Progress) -> ControlFlow<()> {
        self.0.progress(report.step, report.total, report.metric)
    }

    fn resume(&mut self) -> Option<Vec<u8>> {
        self.0.resume()
    }

    fn checkpoint(&mut self, state: &mut dyn FnMut() -> Option<Vec<u8>>) {
        self.0.checkpoint(state);
    }
}
