//! The finished modulation of every Gaussian at every frame: A·(fundamental − level + B·residual), bounded.
//!
//! Frames × Gaussians is millions of evaluations of a smooth function, so the table has low rank to working precision. It
//! is built from a few full columns (an orthonormal basis over the frames) and a few full rows (coefficients of every
//! Gaussian), and checked on columns it has not seen; `Exact` evaluates every entry.

use rayon::prelude::*;

use heartian_space::{Modulation, Skin};

use crate::arrival::Arrival;
use crate::error::PulseError;
use crate::limit::Limited;
use crate::numeric::Random;
use crate::pulse::Pulse;
use crate::residual::matrix::{Matrix, multiply};
use crate::residual::{Frames, Residual};

/// How all Gaussians are evaluated.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Evaluation {
    /// Every entry through the network.
    Exact,
    /// Through a low-rank table whose rms error on unseen columns is at most this share of the residual's rms.
    LowRank {
        /// Relative rms error allowed.
        tolerance: f64,
    },
}

impl Default for Evaluation {
    /// A thousandth of the residual: under a ten-thousandth of an 8-bit level on the picture.
    fn default() -> Self {
        Self::LowRank { tolerance: 1e-3 }
    }
}

/// Tables smaller than this are evaluated exactly: the low-rank form would not be cheaper.
const WORTHWHILE: usize = 200_000;
/// Columns sampled at first, and at most; columns used to check.
const FIRST_COLUMNS: usize = 48;
const MOST_COLUMNS: usize = 400;
const CHECKED_COLUMNS: usize = 24;
/// Rows for each basis vector.
const ROWS_PER_RANK: usize = 3;

/// The modulation of all skin Gaussians, and where the bound on 8-bit levels acted. The skin's strength map scales
/// fundamental and residual alike.
///
/// # Errors
/// When there is no skin.
pub fn evaluate_all(pulse: &Pulse, skin: &Skin, evaluation: &Evaluation) -> Result<(Modulation, Limited), PulseError> {
    if skin.gaussians.is_empty() {
        return Err(PulseError::NoSkin);
    }
    let Some(network) = &pulse.residual else {
        return crate::pulse::modulation_from_fundamental(pulse, skin);
    };
    let frames = network.frames(&pulse.theta, &pulse.beat);
    let mut table = residual_table(network, &frames, pulse.len(), &skin.positions, evaluation);
    let count = skin.gaussians.len();
    let factor = (pulse.strength.scale * pulse.strength.residual_weight) as f32;
    let centre = if pulse.strength.level == 0.0 { vec![0.0; count] } else { column_means(&table, count) };
    let (arrival, limits) = (Arrival::new(pulse, skin), pulse.limits());
    let counts: Vec<u64> = table
        .par_chunks_mut(count)
        .enumerate()
        .map(|(frame, row)| {
            let mut limited = 0;
            for (gaussian, (value, centre)) in row.iter_mut().zip(&centre).enumerate() {
                let residual = arrival.strength(gaussian) * factor * (*value - centre);
                let (offset, changed) = limits[frame].apply(arrival.at(frame, gaussian) + residual);
                *value = offset;
                limited += u64::from(changed);
            }
            limited
        })
        .collect();
    let modulation = Modulation {
        gaussians: skin.gaussians.clone(),
        times_seconds: pulse.times_seconds.clone(),
        offsets: table,
        red_blue: skin.red_blue.clone(),
    };
    Ok((modulation.checked()?, Limited::from_counts(&counts)))
}

/// f for every frame and Gaussian, T×n.
fn residual_table(
    network: &Residual,
    frames: &Frames<f32>,
    frame_count: usize,
    points: &[[f32; 3]],
    evaluation: &Evaluation,
) -> Vec<f32> {
    let exact = || network.forward(frames, &network.positions(points));
    match *evaluation {
        Evaluation::Exact => exact(),
        Evaluation::LowRank { .. } if frame_count * points.len() < WORTHWHILE => exact(),
        Evaluation::LowRank { tolerance } => {
            let mut columns = FIRST_COLUMNS;
            while columns <= MOST_COLUMNS {
                if let Some(table) = (LowRank { network, frames, frame_count, points, tolerance }).table(columns) {
                    return table;
                }
                columns *= 2;
            }
            exact()
        }
    }
}

