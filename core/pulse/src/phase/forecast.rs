//! How beats go on where nothing is known of them: intervals as an autoregressive process about their mean.
//!
//! The process is fitted to the known intervals by the Yule–Walker equations (Levinson's recursion on the biased
//! autocovariance, which is always stable), so what varies slowly or with the breath is carried on for as long as it
//! predicts, and then the mean remains. Its own innovations say how far the n-th beat will be off. For intervals that
//! vary freely that is σ·√n: no rule can do better, and no phase can be in step for ever.

use std::f64::consts::TAU;

use crate::numeric::mean;

/// Largest order: half a minute at resting rates, more than a wave of the slowest variation.
const MOST_ORDER: usize = 32;
/// Known intervals for each coefficient.
const INTERVALS_PER_ORDER: usize = 8;
/// Intervals beyond these shares of the mean are taken as such: a missed or an extra beat is no rhythm.
const BELIEVED: [f64; 2] = [0.6, 1.5];
/// Least interval foreseen, as a share of the mean.
const LEAST: f64 = 0.3;
/// Beats foreseen one by one; later ones follow at the mean interval.
const FORESEEN: usize = 256;

/// What is expected of the beats to come.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Forecast {
    /// Mean interval, seconds, above 0.
    mean_seconds: f64,
    /// Intervals to come, seconds.
    intervals: Vec<f64>,
    /// Standard deviation of the time of the n-th beat to come, seconds, from 0 for the last known.
    spread_seconds: Vec<f64>,
    /// Its growth with each further beat, as a variance.
    late_variance: f64,
}

impl Forecast {
    /// From the known intervals in the order of time, seconds, each above 0; none without any.
    pub fn of(intervals: &[f64]) -> Option<Self> {
        if intervals.is_empty() {
            return None;
        }
        let mean_seconds = mean(intervals);
        let believed = BELIEVED.map(|share| share * mean_seconds);
        let deviations: Vec<f64> =
            intervals.iter().map(|seconds| seconds.clamp(believed[0], believed[1]) - mean_seconds).collect();
        let order = MOST_ORDER.min(intervals.len() / INTERVALS_PER_ORDER);
        let (coefficients, innovation) = yule_walker(&deviations, order);
        let mut known: Vec<f64> = deviations.iter().rev().take(order).rev().copied().collect();
        let mut to_come = Vec::with_capacity(FORESEEN);
        for _ in 0..FORESEEN {
            let next = coefficients.iter().zip(known.iter().rev()).map(|(weight, value)| weight * value).sum();
            known.push(next);
            to_come.push((mean_seconds + next).max(LEAST * mean_seconds));
        }
        // ψ: what an innovation does to later intervals; its running sum is what it does to the time of later beats.
        let (mut psi, mut moved, mut variance) = (vec![1.0], 0.0, 0.0);
        let mut spread_seconds = vec![0.0];
        for n in 0..FORESEEN {
            moved += psi[n];
            variance += innovation * moved * moved;
            spread_seconds.push(f64::sqrt(variance));
            psi.push(coefficients.iter().zip(psi.iter().rev()).map(|(weight, value)| weight * value).sum());
        }
        Some(Self { mean_seconds, intervals: to_come, spread_seconds, late_variance: innovation * moved * moved })
    }

    /// When so many turns (0 to 1) after the last known beat are gained, seconds.
    pub fn seconds_of(&self, turns: f64) -> f64 {
        turns * self.intervals.first().copied().unwrap_or(self.mean_seconds)
    }

    /// Turns gained so many seconds (≥ 0) after the last known beat.
    pub fn turns_after(&self, seconds: f64) -> f64 {
        let mut from = 0.0;
        for (beat, interval) in self.intervals.iter().enumerate() {
            if seconds < from + interval {
                return beat as f64 + (seconds - from) / interval;
            }
            from += interval;
        }
        self.intervals.len() as f64 + (seconds - from) / self.mean_seconds
    }

