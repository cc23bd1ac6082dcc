//! Phase held by anchors: absolute, so that no error adds up, and defined at any time, not only at fitted frames.
//!
//! An anchor is a moment and its phase: each systolic peak, and the first and last fitted frame. Between anchors phase is
//! linear in time, as the paper's θ_gt is between peaks; each anchor carries a learnt correction of less than π/4, so
//! phase never runs backwards. Beyond the fitted frames further anchors are set by what is known there: beats that were
//! prescribed or that a PPG shows, which leaves nothing to drift, or the pulse the video itself shows. Where nothing is
//! known the beats go on as a forecast of their intervals (`phase/forecast.rs`), which also says how far it will be off.

use std::f64::consts::{FRAC_PI_4, TAU};

use super::Continued;
use super::forecast::Forecast;
use crate::numeric::{mean, wrap};

/// Bound on an anchor's correction, radians.
const REACH: f64 = FRAC_PI_4;
/// Anchors closer than this to their neighbour are merged, seconds.
const LEAST_GAP_SECONDS: f64 = 1e-6;
/// Beats that one gap between anchors may stand for.
const MOST_MISSED: f64 = 1000.0;
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

    /// Intervals between whole turns, seconds, in the order of time, or reversed; where no two are known, the mean of all.
    fn intervals(&self, backwards: bool) -> Vec<f64> {
        let (mut found, mut last): (Vec<f64>, Option<(f64, f64)>) = (Vec::new(), None);
        for (&seconds, &phase) in self.seconds.iter().zip(&self.phase) {
            let turns = phase / TAU;
            if (turns - turns.round()).abs() > 1e-6 {
                continue;
            }
            if let Some((before, turn)) = last {
                let passed = (turns - turn).round().clamp(1.0, MOST_MISSED);
                // Beats that were left out share the time between those that were not.
                found.extend((0..passed as usize).map(|_| (seconds - before) / passed));
            }
            last = Some((seconds, turns));
        }
        if backwards {
            found.reverse();
        }
        if found.is_empty() && self.seconds.len() > 1 {
            let end = self.seconds.len() - 1;
            found.push(TAU * (self.seconds[end] - self.seconds[0]) / (self.phase[end] - self.phase[0]));
        }
        found
    }

    /// What is expected before the first (backwards) or after the last anchor.
    pub(super) fn forecast(&self, backwards: bool) -> Option<Forecast> {
        Forecast::of(&self.intervals(backwards))
    }

    /// Phase gained in `seconds` beyond the first (negative) or last anchor, by a forecast from that end.
    fn beyond(&self, forecast: Option<&Forecast>, seconds: f64) -> f64 {
        let (Some(forecast), Some(&first), Some(&last)) = (forecast, self.phase.first(), self.phase.last()) else {
            return 0.0;
        };
        // The end may lie within a beat; the forecast goes on from the beat's start as if it had been on time.
        let passed = if seconds < 0.0 { (first / TAU).ceil() - first / TAU } else { last / TAU - (last / TAU).floor() };
        let since = forecast.seconds_of(passed) + seconds.abs();
        TAU * (forecast.turns_after(since) - passed).copysign(seconds)
    }

    /// Unwrapped phase at any moment, with the anchors' corrections from `raw`.
    pub fn at(&self, raw: &[f64], seconds: f64) -> f64 {
        let forecast = |backwards: bool| match self.place(seconds) {
            Place::Outside(by) if (by < 0.0) == backwards => self.forecast(backwards),
            _ => None,
        };
        self.at_foreseen(raw, seconds, [forecast(true).as_ref(), forecast(false).as_ref()])
    }

    /// As [`Self::at`], with the forecasts before the first and after the last anchor.
    pub(super) fn at_foreseen(&self, raw: &[f64], seconds: f64, forecasts: [Option<&Forecast>; 2]) -> f64 {
        if self.seconds.is_empty() {
            return 0.0;
        }
        let corrected = |k: usize| self.phase[k] + correction(raw[k]);
        match self.place(seconds) {
            Place::Between(k, share) => corrected(k) + share * (corrected(k + 1) - corrected(k)),
            Place::Outside(by) if by < 0.0 => corrected(0) + self.beyond(forecasts[0], by),
            Place::Outside(by) => corrected(self.seconds.len() - 1) + self.beyond(forecasts[1], by),
        }
    }

    /// θ at later moments, and how far it is expected to be off.
    pub(super) fn continued(&self, raw: &[f64], later_seconds: &[f64]) -> Continued {
        let forecasts = [self.forecast(true), self.forecast(false)];
        let foreseen = [forecasts[0].as_ref(), forecasts[1].as_ref()];
        let last_turn = self.phase.last().map_or(0.0, |last| (last / TAU).floor() * TAU);
        let of = |&seconds: &f64| {
            let phase = self.at_foreseen(raw, seconds, foreseen);
            let spread = match (self.place(seconds), foreseen[1]) {
                (Place::Between(..), _) => 0.0,
                (Place::Outside(by), Some(forecast)) if by > 0.0 => {
                    forecast.spread_radians(((phase - last_turn) / TAU).max(0.0))
                }
                _ => f64::NAN,
            };
            (wrap(phase), spread)
        };
        let (theta, spread_radians) = later_seconds.iter().map(of).unzip();
        Continued { theta, spread_radians }
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

    /// Sets an anchor after the last one at each beat (systolic peaks, seconds, increasing): each is the turn after the one
    /// before, however long it took, and carries the mean of the learnt corrections, so that no error can add up. Returns
    /// how many.
    pub fn extend_by_beats(&mut self, raw: &mut Vec<f64>, beats_seconds: &[f64]) -> usize {
        let (before, learnt) = (self.seconds.len(), mean(raw));
        let mut turn: Option<f64> = None;
        for &seconds in beats_seconds {
            let later = self.seconds.last().is_none_or(|&last| seconds > last);
            if !later {
                continue;
            }
            // The first is the turn nearest to what is expected: the fitted frames may end just before or after a beat.
            let next = turn.map_or_else(|| (self.at(raw, seconds) / TAU).round() * TAU, |turn| turn + TAU);
            turn = Some(next);
            self.push(seconds, next);
            raw.resize(self.seconds.len(), learnt);
        }
        self.seconds.len() - before
    }

    /// Sets anchors after the last one from a weak phase (radians, wrapped, aligned to this one) wherever it passes the
    /// middle of its range and is believed; the turn is the one nearest to what is forecast. Returns how many.
    pub fn extend_by_video(
        &mut self,
        raw: &mut Vec<f64>,
        later_seconds: &[f64],
        weak: &[f64],
        confidence: &[f64],
    ) -> usize {
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
