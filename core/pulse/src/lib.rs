//! The pulse: cardiac phase, two-Gaussian waveform, residual network, losses and stage-2 fitting (paper, Methods and
//! Optimization). It sees the renderer only as a linear operator on albedo, plain data, and knows no Gaussians.
//!
//! Phase is in radians, 0 at the systolic peak; offsets are in linear green albedo; all fitting is f64 except the
//! network, which is f32 with an f64 twin. Everything is deterministic at any thread count.
//!
//! Differs from the paper, with the effect measured (`tests/table.rs`, `tests/stage2.rs` and `heartian bench pulse` print
//! it again):
//! - each of the 60,000 iterations sees all frames, where the paper's sees one for L_base: 53 µs instead of a rendered
//!   frame. Clips of more than 600 frames take fewer. A twentieth of them (`fast`) loses a little waveform: Pearson of the
//!   fundamental 0.9995 against 0.9998 on a made-up 20 s, 0.958 against 0.965 and 0.988 against 0.996 on real PPG;
//! - phase and waveform start from the reference's beats and average beat; the paper does not say from where. From the mean
//!   rate (`to_the_letter`) a rate that wanders loses its turn: Pearson 0.984 on a wandering 20 s against 0.9997, 0.22 on
//!   10 min against 0.9992, and a wrong rate on a real PPG (53 bpm off);
//! - the modulation is centred, so that the mean colour stays the baseline's (without, POS reads the same, and the picture
//!   gains or loses with whether the avatar is too dark or too bright: 0.0001 to 0.0027 dB on four recordings against
//!   0.0013 to 0.0025); A is learnt as a factor of its start,
//!   between a floor and a ceiling, and bounded in 8-bit levels, since L_base alone lets it vanish, as it does here too
//!   wherever it is free: A always ends at its floor;
//! - L_base comes from a linear map of albedo to cells of the picture, as a quadratic bound of the L1 of sRGB green, exact
//!   at zero modulation, without D-SSIM: fitted to the end, the modulation is within 0.1 % of the one that rasterising
//!   every step with all of L_base gives;
//! - the network's blocks have one linear map each; its training losses see a Gaussian of each of four skin patches a
//!   step, 300 steps with the paper's decay laid onto them (mean over all 6,000 Gaussians afterwards: Pearson ≥ 0.999 on
//!   real PPG);
//! - θ_POS has its constant offset to the reference removed and is weighed by how well both keep step; it is dropped when
//!   they do not, as when the pulse is another person's. On four recordings of the cohort it pulls the phase to an rms of
//!   0.042 rad from the beats where L_phase alone leaves 0.019 (Pearson of the fundamental 0.9986 against 0.9988); rate and
//!   waveform after the residual stay;
//! - smoothness priors act at any frame rate as λ = 100 does at 30 Hz: there nothing differs, and 7 to 60 frames/s are
//!   read to 0.3 bpm (`tests/broken.rs`);
//! - spikes of the supplied PPG are bridged before it becomes the target: 0.2 s at fifty times a beat's height costs
//!   0.06 bpm where cutting them off cost more than 0.5 (`tests/hard.rs`).
//!
//! Beyond the paper: an anchored phase, which its last section asks for. Over eight seeds, on five minutes after ten that
//! were fitted (`tests/drift.rs`): with the beats prescribed it drifts 0.0003 ± 0.0004 rad/min, with the video's pulse
//! alone 0.019 ± 0.010; with nothing known 0.054 ± 0.040 against the cumulative's 0.067 ± 0.026, at an rms error of 0.56
//! against 1.06 rad. Of intervals that vary freely nothing is foreseen by anyone (2.6 rad/min both); what is then to be
//! expected, σ·√n, is told with the phase.

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
pub use phase::{Anchors, Continued, Known, Parameterization, Phase, PhaseGradient};
pub use pulse::{Pulse, Strength, modulation_from_fundamental};
pub use reference::{Prescription, PulseFile, Reference, Rhythm};
pub use render_loss::{BaseLoss, FrozenRenderer};
pub use residual_fit::{Evaluation, Precision, ResidualOptions, evaluate_all, fit_residual, mean_offsets};
pub use waveform::{PenaltyWeights, Waveform, WaveformGradient, Waves};

#[cfg(test)]
mod tests;
