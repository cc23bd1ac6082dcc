//! The most believable sequence of beats among candidates, and the filling of gaps.

use super::Beat;
use super::candidates::Candidate;
use super::rate_track::Periods;

/// Score that a candidate must exceed to be worth a beat.
const THRESHOLD: f64 = 0.4;
/// Cost of a squared logarithmic deviation of an interval from the tracked period: a dicrotic wave (0.35 + 0.65 of a
/// period) costs 2.6, an ectopic beat (0.6 + 1.4) 0.75.
const INTERVAL_COST: f64 = 2.0;
/// Cost of each beat that a gap leaves out.
const MISSING_COST: f64 = 0.5;
/// Gap in periods beyond which beats are no longer counted and only the length costs.
const LOST_PERIODS: f64 = 4.5;
/// Gap in periods from which beats are filled in: a compensatory pause after an ectopic beat (≤ 1.5) is left alone.
const FILL_PERIODS: f64 = 1.65;

/// Rise, against the typical one, from which a maximum counts as a beat that the signal shows.
const PLAIN: f64 = 0.3;
/// Likeness of consecutive beats below which a stretch has no clear rhythm.
const CLEAR: f64 = 0.3;

/// Cost of an interval, ≥ 0.
fn interval_cost(interval: f64, period: f64) -> f64 {
    let ratio = interval / period;
    if ratio > LOST_PERIODS {
        return MISSING_COST * (ratio - 1.0);
    }
    let cost = |beats: f64| INTERVAL_COST * (ratio / beats).ln().powi(2) + MISSING_COST * (beats - 1.0);
    let beats = ratio.round().max(1.0);
    cost(beats).min(cost((beats - 1.0).max(1.0)))
}

/// Picks the sequence with the largest sum of scores less costs.
/// Of it, only what plainly rises is returned: a bump that bridged a gap is left to [`fill`].
pub(super) fn choose(candidates: &[Candidate], periods: &Periods) -> Vec<f64> {
    let mut total: Vec<f64> = Vec::with_capacity(candidates.len());
    let mut previous: Vec<Option<usize>> = Vec::with_capacity(candidates.len());
    // Best predecessor beyond reach, by total with the lost time discounted at its own period.
    let (mut reach_from, mut far): (usize, Option<usize>) = (0, None);
    for (index, candidate) in candidates.iter().enumerate() {
        let period = periods.at(candidate.seconds);
        let lead_in = MISSING_COST * (candidate.seconds / period - 1.0).max(0.0);
        let mut best = (-lead_in, None);
        while candidate.seconds - candidates[reach_from].seconds > LOST_PERIODS * period {
            let value = |k: usize| total[k] + MISSING_COST * candidates[k].seconds / period;
            if far.is_none_or(|k| value(reach_from) > value(k)) {
                far = Some(reach_from);
            }
            reach_from += 1;
        }
        for earlier in far.into_iter().chain(reach_from..index) {
            let interval = candidate.seconds - candidates[earlier].seconds;
            let value = total[earlier] - interval_cost(interval, period);
            if value > best.0 {
                best = (value, Some(earlier));
            }
        }
        total.push(best.0 + candidate.score - THRESHOLD);
        previous.push(best.1);
    }
    let Some(end) = candidates.last().map(|candidate| candidate.seconds) else { return Vec::new() };
    let finished = |k: usize| total[k] - MISSING_COST * (end - candidates[k].seconds) / periods.at(end);
    let mut at = (0..candidates.len()).max_by(|&a, &b| finished(a).total_cmp(&finished(b)));
    let mut chosen = Vec::new();
    while let Some(index) = at {
        if candidates[index].score >= PLAIN {
            chosen.push(candidates[index].seconds);
        }
        at = previous[index];
    }
    chosen.reverse();
    chosen
}

/// Inserts evenly spaced beats where an interval holds about two periods or more.
pub(super) fn fill(peaks: &[f64], periods: &Periods) -> Vec<Beat> {
    let mut beats = Vec::with_capacity(peaks.len());
    for (index, &seconds) in peaks.iter().enumerate() {
        if let Some(&before) = index.checked_sub(1).and_then(|k| peaks.get(k)) {
            let gap = seconds - before;
            let ratio = gap / periods.at(0.5 * (before + seconds));
            let count = if ratio >= FILL_PERIODS { ratio.round() as usize } else { 1 };
            for k in 1..count {
                beats.push(Beat { seconds: before + gap * k as f64 / count as f64, observed: false });
            }
        }
        beats.push(Beat { seconds, observed: periods.clarity_at(seconds) >= CLEAR });
    }
    beats
}
