//! The pulse: cardiac phase, two-Gaussian waveform, residual network, losses and stage-2 fitting (paper, Methods and
//! Optimization). It sees the renderer only as a linear operator on albedo, plain data, and knows no Gaussians.
//!
//! Phase is in radians, 0 at the systolic peak; offsets are in linear green albedo; all fitting is f64 except the
//! network, which is f32 with an f64 twin. Everything is deterministic at any thread count.
//!
//! Differs from the paper, with the effect measured (`tests/table.rs` prints it again):
//! - each iteration sees all frames at once and the decays are laid onto 3,000 of them instead of 60,000 (20 s clips:
//!   Pearson of the fundamental 0.9995 against 0.9998, real wrist PPG 0.988 against 0.996; a twentieth of the time);
//! - phase and waveform start from the reference's beats and average beat; from the mean rate, a rate that wanders loses
//!   its turn (Pearson 0.98 on a wandering 20 s clip, 0.22 after 10 min, against 0.9995);
//! - the modulation is centred, so that the mean colour stays the baseline's; A is learnt as a factor of its start,
//!   between a floor and a ceiling, and bounded in 8-bit levels, since L_base alone would let it vanish;
//! - L_base is a quadratic bound of the L1 of sRGB green over pooled cells, exact at zero modulation, without D-SSIM;
//! - the network's blocks have one linear map each; its training losses see a Gaussian of each of four skin patches a
//!   step, 300 steps (mean over all 6,000 Gaussians afterwards: Pearson ≥ 0.999 on real PPG).

mod adam;
mod arrival;
mod error;
mod fit;
mod frame_by_frame;
mod limit;
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
pub use frame_by_frame::{FrameByFrame, RenderFrame};
pub use limit::{KNEE, Limited};
pub use phase::{Anchors, Parameterization, Phase, PhaseGradient};
pub use pulse::{Pulse, Strength, modulation_from_fundamental};
pub use reference::{Prescription, PulseFile, Reference, Rhythm};
pub use render_loss::{BaseLoss, FrozenRenderer};
pub use residual_fit::{Evaluation, Precision, ResidualOptions, evaluate_all, fit_residual, mean_offsets};
pub use waveform::{PenaltyWeights, Waveform, WaveformGradient, Waves};

#[cfg(test)]
mod tests;
