//! The pulse: cardiac phase, two-Gaussian waveform, residual network, losses and stage-2 fitting (paper, Methods and
//! Optimization). It sees the renderer only as a linear operator on albedo, plain data, and knows no Gaussians.
//!
//! Phase is in radians, 0 at the systolic peak; offsets are in linear green albedo; all fitting is f64 except the
//! network, which is f32 with an f64 twin. Everything is deterministic at any thread count.

mod adam;
mod error;
pub mod losses;
pub mod numeric;
mod phase;
pub mod residual;
pub mod render_loss;
mod waveform;

pub use adam::Schedule;
pub use error::PulseError;
pub use phase::{Parameterization, Phase, PhaseGradient};
pub use waveform::{PenaltyWeights, Waveform, WaveformGradient};