struct LowRank<'a> {
    network: &'a Residual,
    frames: &'a Frames<f32>,
    frame_count: usize,
    points: &'a [[f32; 3]],
    tolerance: f64,
}

impl LowRank<'_> {
    /// The table from that many columns, or `None` when unseen columns disagree.
    fn table(&self, columns: usize) -> Option<Vec<f32>> {
        let (frames, n) = (self.frame_count, self.points.len());
        let mut random = Random::new(columns as u64);
        let mut draw = |count: usize| -> Vec<[f32; 3]> {
            (0..count).map(|k| self.points[(k * n + random.below(n)) / count % n]).collect()
        };
        let (seen, unseen) = (draw(columns.min(n)), draw(CHECKED_COLUMNS));
        let sample = transposed(&self.network.forward(self.frames, &self.network.positions(&seen)), seen.len());
        let basis = Basis::of(sample, frames, 0.1 * self.tolerance);
        let rank = basis.vectors.len() / frames;
        if rank == 0 {
            return Some(vec![0.0; frames * n]);
        }
        let rows = basis.rows(ROWS_PER_RANK * rank);
        let picked = self.frames.picked(&rows, self.network.shape.width);
        let solver = basis.solver(&rows)?;
        let coefficients = |points: &[[f32; 3]]| {
            let values = self.network.forward(&picked, &self.network.positions(points));
            let mut out = vec![0.0f32; rank * points.len()];
            multiply(&mut out, Matrix::new(&solver, rows.len()), Matrix::new(&values, points.len()), false);
            out
        };
        let vectors: Vec<f32> = basis.vectors.iter().map(|&value| value as f32).collect();
        let expand = |coefficients: &[f32], count: usize| {
            let mut table = vec![0.0f32; frames * count];
            table.par_chunks_mut(count * ROWS_AT_ONCE).enumerate().for_each(|(chunk, table)| {
                let (first, height) = (chunk * ROWS_AT_ONCE, table.len() / count);
                let part: Vec<f32> = (0..height)
                    .flat_map(|t| (0..rank).map(move |r| (t, r)))
                    .map(|(t, r)| vectors[r * frames + first + t])
                    .collect();
                multiply(table, Matrix::new(&part, rank), Matrix::new(coefficients, count), false);
            });
            table
        };
        let truth = self.network.forward(self.frames, &self.network.positions(&unseen));
        let guess = expand(&coefficients(&unseen), unseen.len());
        let square = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>();
        let error = square(&mut truth.iter().zip(&guess).map(|(a, b)| f64::from(a - b)));
        let size = square(&mut truth.iter().map(|&value| f64::from(value)));
        (error <= self.tolerance.powi(2) * size).then(|| expand(&coefficients(self.points), n))
    }
}

/// Rows of the finished table made by one task.
const ROWS_AT_ONCE: usize = 32;

/// An orthonormal basis over frames, rank × frames.
struct Basis {
    frames: usize,
    vectors: Vec<f64>,
}

impl Basis {
    /// Column-pivoted Gram–Schmidt (twice, for orthogonality) of `sample`, columns × frames, until what is left is a
    /// share `tolerance` of the whole in every column's mean square.
    fn of(sample: Vec<f64>, frames: usize, tolerance: f64) -> Self {
        let mut left = sample;
        let square = |column: &[f64]| column.iter().map(|v| v * v).sum::<f64>();
        let total: f64 = square(&left);
        let mut vectors: Vec<f64> = Vec::new();
        loop {
            let sizes: Vec<f64> = left.chunks_exact(frames).map(square).collect();
            let rest: f64 = sizes.iter().sum();
            let Some(pivot) = (0..sizes.len()).max_by(|&a, &b| sizes[a].total_cmp(&sizes[b])) else { break };
            if rest <= tolerance.powi(2) * total || sizes[pivot] <= 0.0 || vectors.len() >= left.len() {
                break;
            }
            let mut vector = left[pivot * frames..(pivot + 1) * frames].to_vec();
            for earlier in vectors.chunks_exact(frames) {
                subtract_along(&mut vector, earlier);
            }
            let length = square(&vector).sqrt();
            if length <= 0.0 {
                break;
            }
            vector.iter_mut().for_each(|value| *value /= length);
            left.par_chunks_mut(frames).for_each(|column| subtract_along(column, &vector));
            vectors.extend(vector);
        }
        Self { frames, vectors }
    }

