//! θ_POS: the instantaneous phase of POS on the clip's mean colours (paper, L_pos), as a weak periodicity prior.
//!
//! Differs from the paper in two stated ways. The constant circular offset to θ_gt is removed: POS's phase is shifted by
//! polarity, transit time and filter shape, and pulling toward that shift would only bias the phase. Frames are weighed
//! by how well both phases keep step around them, and the prior is dropped when they do not keep step at all, as when the
//! embedded pulse is prescribed or another person's.

use heartian_signal::hilbert::{circular_offset, instantaneous_phase};
use heartian_signal::methods::{PosWindow, pos_trace};
use heartian_signal::{Band, bandpass, detrend};

use crate::error::{PulseError, check_length};
use crate::losses::DETREND;
use crate::numeric::wrap;

use super::Reference;

/// Half-width of the window in which keeping step is judged, seconds: about eight beats in all.
const JUDGED_SECONDS: f64 = 4.0;
/// Keeping step (resultant length) at which confidence starts; unrelated rhythms reach about 0.35 over eight beats.
const LEAST_STEP: f64 = 0.5;
/// Keeping step over the whole clip below which the prior is dropped.
const LEAST_CLIP_STEP: f64 = 0.3;

/// The weak phase of a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct WeakPhase {
    /// θ_POS aligned to the reference, radians in [−π, π], one a frame.
    pub theta: Vec<f64>,
    /// Weight of each frame, in [0, 1].
    pub confidence: Vec<f64>,
    /// How well the clip keeps step with the reference, in [0, 1].
    pub coherence: f64,
}

/// The weak phase from mean colours (one RGB triple a frame, any positive unit), or `None` when the video's own pulse
/// does not keep step with the one to embed.
///
/// # Errors
/// When the colours do not match the reference's frames, or POS refuses them (black channel, too few frames).
pub fn weak_phase(rgb: &[[f64; 3]], reference: &Reference, window: PosWindow) -> Result<Option<WeakPhase>, PulseError> {
    check_length("the mean colours", reference.len(), rgb.len())?;
    let rate = reference.rate_hertz();
    let trace = detrend(&pos_trace(rgb, rate, window)?, DETREND.lambda(rate))?;
    let band = Band { low_hertz: Band::PAPER.low_hertz, high_hertz: Band::PAPER.high_hertz.min(0.45 * rate) };
    let filtered = bandpass(&trace, rate, band, 1)?;
    if filtered.iter().all(|value| value.abs() < 1e-15) {
        return Ok(None);
    }
    let phase = instantaneous_phase(&filtered)?;
    let (offset, coherence) = circular_offset(&phase, &reference.phase)?;
    if coherence < LEAST_CLIP_STEP {
        return Ok(None);
    }
    let theta: Vec<f64> = phase.iter().map(|phase| wrap(phase - offset)).collect();
    let confidence = keeping_step(&theta, &reference.phase, (JUDGED_SECONDS * rate) as usize);
    Ok(Some(WeakPhase { theta, confidence, coherence }))
}

/// Resultant length in a moving window, mapped to [0, 1].
fn keeping_step(theta: &[f64], reference: &[f64], half: usize) -> Vec<f64> {
    let mut sums = vec![[0.0; 2]];
    let mut sum = [0.0; 2];
    for (theta, reference) in theta.iter().zip(reference) {
        let (sin, cos) = (theta - reference).sin_cos();
        sum = [sum[0] + cos, sum[1] + sin];
        sums.push(sum);
    }
    let step = |t: usize| {
        let (from, to) = (t.saturating_sub(half), (t + half + 1).min(theta.len()));
        let length = (sums[to][0] - sums[from][0]).hypot(sums[to][1] - sums[from][1]) / (to - from) as f64;
        ((length - LEAST_STEP) / (1.0 - LEAST_STEP)).clamp(0.0, 1.0)
    };
    (0..theta.len()).map(step).collect()
}
