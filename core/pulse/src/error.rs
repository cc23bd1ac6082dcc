//! What can be wrong with a pulse, its inputs or its fitting; each message names what, where and the remedy.

/// Errors of the pulse crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PulseError {
    /// Two inputs disagree in length.
    #[error("{what} holds {found} values where {expected} were expected; pass arrays of one clip")]
    Length {
        /// The array.
        what: &'static str,
        /// Wanted length.
        expected: usize,
        /// Found length.
        found: usize,
    },
    /// The clip is too short to carry a heartbeat.
    #[error(
        "{frames} frames over {seconds:.2} s are too few for a pulse; use at least {needed} frames and {needed_seconds:.1} s"
    )]
    Short {
        /// Frames given.
        frames: usize,
        /// Time they span.
        seconds: f64,
        /// Frames needed.
        needed: usize,
        /// Time needed.
        needed_seconds: f64,
    },
    /// No skin Gaussians to modulate.
    #[error("no skin Gaussian to modulate; raise the skin selector's distance threshold")]
    NoSkin,
    /// The supplied PPG does not vary or has no beats.
    #[error("the supplied PPG carries no heartbeat ({0}); supply another recording or prescribe `heart_rate_bpm`")]
    NoBeats(String),
    /// A parameter is outside its range.
    #[error("`{name}` is {value}; it must lie in {range}")]
    Parameter {
        /// The parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The permitted range, in words.
        range: &'static str,
    },
    /// A heart rate the frame rate cannot carry.
    #[error(
        "a heart rate of {bpm:.1} bpm needs more than {needed:.1} frames/s but the clip has {found:.1}; lower the rate or use more frames a second"
    )]
    Undersampled {
        /// Prescribed rate.
        bpm: f64,
        /// Least frame rate, four frames a beat.
        needed: f64,
        /// The clip's.
        found: f64,
    },
    /// A value is not finite.
    #[error("{what}: value {index} is {value}; remove or interpolate it first")]
    NotFinite {
        /// The array.
        what: &'static str,
        /// First offending index.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// A renderer that was handed in failed.
    #[error("the renderer refused: {0}")]
    Renderer(String),
    /// A file that holds no pulse.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
    /// A file that cannot be read.
    #[error(transparent)]
    Csv(#[from] heartian_space::CsvError),
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// Plain data refused.
    #[error(transparent)]
    Space(#[from] heartian_space::SpaceError),
    /// Signal processing refused.
    #[error(transparent)]
    Signal(#[from] heartian_signal::SignalError),
}

/// Refuses values that are not finite.
pub(crate) fn check_finite(what: &'static str, values: &[f64]) -> Result<(), PulseError> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(PulseError::NotFinite { what, index, value: values[index] }),
        None => Ok(()),
    }
}

/// Refuses arrays of the wrong length.
pub(crate) fn check_length(what: &'static str, expected: usize, found: usize) -> Result<(), PulseError> {
    if expected == found { Ok(()) } else { Err(PulseError::Length { what, expected, found }) }
}
