//! What nodes take from the machine: the engine's context as the host of a long computation, and a device.

use std::ops::ControlFlow;
use std::sync::Arc;

use heartian_graph::{Context, NodeError};
use heartian_space::{Host, Progress};
use heartian_splat::{Device, Gpu};

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

/// The device that a node's parameter asks for; nothing where that is the CPU.
pub(crate) fn open_gpu(device: Device) -> Result<Option<Arc<Gpu>>, NodeError> {
    Gpu::open(device).map_err(|error| NodeError::from(error).parameter("device"))
}
