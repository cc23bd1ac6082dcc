//! Every local maximum of a conditioned pulse, with a score: its rise from the trough before, against the typical rise.

use crate::peaks::{local_maxima, refined};
use crate::stats::median;

use super::condition::Pulse;
use super::rate_track::Periods;

/// Neighbouring beats over which the typical rise is taken, seconds to each side.
const AROUND_SECONDS: f64 = 5.0;
/// Largest score: a motion spike is worth no more than a good beat.
const MOST: f64 = 1.25;

/// A possible beat.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) seconds: f64,
    /// 0 for no rise, 1 for a typical beat's.
    pub(super) score: f64,
}

/// All candidates in time order.
pub(super) fn find(pulse: &Pulse, periods: &Periods) -> Vec<Candidate> {
    let maxima = local_maxima(&pulse.values);
    let times: Vec<f64> = maxima.iter().map(|&i| refined(&pulse.values, i) / pulse.rate_hertz).collect();
    let rises: Vec<f64> = maxima.iter().zip(&times).map(|(&i, &time)| rise(pulse, i, periods.at(time))).collect();
    let typical = typical_rises(&times, &rises, periods);
    let scored = times.iter().zip(&rises).zip(&typical);
    scored.map(|((&seconds, rise), typical)| Candidate { seconds, score: (rise / typical).min(MOST) }).collect()
}

/// Height of a maximum over the lowest point of the half period before it.
fn rise(pulse: &Pulse, index: usize, period_seconds: f64) -> f64 {
    let reach = ((0.5 * period_seconds * pulse.rate_hertz) as usize).max(1);
    let before = &pulse.values[index.saturating_sub(reach)..=index];
    pulse.values[index] - before.iter().copied().fold(f64::INFINITY, f64::min)
}

/// The median, over a few seconds around, of the largest rise within each period.
fn typical_rises(times: &[f64], rises: &[f64], periods: &Periods) -> Vec<f64> {
    let mut leaders: Vec<(f64, f64)> = Vec::new();
    for (&time, &rise) in times.iter().zip(rises) {
        match leaders.last_mut() {
            Some(last) if time - last.0 < 0.7 * periods.at(time) => {
                if rise > last.1 {
                    *last = (time, rise);
                }
            }
            _ => leaders.push((time, rise)),
        }
    }
    times
        .iter()
        .map(|time| {
            let from = leaders.partition_point(|leader| leader.0 < time - AROUND_SECONDS);
            let to = leaders.partition_point(|leader| leader.0 <= time + AROUND_SECONDS);
            let around: Vec<f64> = leaders[from..to].iter().map(|leader| leader.1).collect();
            median(&around).max(f64::MIN_POSITIVE)
        })
        .collect()
}
