//! What can go wrong with recordings. Messages name what, where and the remedy.

use heartian_face::FaceError;
use heartian_space::SpaceError;

/// Errors of readers, mattes and the synthetic recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// An option is out of its range.
    #[error("`{name}` is {value}; it must be {range}")]
    Option {
        /// The option's name.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What is accepted.
        range: &'static str,
    },
    /// The recording asked for does not fit in memory.
    #[error(
        "{frames} frames of {size}×{size} pixels need {gibibytes:.1} GiB; lower `seconds`, `size` or the frame rate"
    )]
    TooLarge {
        /// Number of frames.
        frames: usize,
        /// Side of a frame, pixels.
        size: usize,
        /// Memory for the frames and their matte.
        gibibytes: f64,
    },
    /// A head model or its landmarks are wrong.
    #[error(transparent)]
    Face(#[from] FaceError),
    /// Plain data are wrong.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
}
