//! Settings of the phase fit: the paper's, and fast ones that reach nearly the same place in a twentieth of the steps.

use crate::adam::Schedule;
use crate::error::PulseError;
use crate::losses::LossWeights;
use crate::phase::Parameterization;
use crate::waveform::PenaltyWeights;

/// Frame-level iterations of the paper's second stage (60 epochs of about a thousand frames).
pub const PAPER_STEPS: u32 = 60_000;

/// Where the fit starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Start {
    /// δ from the mean beat rate, the default waveform. A clip whose rate wanders by more than half a beat from its
    /// mean line cannot be followed from here: the circular loss then has a nearer, wrong, turn.
    MeanRate,
    /// δ from the reference's beats, the waveform from the reference at its own phase. Differs from the paper, which
    /// does not state its start; needs no luck at any length.
    #[default]
    Beats,
}

/// Learning rates (paper, Implementation Details).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PhaseRates {
    /// Of the raw increments (of x, y for the direct form).
    pub increments: Schedule,
    /// Of φ₀.
    pub initial: Schedule,
    /// Of A₁, A₂, μ₁, μ₂, σ₁, σ₂.
    pub waveform: [f64; 6],
    /// Of ln(A/A₀). The paper gives 9e-5 for A itself but not its start; a factor has no unit to get wrong.
    pub scale: f64,
}

/// Rates at one moment.
pub(super) struct Rates {
    pub increments: f64,
    pub initial: f64,
    pub waveform: [f64; 6],
    pub scale: f64,
}

impl Default for PhaseRates {
    fn default() -> Self {
        Self {
            increments: Schedule { first: 9e-3, last: 3e-4, steps: 1.0 },
            initial: Schedule { first: 2e-3, last: 5e-4, steps: 1.0 },
            waveform: [3e-4, 3e-4, 8e-4, 1e-3, 6e-4, 2e-3],
            scale: 9e-5,
        }
    }
}

impl PhaseRates {
    /// Rates at a fraction of the fit: schedules here run over [0, 1].
    pub(super) fn at(&self, fraction: f64) -> Rates {
        Rates {
            increments: self.increments.at(fraction),
            initial: self.initial.at(fraction),
            waveform: self.waveform,
            scale: self.scale,
        }
    }
}

/// Settings of [`super::fit_phase`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PhaseOptions {
    /// Cumulative or direct phase.
    pub parameterization: Parameterization,
    /// Where to start.
    pub start: Start,
    /// Full-batch steps, each over all frames.
    pub steps: u32,
    /// Frames × steps beyond which fewer steps are taken: a ten-minute clip holds more beats to learn one waveform from.
    pub most_frame_steps: f64,
    /// Frames up to which the increments' rate is the paper's; a longer clip's shrinks in proportion.
    pub calm_frames: f64,
    /// Learning rates; decays run over the steps taken.
    pub rates: PhaseRates,
    /// λ of the losses.
    pub weights: LossWeights,
    /// λ of the constraints.
    pub penalties: PenaltyWeights,
    /// Peak-to-peak of the fundamental relative to the mean green albedo, in (0, 0.5].
    pub amplitude: f64,
    /// Floor and ceiling of A as factors of its start.
    pub scale_range: [f64; 2],
    /// Bound on the fundamental's peak-to-peak on the picture, 8-bit levels.
    pub most_levels: f64,
    /// Whether the modulation is centred, so that the mean colour stays the baseline's. Off in the paper, whose waveform
    /// is positive; centring takes the mean offset out of the photometric cost and leaves the pulse as it is.
    pub centred: bool,
}

impl Default for PhaseOptions {
    fn default() -> Self {
        Self {
            parameterization: Parameterization::Cumulative,
            start: Start::Beats,
            steps: 3_000,
            most_frame_steps: 12e6,
            calm_frames: 600.0,
            rates: PhaseRates::default(),
            weights: LossWeights::default(),
            penalties: PenaltyWeights::default(),
            amplitude: 0.025,
            scale_range: [0.8, 1.25],
            most_levels: 6.0,
            centred: true,
        }
    }
}

impl PhaseOptions {
    /// The paper's 60,000 iterations, with every rate, decay, weight and constraint it states. Each iteration sees all
    /// frames where the paper's sees one for L_base; clips of more than 600 frames take fewer, so that the work is the
    /// same. What the paper leaves open or this differs in is said, and measured, at the top of the crate.
    pub fn paper() -> Self {
        Self { steps: PAPER_STEPS, most_frame_steps: 600.0 * f64::from(PAPER_STEPS), ..Self::default() }
    }

    /// To the letter where the paper is silent, too: from the mean rate, with a waveform that only adds light, however
    /// long the clip. A clip whose rate wanders loses its turn.
    pub fn to_the_letter() -> Self {
        Self {
            start: Start::MeanRate,
            most_frame_steps: f64::INFINITY,
            calm_frames: f64::INFINITY,
            centred: false,
            ..Self::paper()
        }
    }

    /// Steps taken for a clip of that many frames.
    pub fn steps_for(&self, frames: usize) -> u32 {
        let most = (self.most_frame_steps / frames.max(1) as f64).max(1.0);
        // A float beyond the range of integers becomes the largest one.
        self.steps.min(most as u32)
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// Names the parameter outside its range.
    pub fn check(&self) -> Result<(), PulseError> {
        let refuse = |name, value, range| Err(PulseError::Parameter { name, value, range });
        if !(self.amplitude > 0.0 && self.amplitude <= 0.5) {
            return refuse("amplitude", self.amplitude, "(0, 0.5] of the mean green albedo");
        }
        let [floor, ceiling] = self.scale_range;
        if !(floor > 0.0 && floor <= 1.0 && ceiling >= 1.0 && ceiling.is_finite()) {
            return refuse("scale_range", floor, "floor in (0, 1], ceiling in [1, ∞)");
        }
        if !(self.most_levels > 0.0) {
            return refuse("most_levels", self.most_levels, "above 0 8-bit levels");
        }
        if !(self.most_frame_steps > 0.0) {
            return refuse("most_frame_steps", self.most_frame_steps, "above 0");
        }
        if !(self.calm_frames > 0.0) {
            return refuse("calm_frames", self.calm_frames, "above 0");
        }
        let weights = &self.weights;
        for (name, value) in [
            ("weights.phase", weights.phase),
            ("weights.pos", weights.pos),
            ("weights.mse", weights.mse),
            ("weights.pearson", weights.pearson),
            ("weights.base", weights.base),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return refuse(name, value, "[0, ∞)");
            }
        }
        Ok(())
    }
}
