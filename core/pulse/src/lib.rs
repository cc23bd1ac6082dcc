//! The pulse: cardiac phase, two-Gaussian waveform, residual network, losses and stage-2 fitting (paper, Methods and
//! Optimization). It sees the renderer only as a linear operator on albedo, plain data, and knows no Gaussians.
//!
//! Phase is in radians, 0 at the systolic peak; offsets are in linear green albedo; all fitting is f64 except the
//! network, which is f32 with an f64 twin. Everything is deterministic at any thread count.

mod adam;
mod error;
mod fit;
pub mod losses;
pub mod numeric;
mod phase;
mod pulse;
pub mod reference;
pub mod render_loss;
pub mod residual;
mod residual_fit;
mod waveform;

pub use adam::Schedule;
pub use error::PulseError;
pub use fit::{FitReport, PhaseOptions, PhaseRates, Scene, Start, Watch, fit_phase};
pub use phase::{Parameterization, Phase, PhaseGradient};
pub use pulse::{Pulse, Strength, modulation_from_fundamental};
pub use reference::{Prescription, Reference};
pub use residual_fit::{Evaluation, ResidualOptions, evaluate_all, fit_residual, mean_offsets};
pub use waveform::{PenaltyWeights, Waveform, WaveformGradient};

#[cfg(test)]
mod tests;