    /// Expected error of the phase that many turns after the last known beat, radians.
    pub fn spread_radians(&self, turns: f64) -> f64 {
        let last = self.spread_seconds.len() - 1;
        let at = turns.clamp(0.0, last as f64);
        let (below, rest) = (at.floor() as usize, at.fract());
        let (low, high) = (self.spread_seconds[below], self.spread_seconds[(below + 1).min(last)]);
        let late = (turns - last as f64).max(0.0) * self.late_variance;
        TAU / self.mean_seconds * ((low + rest * (high - low)).powi(2) + late).sqrt()
    }
}

/// Coefficients of the autoregression of that order, the latest value's first, and the variance of its innovations.
fn yule_walker(deviations: &[f64], order: usize) -> (Vec<f64>, f64) {
    let count = deviations.len() as f64;
    let covariance = |lag: usize| deviations.iter().zip(&deviations[lag..]).map(|(a, b)| a * b).sum::<f64>() / count;
    let mut variance = covariance(0);
    let mut coefficients: Vec<f64> = Vec::new();
    // What is left of a steady rhythm is rounding.
    let least = 1e-12 * variance;
    for k in 1..=order {
        if variance <= least || variance <= 0.0 {
            break;
        }
        let explained: f64 = coefficients.iter().enumerate().map(|(j, weight)| weight * covariance(k - 1 - j)).sum();
        let reflection = (covariance(k) - explained) / variance;
        let reversed: Vec<f64> = coefficients.iter().rev().copied().collect();
        coefficients.iter_mut().zip(&reversed).for_each(|(weight, mirror)| *weight -= reflection * mirror);
        coefficients.push(reflection);
        variance *= 1.0 - reflection * reflection;
    }
    (coefficients, variance.max(0.0))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::numeric::Random;

    #[test]
    fn a_steady_rhythm_goes_on_and_is_certain() {
        let forecast = Forecast::of(&[0.8; 40]).unwrap();
        assert!((forecast.turns_after(1000.0 * 0.8) - 1000.0).abs() < 1e-6);
        assert!(forecast.spread_radians(1000.0) < 1e-6);
        assert!(Forecast::of(&[]).is_none());
        assert!((Forecast::of(&[0.5]).unwrap().turns_after(1.25) - 2.5).abs() < 1e-9);
    }

    #[test]
    fn free_intervals_spread_as_the_root_of_their_number_and_it_is_what_happens() {
        let mut random = Random::new(3);
        let free: Vec<f64> = (0..4000).map(|_| 0.8 + 0.04 * random.normal()).collect();
        let forecast = Forecast::of(&free[..1000]).unwrap();
        for n in [1usize, 16, 100, 400] {
            let told = forecast.spread_radians(n as f64);
            let wanted = TAU / 0.8 * 0.04 * (n as f64).sqrt();
            assert!((told / wanted - 1.0).abs() < 0.15, "{n}: {told} {wanted}");
        }
        // Twenty stretches of a hundred beats: their mean is off by as much as was told.
        let off = |k: usize| free[1000 + 100 * k..1100 + 100 * k].iter().sum::<f64>() - 80.0;
        let rms = (0..30).map(|k| off(k).powi(2)).sum::<f64>() / 30.0;
        let told = forecast.spread_radians(100.0) * 0.8 / TAU;
        assert!((rms.sqrt() / told - 1.0).abs() < 0.4, "{} {told}", rms.sqrt());
    }

    #[test]
    fn a_slow_wave_is_carried_on() {
        let wave = |k: usize| 0.8 + 0.05 * (TAU * k as f64 / 12.0).sin();
        let known: Vec<f64> = (0..600).map(wave).collect();
        let forecast = Forecast::of(&known).unwrap();
        // A third of a wave ahead the mean would be off by 0.29 s.
        let truth: f64 = (600..606).map(wave).sum();
        let turns = forecast.turns_after(truth);
        let at_the_mean = truth / mean(&known);
        println!("six beats of a wave ahead: {turns:.3} turns foreseen, {at_the_mean:.3} at the mean rate");
        assert!((turns - 6.0).abs() < 0.3 * (at_the_mean - 6.0).abs());
    }
}