    /// Frames at which the basis is well told apart: greedy by what is left of each frame's row (volume pivoting),
    /// then evenly spaced ones up to `count`.
    fn rows(&self, count: usize) -> Vec<usize> {
        let (frames, rank) = (self.frames, self.vectors.len() / self.frames);
        let mut left: Vec<Vec<f64>> =
            (0..frames).map(|t| (0..rank).map(|r| self.vectors[r * frames + t]).collect()).collect();
        let mut chosen = Vec::new();
        let mut taken = vec![false; frames];
        for _ in 0..rank {
            let size = |row: &[f64]| row.iter().map(|v| v * v).sum::<f64>();
            let Some(pivot) = (0..frames).max_by(|&a, &b| size(&left[a]).total_cmp(&size(&left[b]))) else { break };
            let length = size(&left[pivot]).sqrt();
            if length <= 1e-12 {
                break;
            }
            let direction: Vec<f64> = left[pivot].iter().map(|v| v / length).collect();
            left.iter_mut().for_each(|row| subtract_along(row, &direction));
            chosen.push(pivot);
            taken[pivot] = true;
        }
        let spare = count.min(frames).saturating_sub(chosen.len());
        for k in 0..spare {
            let start = k * frames / spare.max(1);
            if let Some(free) = (start..frames).chain(0..start).find(|&t| !taken[t]) {
                taken[free] = true;
                chosen.push(free);
            }
        }
        chosen.sort_unstable();
        chosen
    }

    /// The least-squares inverse of the basis restricted to `rows`, rank × rows, by Cholesky of its normal matrix.
    fn solver(&self, rows: &[usize]) -> Option<Vec<f32>> {
        let (frames, rank, count) = (self.frames, self.vectors.len() / self.frames, rows.len());
        let at = |r: usize, k: usize| self.vectors[r * frames + rows[k]];
        let mut factor = vec![0.0; rank * rank];
        for i in 0..rank {
            for j in 0..=i {
                let normal: f64 = (0..count).map(|k| at(i, k) * at(j, k)).sum();
                let done: f64 = (0..j).map(|m| factor[i * rank + m] * factor[j * rank + m]).sum();
                let value = normal - done;
                factor[i * rank + j] = if i == j {
                    if value <= 1e-14 {
                        return None;
                    }
                    value.sqrt()
                } else {
                    value / factor[j * rank + j]
                };
            }
        }
        let mut solver = vec![0.0f32; rank * count];
        let mut column = vec![0.0; rank];
        for k in 0..count {
            for i in 0..rank {
                let done: f64 = (0..i).map(|m| factor[i * rank + m] * column[m]).sum();
                column[i] = (at(i, k) - done) / factor[i * rank + i];
            }
            for i in (0..rank).rev() {
                let done: f64 = (i + 1..rank).map(|m| factor[m * rank + i] * column[m]).sum();
                column[i] = (column[i] - done) / factor[i * rank + i];
            }
            for (i, value) in column.iter().enumerate() {
                solver[i * count + k] = *value as f32;
            }
        }
        Some(solver)
    }
}

fn subtract_along(vector: &mut [f64], unit: &[f64]) {
    let along: f64 = vector.iter().zip(unit).map(|(a, b)| a * b).sum();
    vector.iter_mut().zip(unit).for_each(|(a, b)| *a -= along * b);
}

/// Columns × frames in f64 from frames × columns.
fn transposed(table: &[f32], columns: usize) -> Vec<f64> {
    let frames = table.len() / columns;
    (0..columns).flat_map(|c| (0..frames).map(move |t| f64::from(table[t * columns + c]))).collect()
}

fn column_means(table: &[f32], count: usize) -> Vec<f32> {
    let mut sums = vec![0.0f64; count];
    for row in table.chunks_exact(count) {
        sums.iter_mut().zip(row).for_each(|(sum, &value)| *sum += f64::from(value));
    }
    let rows = (table.len() / count).max(1) as f64;
    sums.into_iter().map(|sum| (sum / rows) as f32).collect()
}
