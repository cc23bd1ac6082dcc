//! How sure a track is of each frame: standard deviations from the clip's own matrix and from what its landmarks show of
//! their errors.
//!
//! The covariance is the inverse of the normal matrix at the solution with each landmark counted as it deserves. Three
//! things are read off the residuals, after each landmark's mean over the clip (the same in every frame, so it moves no
//! frame against another) is taken away:
//! - their variance, of one coordinate;
//! - how far errors of neighbouring landmarks go together. A landmark network errs on a whole cheek at once, so n landmarks
//!   say only what n/`crowd` independent ones would. Their correlation is fitted by `a·exp(−d/ℓ) − b` of the distance d
//!   on the face; b is what pose and expression swallowed of it, and is put back;
//! - how much of an error is still there in the next frame. The temporal terms average over some frames; errors that last
//!   average less, and never worse than not at all.
//!
//! To that comes what an uncertain identity does to poses that differ, a mean over the key frames (`shared`).
//!
//! What this cannot see: an error common to all frames (which pose counts as facing ahead is a matter of the identity), and
//! the part of an error that looks like a pose in every frame. The deviations are of a frame's pose against the others'.
//! Landmarks nearly without error leave what the temporal terms smooth away, which is not counted: then half is foretold.

use glam::DVec2;

use super::clip::Whole;
use super::frame::{EXPRESSION, JAW, Seen, Setting, State, robust};
use super::points::{OVAL, rotation};
use super::shared::Openness;
use crate::track::TrackSigma;

/// Frames whose pairs of landmarks are compared, at most.
const PAIRED_FRAMES: usize = 48;
/// Frames fitted alone to tell over how many the temporal terms average, at most.
const LONE_FRAMES: usize = 24;
/// Width and number of the classes of distance, metres.
const CLASS: f64 = 0.006;
const CLASSES: usize = 14;
/// Reaches tried for the correlation, metres: from one landmark's spacing to half a face.
const REACHES: [f64; 9] = [0.004, 0.006, 0.008, 0.011, 0.015, 0.02, 0.027, 0.037, 0.05];

/// What the residuals show of the landmarks' errors.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// Variance of one coordinate as seen in the residuals, squared scales.
    pub variance: f64,
    /// Landmarks that say together what one independent one would, ≥ 1.
    pub crowd: f64,
    /// Variance of what each landmark is off by in every frame alike, squared scales.
    pub lasting: f64,
    /// Correlation of an error with the same landmark's in the next frame, in [0, 1).
    pub memory: f64,
}

/// Residuals by landmark point, scales; with the robust weight that the fit gave them.
type Row = Vec<Option<(DVec2, f64)>>;

impl Noise {
    /// Reads it off a clip fitted.
    pub fn of(setting: &Setting, frames: &[Seen], states: &[State]) -> Self {
        let (rows, lasting) =
            departures(frames.iter().zip(states).map(|(seen, state)| row(setting, seen, state)).collect());
        let (mut squares, mut weights, mut kept) = (0.0, 0.0, [0.0; 2]);
        for (t, row) in rows.iter().enumerate() {
            for (k, entry) in row.iter().enumerate() {
                let Some((error, weight)) = entry else { continue };
                squares += weight * error.length_squared();
                weights += 2.0 * weight;
                if let Some(Some((next, _))) = rows.get(t + 1).map(|row| row[k]) {
                    kept[0] += error.dot(next);
                    kept[1] += 0.5 * (error.length_squared() + next.length_squared());
                }
            }
        }
        let fitted = frames.iter().filter(|seen| !seen.points.is_empty()).count();
        let own = (fitted * states.first().map_or(0, State::unknowns)) as f64;
        // As many as half of the coordinates may have gone into the unknowns; with fewer nothing can be told.
        let freedom = (weights - own).max(0.5 * weights);
        let variance = if squares > 0.0 { squares / freedom } else { 1.0 };
        let memory = if kept[1] > 0.0 { (kept[0] / kept[1]).clamp(0.0, 0.98) } else { 0.0 };
        Self { variance, crowd: crowd(setting, &rows), lasting, memory }
    }

