//! Phase held by anchors: absolute, so that no error adds up, and defined at any time, not only at fitted frames.
//!
//! An anchor is a moment and its phase: each systolic peak, and the first and last fitted frame. Between anchors phase is
//! linear in time, as the paper's θ_gt is between peaks; each anchor carries a learnt correction of less than π/4, so
//! phase never runs backwards. Beyond the anchors a rate model goes on: the rate of the nearest minute, over which slow
//! and respiratory variation average out, returning to the mean of all with a time constant of a minute, integrated
//! exactly.

use std::f64::consts::{FRAC_PI_4, TAU};

use crate::numeric::wrap;

/// Bound on an anchor's correction, radians.
const REACH: f64 = FRAC_PI_4;
/// Anchors that make up the local rate, and how long it is believed, seconds.
const LOCAL_BEATS: usize = 64;
const BELIEVED_SECONDS: f64 = 60.0;
/// Anchors closer than this to their neighbour are merged, seconds.
const LEAST_GAP_SECONDS: f64 = 1e-6;
/// Least confidence of a weak phase that may set an anchor.
const LEAST_CONFIDENCE: f64 = 0.5;

/// The anchors of a phase and the frames it is asked at.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Anchors {
    /// Moments, seconds, increasing; at least two, none for other parameterisations.
    pub seconds: Vec<f64>,
    /// Phase there before correction, unwrapped, radians, increasing.
    pub phase: Vec<f64>,
    /// Frame times, seconds, increasing.
    pub frame_seconds: Vec<f64>,
}

/// Where a moment lies among the anchors.
enum Place {
    /// Between anchor k and k + 1, with the share of the latter.
    Between(usize, f64),
    /// So many seconds before the first (negative) or after the last.
    Outside(f64),
}

impl Anchors {
    /// Anchors of a phase known at frames of increasing time: where it passes a whole turn, and at both ends. Where the
    /// phase does not rise no anchor is set; with a single one phase stands still.
    pub fn through(frame_seconds: &[f64], unwrapped: &[f64]) -> Self {
        let mut anchors = Self { frame_seconds: frame_seconds.to_vec(), ..Self::default() };
        let last = frame_seconds.len().min(unwrapped.len()).saturating_sub(1);
        for k in 0..=last {
            if k == 0 || k == last {
                anchors.push(frame_seconds[k], unwrapped[k]);
            }
            if k < last && unwrapped[k + 1] > unwrapped[k] {
                let turn = (unwrapped[k] / TAU).floor() + 1.0;
                let share = (turn * TAU - unwrapped[k]) / (unwrapped[k + 1] - unwrapped[k]);
                if share <= 1.0 {
                    anchors.push(frame_seconds[k] + share * (frame_seconds[k + 1] - frame_seconds[k]), turn * TAU);
                }
            }
        }
        anchors
    }

    fn push(&mut self, seconds: f64, phase: f64) {
        let later = self.seconds.last().is_none_or(|&last| seconds > last + LEAST_GAP_SECONDS);
        if later && self.phase.last().is_none_or(|&last| phase > last) {
            self.seconds.push(seconds);
            self.phase.push(phase);
        }
    }

    fn place(&self, seconds: f64) -> Place {
        let last = self.seconds.len().saturating_sub(1);
        if last == 0 {
            return Place::Outside(0.0);
        }
        if seconds < self.seconds[0] {
            return Place::Outside(seconds - self.seconds[0]);
        }
        if seconds > self.seconds[last] {
            return Place::Outside(seconds - self.seconds[last]);
        }
        let after = self.seconds.partition_point(|&anchor| anchor <= seconds).clamp(1, last);
        let (from, to) = (self.seconds[after - 1], self.seconds[after]);
        Place::Between(after - 1, (seconds - from) / (to - from))
    }

    /// Mean rate over some anchors, radians a second.
    fn rate(&self, from: usize, to: usize) -> f64 {
        (self.phase[to] - self.phase[from]) / (self.seconds[to] - self.seconds[from])
    }

    /// Phase gained in `seconds` beyond the first (negative) or last anchor.
    fn beyond(&self, seconds: f64) -> f64 {
        let last = self.seconds.len().saturating_sub(1);
        if last == 0 {
            return 0.0;
        }
        let near = LOCAL_BEATS.min(last);
        let local = if seconds < 0.0 { self.rate(0, near) } else { self.rate(last - near, last) };
        let settled = BELIEVED_SECONDS * (1.0 - (-seconds.abs() / BELIEVED_SECONDS).exp());
        self.rate(0, last) * seconds + (local - self.rate(0, last)) * settled.copysign(seconds)
    }

    /// Unwrapped phase at any moment, with the anchors' corrections from `raw`.
    pub fn at(&self, raw: &[f64], seconds: f64) -> f64 {
        if self.seconds.is_empty() {
            return 0.0;
        }
        let corrected = |k: usize| self.phase[k] + correction(raw[k]);
        match self.place(seconds) {
            Place::Between(k, share) => corrected(k) + share * (corrected(k + 1) - corrected(k)),
            Place::Outside(by) => corrected(if by < 0.0 { 0 } else { self.seconds.len() - 1 }) + self.beyond(by),
        }
    }

    /// θ at the frames, in [−π, π].
    pub fn theta(&self, raw: &[f64]) -> Vec<f64> {
        self.frame_seconds.iter().map(|&seconds| wrap(self.at(raw, seconds))).collect()
    }

    /// From ∂L/∂θ at the frames to the corrections' raw values.
    pub fn theta_vjp(&self, raw: &[f64], theta_gradient: &[f64]) -> Vec<f64> {
        let mut pulled = vec![0.0; raw.len()];
        for (&seconds, gradient) in self.frame_seconds.iter().zip(theta_gradient) {
            match self.place(seconds) {
                Place::Between(k, share) => {
                    pulled[k] += (1.0 - share) * gradient;
                    pulled[k + 1] += share * gradient;
                }
                Place::Outside(by) => pulled[if by < 0.0 { 0 } else { raw.len() - 1 }] += gradient,
            }
        }
        pulled.iter().zip(raw).map(|(gradient, raw)| gradient * (1.0 - (raw / REACH).tanh().powi(2))).collect()
    }

    /// Sets anchors after the last one from a weak phase (radians, wrapped, aligned to this one) wherever it passes the
    /// middle of its range and is believed; the turn is the one nearest to what the rate model expects. Returns how many.
    pub fn extend(&mut self, raw: &mut Vec<f64>, later_seconds: &[f64], weak: &[f64], confidence: &[f64]) -> usize {
        let before = self.seconds.len();
        for k in 1..later_seconds.len().min(weak.len()).min(confidence.len()) {
            let (from, step) = (wrap(weak[k - 1]), wrap(weak[k] - weak[k - 1]));
            let crosses = from < 0.0 && from + step >= 0.0 && step > 0.0;
            if !crosses || confidence[k] < LEAST_CONFIDENCE {
                continue;
            }
            let seconds = later_seconds[k - 1] - from / step * (later_seconds[k] - later_seconds[k - 1]);
            let expected = self.at(raw, seconds);
            let turn = (expected / TAU).round() * TAU;
            if self.seconds.last().is_none_or(|&last| seconds > last) {
                self.push(seconds, turn);
                raw.resize(self.seconds.len(), 0.0);
            }
        }
        self.seconds.len() - before
    }
}

/// The bounded correction of an anchor; of slope 1 at 0.
fn correction(raw: f64) -> f64 {
    REACH * (raw / REACH).tanh()
}
