//! What can be wrong with a signal, and the checks every entry makes before it computes.

/// Why a signal could not be processed. Each message names what, where and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SignalError {
    /// There is no sample.
    #[error("{0} is empty; give at least one sample")]
    Empty(&'static str),
    /// Too few samples for the operation.
    #[error("{what} needs at least {needed} samples and got {found}; record longer or sample faster")]
    TooShort {
        /// The operation.
        what: &'static str,
        /// Fewest samples it accepts.
        needed: usize,
        /// Samples given.
        found: usize,
    },
    /// A sample is NaN, infinite or so large (beyond 1e100) that its square is.
    #[error("{what}: sample {index} is {value}, not a usable number; remove or interpolate it first")]
    NotFinite {
        /// The signal.
        what: &'static str,
        /// First offending sample.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// The sampling rate is not a positive finite number, or too high for the spectrum's size.
    #[error("a sampling rate of {rate_hertz} Hz cannot be used; give a rate above 0 and at most {most_hertz} Hz")]
    Rate {
        /// The rate given.
        rate_hertz: f64,
        /// Highest rate accepted here.
        most_hertz: f64,
    },
    /// The pass band does not lie between zero and half the sampling rate.
    #[error(
        "the band {low_hertz}–{high_hertz} Hz does not fit a sampling rate of {rate_hertz} Hz; \
         it must satisfy 0 < low < high < {}",
        rate_hertz / 2.0
    )]
    Band {
        /// Lower edge.
        low_hertz: f64,
        /// Upper edge.
        high_hertz: f64,
        /// Sampling rate.
        rate_hertz: f64,
    },
    /// Nothing varies, so there is no rate, phase or correlation to speak of.
    #[error("{0} does not vary, so it carries no pulse; check that the right trace is connected")]
    Flat(&'static str),
    /// A setting is outside its range.
    #[error("{name} is {value}; it must be {range}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What is accepted.
        range: &'static str,
    },
    /// Two things that belong together have different lengths.
    #[error("{what} holds {found} samples where {expected} were expected")]
    Length {
        /// The signal.
        what: &'static str,
        /// Wanted.
        expected: usize,
        /// Given.
        found: usize,
    },
    /// Times are not strictly increasing and finite.
    #[error("{what}: time {index} ({seconds} s) is not after the one before it, or not finite; sort and deduplicate")]
    Times {
        /// The sequence.
        what: &'static str,
        /// First offending index.
        index: usize,
        /// Its value.
        seconds: f64,
    },
    /// A colour channel is black over a whole window, so it has no relative variation.
    #[error(
        "the {channel} channel's mean is {value} over the window starting at frame {frame}; mask or light the face"
    )]
    Dark {
        /// Red, green or blue.
        channel: &'static str,
        /// Its mean there.
        value: f64,
        /// First frame of the window.
        frame: usize,
    },
    /// No pixel of a frame lies under the matte.
    #[error("frame {frame} has no pixel under the matte; mask the face again or average the whole frame")]
    Masked {
        /// The frame.
        frame: usize,
    },
    /// Fewer beats than the operation needs.
    #[error("found {found} beats where {needed} are needed; the trace is too short or carries no clear pulse")]
    FewBeats {
        /// Beats found.
        found: usize,
        /// Beats needed.
        needed: usize,
    },
}

/// Shorthand of this crate.
pub type Result<T> = std::result::Result<T, SignalError>;

/// Largest magnitude of a sample: squares and their sums stay finite.
const LARGEST: f64 = 1e100;

/// Refuses an empty signal and any sample that is not finite or beyond [`LARGEST`].
pub(crate) fn check_finite(what: &'static str, signal: &[f64]) -> Result<()> {
    if signal.is_empty() {
        return Err(SignalError::Empty(what));
    }
    match signal.iter().position(|value| value.is_nan() || value.abs() > LARGEST) {
        Some(index) => Err(SignalError::NotFinite { what, index, value: signal[index] }),
        None => Ok(()),
    }
}

/// Refuses a signal shorter than `needed`.
pub(crate) fn check_length(what: &'static str, needed: usize, found: usize) -> Result<()> {
    if found < needed { Err(SignalError::TooShort { what, needed, found }) } else { Ok(()) }
}

/// Refuses a rate that is not positive and finite.
pub(crate) fn check_rate(rate_hertz: f64) -> Result<()> {
    let usable = rate_hertz.is_finite() && rate_hertz > 0.0;
    if usable { Ok(()) } else { Err(SignalError::Rate { rate_hertz, most_hertz: f64::MAX }) }
}

/// Refuses times that are not finite and strictly increasing.
pub(crate) fn check_times(what: &'static str, times_seconds: &[f64]) -> Result<()> {
    if times_seconds.is_empty() {
        return Err(SignalError::Empty(what));
    }
    let mut before = f64::NEG_INFINITY;
    for (index, &seconds) in times_seconds.iter().enumerate() {
        if !seconds.is_finite() || seconds <= before {
            return Err(SignalError::Times { what, index, seconds });
        }
        before = seconds;
    }
    Ok(())
}