    /// By how much errors that last raise the variance of a mean over `frames` frames, from 1 to `frames`.
    fn remembered(&self, frames: f64) -> f64 {
        let whole = frames.round().clamp(1.0, 1000.0) as usize;
        let share = |lag: usize| (1.0 - lag as f64 / whole as f64) * self.memory.powi(lag as i32);
        1.0 + 2.0 * (1..whole).map(share).sum::<f64>()
    }
}

/// The residuals of one frame but the oval's.
fn row(setting: &Setting, seen: &Seen, state: &State) -> Row {
    let jaw = rotation(state.jaw);
    let mut row = vec![None; setting.points.len()];
    for (k, &point) in seen.points.iter().enumerate() {
        if OVAL.contains(&setting.points.indices[point]) {
            continue;
        }
        if let Some(pixel) = state.project(setting, point, &jaw) {
            let error = (pixel - seen.pixels[k]) / setting.scale_px;
            row[point] = Some((error, robust(error.length_squared()).1));
        }
    }
    row
}

/// The residuals less each landmark's mean over the clip, and the variance of one coordinate of those means.
fn departures(mut rows: Vec<Row>) -> (Vec<Row>, f64) {
    let mut means = [0.0; 2];
    for k in 0..rows.first().map_or(0, Vec::len) {
        let (mut sum, mut weights) = (DVec2::ZERO, 0.0);
        for (error, weight) in rows.iter().filter_map(|row| row[k]) {
            sum += error * weight;
            weights += weight;
        }
        let mean = sum / f64::max(weights, 1e-12);
        means[0] += weights * mean.length_squared();
        means[1] += 2.0 * weights;
        rows.iter_mut().filter_map(|row| row[k].as_mut()).for_each(|(error, _)| *error -= mean);
    }
    (rows, means[0] / f64::max(means[1], 1e-12))
}

/// How many landmarks say together what one would.
fn crowd(setting: &Setting, rows: &[Row]) -> f64 {
    let rest = &setting.shape.rest;
    let full: Vec<&Row> = rows.iter().filter(|row| row.iter().flatten().count() > 1).collect();
    let step = full.len().div_ceil(PAIRED_FRAMES).max(1);
    let (mut products, mut pairs, mut own) = ([0.0; CLASSES], [0.0; CLASSES], [0.0; 2]);
    for row in full.iter().step_by(step) {
        let known: Vec<(usize, DVec2)> =
            row.iter().enumerate().filter_map(|(k, entry)| Some((k, (*entry)?.0 * entry.as_ref()?.1.sqrt()))).collect();
        for (i, (a, error)) in known.iter().enumerate() {
            own[0] += error.length_squared();
            own[1] += 1.0;
            for (b, other) in &known[i + 1..] {
                let class = (rest[*a].distance(rest[*b]) / CLASS) as usize;
                if class < CLASSES {
                    products[class] += error.dot(*other);
                    pairs[class] += 1.0;
                }
            }
        }
    }
    let variance = own[0] / f64::max(own[1], 1.0);
    if variance <= 0.0 {
        return 1.0;
    }
    let correlation: Vec<[f64; 3]> = (0..CLASSES)
        .filter(|&class| pairs[class] > 0.0)
        .map(|class| [(class as f64 + 0.5) * CLASS, products[class] / pairs[class] / variance, pairs[class]])
        .collect();
    let (reach, shared, swallowed) = fitted(&correlation);
    let counted: Vec<usize> = (0..rest.len()).filter(|&k| rows.iter().any(|row| row[k].is_some())).collect();
    let together: f64 = counted
        .iter()
        .map(|&a| counted.iter().map(|&b| (-rest[a].distance(rest[b]) / reach).exp()).sum::<f64>())
        .sum::<f64>()
        / f64::max(counted.len() as f64, 1.0);
    (1.0 + swallowed - shared + shared * together).max(1.0)
}

