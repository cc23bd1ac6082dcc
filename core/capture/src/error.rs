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
    /// A video cannot be read.
    #[error(transparent)]
    Video(#[from] crate::video::VideoError),
    /// A recording of a data set cannot be read.
    #[error(transparent)]
    DataSet(#[from] crate::dataset::DataSetError),
    /// The networks are not installed, or damaged.
    #[error(transparent)]
    Models(#[from] heartian_face::models::ModelsError),
    /// A network does not run.
    #[error(transparent)]
    Net(#[from] heartian_face::nets::NetError),
    /// No frame of a recording shows a face.
    #[error("{}: no face in any of its {frames} frames; record one frontal, lit face larger than 64 pixels, or choose another part with `start_seconds`", source_path.display())]
    NoFace {
        /// The recording.
        source_path: std::path::PathBuf,
        /// Number of frames looked at.
        frames: usize,
    },
    /// A folder of masks does not fit its clip.
    #[error("{}: {reason}; give one PNG mask a frame, of the clip's size", folder.display())]
    Masks {
        /// The folder.
        folder: std::path::PathBuf,
        /// What does not fit.
        reason: String,
    },
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
}
