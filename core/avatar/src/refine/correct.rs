//! What the refined training frames say about frames whose pictures nobody may look at.
//!
//! Every tracked number gets an offset, predicted by ridge regression from tracked numbers alone: those of the frame (what
//! the tracker gets wrong depends on the pose) and how far the number itself stands from its neighbours in time (what of it
//! is jitter). How much of that to believe is decided, number by number, by leaving out one stretch of the training
//! frames after the other; where nothing helps only the mean offset is left. Drivers are held to the range that the
//! training frames covered.

use rayon::prelude::*;

use crate::linear::solve_in_place;

/// Distances in frames at which a number is compared with its neighbours.
const LAGS: [usize; 3] = [1, 2, 4];
/// Stretches that are left out in turn.
const STRETCHES: usize = 5;
/// Ridges tried, in units of a driver's variance; the last leaves next to nothing of the drivers.
const RIDGES: [f64; 6] = [0.003, 0.03, 0.3, 3.0, 30.0, 1e9];
/// A driver that varies less than this (radians, metres, coefficients) says nothing.
const LEAST_DEVIATION: f64 = 1e-7;

/// Offsets of the frames from `offsets.len()` on: one row a frame. `tracked` is `T × D`, `offsets` the first rows' offsets.
pub(super) fn predicted_offsets(tracked: &[Vec<f64>], offsets: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let (count, width) = (offsets.len(), tracked.first().map_or(0, Vec::len));
    let columns: Vec<Vec<f64>> = (0..width)
        .into_par_iter()
        .map(|index| {
            let wanted: Vec<f64> = offsets.iter().map(|row| row[index]).collect();
            if count == 0 || wanted.iter().all(|w| *w == 0.0) {
                return vec![0.0; tracked.len() - count];
            }
            column(tracked, index, &wanted)
        })
        .collect();
    (0..tracked.len() - count).map(|t| columns.iter().map(|column| column[t]).collect()).collect()
}

