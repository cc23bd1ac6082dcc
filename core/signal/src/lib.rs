//! Detrending, band-pass, spectrum, heart rate, SNR, beats, unsupervised rPPG methods and their metrics.
//!
//! Pure functions on `&[f64]` and a sampling rate in hertz; all arithmetic is f64 and deterministic. Times are seconds,
//! rates of beats are bpm, phases are radians with 0 at the systolic peak. A signal that has no answer (empty, too short,
//! not finite, flat, a band above Nyquist) is refused with a [`SignalError`] that names the remedy; nothing panics.

pub mod beats;
pub mod certainty;
mod detrend;
mod error;
mod filter;
pub mod hilbert;
pub mod hrv;
pub mod methods;
pub mod metrics;
mod peaks;
mod protocol;
mod reading;
pub mod regional;
mod spectrum;
pub mod stats;
pub mod trace;

pub use detrend::{Detrender, MAX_LAMBDA, Smoothness, detrend};
pub use error::SignalError;
pub use filter::{Band, Butterworth, bandpass};
pub use methods::Method;
pub use peaks::local_maxima;
pub use protocol::{EvenTrace, HeartRate, Preset, Protocol, estimate, resampled_evenly};
pub use reading::{Reader, WindowRate, pulse_variability};
pub use spectrum::{Resolution, Spectrum, peak_heart_rate_bpm};
