//! What a long computation says of itself while it runs, and what it may ask of whoever runs it.

use std::ops::ControlFlow;

/// One report: `step` of `total` is done, and perhaps a live figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Steps done.
    pub step: u64,
    /// Steps in all; 0 when unknown.
    pub total: u64,
    /// Name and value of a live figure (`psnr_db`).
    pub metric: Option<(&'static str, f64)>,
}

/// Whoever runs a long computation. A closure that takes [`Progress`] is one that keeps no states.
pub trait Host {
    /// Hears a report; `Break` asks to stop.
    fn progress(&mut self, report: Progress) -> ControlFlow<()>;

    /// The last state that an earlier computation on the very same inputs offered, if it was stopped before its end.
    fn resume(&mut self) -> Option<Vec<u8>> {
        None
    }

    /// Takes the state if it is time to keep one; only then is it made.
    fn checkpoint(&mut self, _state: &mut dyn FnMut() -> Option<Vec<u8>>) {}
}

impl<F: FnMut(Progress) -> ControlFlow<()>> Host for F {
    fn progress(&mut self, report: Progress) -> ControlFlow<()> {
        self(report)
    }
}