/// One number's offsets in the frames after the first `wanted.len()`.
fn column(tracked: &[Vec<f64>], index: usize, wanted: &[f64]) -> Vec<f64> {
    let count = wanted.len();
    let drivers = Drivers::new(tracked, index, count);
    let fold = |t: usize| t * STRETCHES / count;
    let mut stretches: Vec<Normal> = (0..STRETCHES).map(|_| Normal::new(drivers.width)).collect();
    for (t, want) in wanted.iter().enumerate() {
        stretches[fold(t)].add(drivers.row(t), *want);
    }
    let whole = Normal::sum(drivers.width, stretches.iter());
    let error_of = |ridge: f64| -> f64 {
        let solved: Vec<Vec<f64>> = (0..STRETCHES)
            .map(|left_out| {
                let others = stretches.iter().enumerate().filter(|(k, _)| *k != left_out).map(|(_, normal)| normal);
                Normal::sum(drivers.width, others).solved(ridge)
            })
            .collect();
        (0..count).map(|t| (dot(&solved[fold(t)], drivers.row(t)) - wanted[t]).powi(2)).sum()
    };
    let errors = RIDGES.map(error_of);
    let best = (0..RIDGES.len()).fold(RIDGES.len() - 1, |best, k| if errors[k] < errors[best] { k } else { best });
    let coefficients = whole.solved(RIDGES[best]);
    (count..tracked.len()).map(|t| dot(&coefficients, drivers.row(t))).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// What drives one number: 1, then standardised numbers held to the range of the training frames, for every frame.
struct Drivers {
    width: usize,
    rows: Vec<f64>,
}

impl Drivers {
    fn new(tracked: &[Vec<f64>], index: usize, count: usize) -> Self {
        let last = tracked.len() - 1;
        let raw = |t: usize| {
            let own = move |at: usize| tracked[at][index];
            let lags =
                LAGS.into_iter().map(move |lag| 0.5 * (own(t.saturating_sub(lag)) + own((t + lag).min(last))) - own(t));
            tracked[t].iter().copied().chain(lags)
        };
        let drivers = tracked[0].len() + LAGS.len();
        let (mut sum, mut square) = (vec![0.0; drivers], vec![0.0; drivers]);
        let (mut least, mut most) = (vec![f64::INFINITY; drivers], vec![f64::NEG_INFINITY; drivers]);
        // Sums about the first frame, so that large constant parts cost no digits.
        let origin: Vec<f64> = raw(0).collect();
        for t in 0..count {
            for (k, value) in raw(t).enumerate() {
                let value = value - origin[k];
                sum[k] += value;
                square[k] += value * value;
                least[k] = least[k].min(value);
                most[k] = most[k].max(value);
            }
        }
        let n = count as f64;
        let scale: Vec<(f64, f64)> = (0..drivers)
            .map(|k| {
                let deviation = (square[k] / n - (sum[k] / n).powi(2)).max(0.0).sqrt();
                (sum[k] / n, if deviation > LEAST_DEVIATION { 1.0 / deviation } else { 0.0 })
            })
            .collect();
        let mut rows = Vec::with_capacity(tracked.len() * (drivers + 1));
        for t in 0..tracked.len() {
            rows.push(1.0);
            rows.extend(raw(t).enumerate().map(|(k, value)| {
                let (mean, per_deviation) = scale[k];
                ((value - origin[k]).clamp(least[k], most[k]) - mean) * per_deviation
            }));
        }
        Self { width: drivers + 1, rows }
    }

    fn row(&self, t: usize) -> &[f64] {
        &self.rows[t * self.width..(t + 1) * self.width]
    }
}

/// Normal equations of a least-squares fit.
struct Normal {
    count: f64,
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl Normal {
    fn new(width: usize) -> Self {
        Self { count: 0.0, matrix: vec![0.0; width * width], right: vec![0.0; width] }
    }

    /// The lower half is kept.
    fn add(&mut self, row: &[f64], want: f64) {
        let n = row.len();
        self.count += 1.0;
        for i in 0..n {
            self.right[i] += row[i] * want;
            for j in 0..=i {
                self.matrix[i * n + j] += row[i] * row[j];
            }
        }
    }

    fn sum<'a>(width: usize, parts: impl Iterator<Item = &'a Self>) -> Self {
        let mut out = Self::new(width);
        for part in parts {
            out.count += part.count;
            out.matrix.iter_mut().zip(&part.matrix).for_each(|(a, b)| *a += b);
            out.right.iter_mut().zip(&part.right).for_each(|(a, b)| *a += b);
        }
        out
    }

    /// The coefficients with the ridge on all drivers but the constant.
    fn solved(&self, ridge: f64) -> Vec<f64> {
        let n = self.right.len();
        let (mut matrix, mut right) = (self.matrix.clone(), self.right.clone());
        for i in 1..n {
            matrix[i * n + i] += ridge * self.count + 1e-9;
        }
        matrix[0] += 1e-12;
        solve_in_place(&mut matrix, &mut right);
        right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        }
    }

    /// A tracked number with jitter and a bias that follows another number; the truth is smooth.
    fn recording(frames: usize) -> (Vec<Vec<f64>>, Vec<f64>) {
        let mut next = noise(9);
        (0..frames)
            .map(|t| {
                let phase = t as f64 * 0.11;
                let (truth, other) = ((0.7 * phase).sin(), (0.23 * phase).cos());
                (vec![truth + 0.2 + 0.3 * other + 0.1 * next(), other, next()], truth)
            })
            .unzip()
    }

    #[test]
    fn bias_and_jitter_are_taken_from_frames_that_were_never_refined() {
        let (tracked, truth) = recording(360);
        let offsets: Vec<Vec<f64>> = (0..300).map(|t| vec![truth[t] - tracked[t][0], 0.0, 0.0]).collect();
        let predicted = predicted_offsets(&tracked, &offsets);
        assert_eq!(predicted.len(), 60);
        let rms = |error: &dyn Fn(usize) -> f64| ((300..360).map(|t| error(t).powi(2)).sum::<f64>() / 60.0).sqrt();
        let before = rms(&|t| tracked[t][0] - truth[t]);
        let after = rms(&|t| tracked[t][0] + predicted[t - 300][0] - truth[t]);
        assert!(after < 0.2 * before, "{before} {after}");
        assert!(predicted.iter().all(|row| row[1] == 0.0 && row[2] == 0.0), "what never moved stays");
    }

    #[test]
    fn offsets_that_follow_nothing_leave_their_mean_and_odd_drivers_no_nan() {
        let mut next = noise(4);
        let mut tracked: Vec<Vec<f64>> = (0..120).map(|_| vec![next(), 5.0, 1e-9 * next()]).collect();
        let offsets: Vec<Vec<f64>> = (0..100).map(|_| vec![0.5 + 0.01 * next(), 0.0, 0.0]).collect();
        tracked[110][0] = 1e9;
        let predicted = predicted_offsets(&tracked, &offsets);
        assert!(predicted.iter().all(|row| (row[0] - 0.5).abs() < 0.02), "{predicted:?}");
        assert!(predicted_offsets(&tracked, &[]).len() == 120);
        assert!(predicted_offsets(&[], &[]).is_empty());
    }
}
