//! What can go wrong with faces. Messages name what, where and the remedy.

/// Errors of head models, landmark networks and the tracker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FaceError {
    /// A head model's parts contradict one another.
    #[error("head model `{name}`: {reason}")]
    Head {
        /// The model's name.
        name: String,
        /// What contradicts what.
        reason: String,
    },
    /// The installable head model is not there, or damaged.
    #[error(transparent)]
    HeadNotInstalled(Box<crate::models::ModelsError>),
    /// A user's head file cannot be read.
    #[error(
        "{}: {reason}; give FLAME 2020 or 2023 as .pkl or .npz, with its landmark embedding as .npz or .npy, \
         or a head file of Heartian's", path.display()
    )]
    HeadFile {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A parameter vector is longer than the basis it multiplies.
    #[error("{what} has {found} coefficients but the head model `{name}` has only {expected}")]
    Coefficients {
        /// Which vector.
        what: &'static str,
        /// The model's name.
        name: String,
        /// Length of the basis.
        expected: usize,
        /// Length found.
        found: usize,
    },
    /// The image the landmarks live in has no area.
    #[error("the observations' image is {width}×{height} pixels; both sides must be at least 1")]
    ImageSize {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
    },
    /// Observations of a clip whose arrays contradict one another.
    #[error("observations: {0}")]
    Observations(String),
    /// A landmark's position or weight is not a number, or its weight is negative.
    #[error("frame {frame}, landmark {landmark}: {what} is {value}; drop that landmark instead of passing it on")]
    Landmark {
        /// Frame number.
        frame: usize,
        /// Landmark number in the MediaPipe mesh.
        landmark: u32,
        /// `x`, `y` or `weight`.
        what: &'static str,
        /// The value found.
        value: f32,
    },
    /// No frame shows a face.
    #[error("no face in any of the {frames} frames; check that the clip shows one frontal face larger than 64 pixels")]
    NoFace {
        /// Number of frames looked at.
        frames: usize,
    },
    /// There are faces, but too few landmarks in each to fix a pose.
    #[error(
        "the best frame has {found} landmarks that the head model `{name}` knows, and {needed} are needed; \
         give denser landmarks (the 468-point face mesh) or another head model"
    )]
    TooFewLandmarks {
        /// The model's name.
        name: String,
        /// Most usable landmarks in any frame.
        found: usize,
        /// Least number accepted.
        needed: usize,
    },
    /// The fit did not reach a finite solution.
    #[error("{stage}: the fit diverged at frame {frame}; the landmarks there cannot be of one face, remove that frame")]
    Diverged {
        /// The stage of the tracker.
        stage: &'static str,
        /// Frame number.
        frame: usize,
    },
    /// An option is out of its range.
    #[error("tracker option `{name}` is {value}; it must be {range}")]
    Option {
        /// The option's name.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What is accepted.
        range: &'static str,
    },
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
}