/// Reach, `a` and `b` of `a·exp(−d/ℓ) − b`, by least squares; `a` and `b` are not negative.
fn fitted(correlation: &[[f64; 3]]) -> (f64, f64, f64) {
    let mut best = (REACHES[0], 0.0, 0.0);
    let mut least = f64::INFINITY;
    for reach in REACHES {
        let mut sums = [0.0; 5];
        for [distance, value, weight] in correlation {
            let shape = (-distance / reach).exp();
            let terms = [weight * shape * shape, weight * shape, *weight, weight * shape * value, weight * value];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        let [ss, s, one, sv, v] = sums;
        let determinant = ss * one - s * s;
        let mut a = if determinant > 1e-12 * ss * one { (sv * one - s * v) / determinant } else { 0.0 };
        let mut b = (a * s - v) / one.max(1e-12);
        if b < 0.0 {
            (a, b) = (sv / ss.max(1e-12), 0.0);
        }
        let b = b.clamp(0.0, 2.0);
        let a = a.clamp(0.0, 1.0 + b);
        let error: f64 =
            correlation.iter().map(|[d, value, weight]| weight * (a * (-d / reach).exp() - b - value).powi(2)).sum();
        if error < least {
            (least, best) = (error, (reach, a, b));
        }
    }
    best
}

/// Standard deviations of every frame, and how much a squared residual counts in that of what all share; empty when the clip's matrix is singular. `whole` is the fitted clip's problem.
/// `openness` tells what the shared unknowns leave open when squared residuals count so much.
pub fn sigmas(
    mut whole: Whole,
    states: &[State],
    (keys, openness): (usize, &dyn Fn(f64) -> Option<Openness>),
) -> (TrackSigma, f64) {
    let noise = Noise::of(&whole.setting, whole.frames, states);
    whole.trust = 1.0 / (noise.variance * noise.crowd).max(1e-6);
    let Some(variances) = whole.variances(states) else { return (TrackSigma::default(), 1.0) };
    let turn = |variances: &[f64]| variances[..3].iter().sum::<f64>();
    let seen: Vec<usize> = (0..states.len()).filter(|&t| !whole.frames[t].points.is_empty()).collect();
    let lone = seen.iter().step_by(seen.len().div_ceil(LONE_FRAMES).max(1));
    let mut gains: Vec<f64> = lone
        .filter_map(|&t| Some(turn(&whole.variances_alone(t, &states[t])?) / turn(&variances[t]).max(1e-300)))
        .collect();
    gains.sort_by(f64::total_cmp);
    let lasting = noise.remembered(gains.get(gains.len() / 2).copied().unwrap_or(1.0));
    // What errs alike in every key frame counts once, not once a frame.
    let alike = keys as f64 * noise.lasting;
    let trust = 1.0 / (noise.variance * noise.crowd * lasting + alike).max(1e-6);
    let open = openness(trust);
    let focal_percent = open.as_ref().map(|open| (100.0 * open.focal.sqrt()) as f32);
    let shared = open.map_or_else(|| vec![0.0; states[0].unknowns()], |open| open.own);
    let deviation = |own: &[f64], k: usize| (own[k].max(0.0) * lasting + shared[k]).sqrt();
    let lids = EXPRESSION + states[0].expression.len();
    let all = || variances.iter();
    let sigma = TrackSigma {
        rotation_deg: all().map(|own| [0, 1, 2].map(|k| deviation(own, k).to_degrees() as f32)).collect(),
        translation_mm: all().map(|own| [3, 4, 5].map(|k| (1e3 * deviation(own, k)) as f32)).collect(),
        jaw_deg: all().map(|own| deviation(own, JAW).to_degrees() as f32).collect(),
        eyelids: all().map(|own| [lids, lids + 1].map(|k| deviation(own, k) as f32)).collect(),
        focal_percent,
    };
    (sigma, trust)
}

#[cfg(test)]
mod tests;
