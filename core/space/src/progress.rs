//! What a long computation says of itself while it runs.

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
