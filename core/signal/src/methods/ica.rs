//! Independent component analysis by JADE (Cardoso & Souloumiac 1993), as Poh et al. (2011) use it on mean colours.
//!
//! Colours are real, so the toolbox's complex algorithm stays real throughout: the third Jacobi angle vanishes, and a
//! joint rotation is found from a 2×2 instead of a 3×3 eigenproblem. The sign of the trace is arbitrary.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;

use crate::detrend::{Detrender, Smoothness};
use crate::error::{Result, SignalError, check_length};
use crate::filter::{Band, Butterworth};
use crate::stats::{mean, standard_deviation};

use super::eigen::symmetric;
use super::{Rgb, TOOLBOX_SMOOTHNESS, check_colors_at};

type Matrix = [[f64; 3]; 3];

/// Sweeps after which a joint diagonalisation is taken as it is; a handful suffices.
const MAX_SWEEPS: usize = 200;

/// The most periodic independent source of the detrended, standardised channels, band-passed (order 3, 0.7–2.5 Hz).
///
/// # Errors
/// When colours or rate are unusable, a channel does not vary, channels are copies of each other, or the recording is
/// not longer than the filter's padding (21 frames).
pub fn ica(rgb: &[Rgb], rate_hertz: f64) -> Result<Vec<f64>> {
    ica_smoothed(rgb, rate_hertz, TOOLBOX_SMOOTHNESS)
}

/// [`ica`] with another smoothness of its detrending.
pub(super) fn ica_smoothed(rgb: &[Rgb], rate_hertz: f64, smoothness: Smoothness) -> Result<Vec<f64>> {
    check_colors_at(rgb, rate_hertz)?;
    let filter = Butterworth::bandpass(3, Band { low_hertz: 0.7, high_hertz: 2.5 }, rate_hertz)?;
    check_length("ICA", filter.padding() + 1, rgb.len())?;
    let detrender = Detrender::new(rgb.len(), smoothness.lambda(rate_hertz))?;
    let mut channels = Vec::with_capacity(3);
    for channel in 0..3 {
        let mut trace: Vec<f64> = rgb.iter().map(|color| color[channel]).collect();
        let size = trace.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        detrender.apply(&mut trace)?;
        let (centre, deviation) = (mean(&trace), standard_deviation(&trace));
        if deviation <= 1e-12 * size {
            return Err(SignalError::Flat("a colour channel"));
        }
        trace.iter_mut().for_each(|value| *value = (*value - centre) / deviation);
        channels.push(trace);
    }
    let sources = jade(&channels)?;
    let mut best = (f64::NEG_INFINITY, 0);
    for (index, source) in sources.iter().enumerate() {
        let score = peakedness(source);
        if score > best.0 {
            best = (score, index);
        }
    }
    filter.filtfilt(&sources[best.1])
}

/// Largest share that one bin holds of the power of all bins but DC, up to just below Nyquist.
fn peakedness(source: &[f64]) -> f64 {
    let n = source.len();
    let mut spectrum: Vec<Complex64> = source.iter().map(|&value| Complex64::new(value, 0.0)).collect();
    FftPlanner::new().plan_fft_forward(n).process(&mut spectrum);
    let power: Vec<f64> = spectrum[1..1 + (n - 1) / 2].iter().map(Complex64::norm_sqr).collect();
    power.iter().copied().fold(0.0, f64::max) / power.iter().sum::<f64>()
}

/// Three maximally independent sources of three zero-mean, unit-variance channels.
fn jade(channels: &[Vec<f64>]) -> Result<Vec<Vec<f64>>> {
    let samples = channels[0].len();
    let whitener = inverse_square_root(covariance(channels))?;
    let white = combine(&whitener, channels);
    let rotation = joint_diagonaliser(cumulant_matrices(&white), 1.0 / (100.0 * (samples as f64).sqrt()));
    let transposed = std::array::from_fn(|i| std::array::from_fn(|j| rotation[j][i]));
    Ok(combine(&transposed, &white))
}

fn covariance(channels: &[Vec<f64>]) -> Matrix {
    let dot = |i: usize, j: usize| channels[i].iter().zip(&channels[j]).map(|(x, y)| x * y).sum::<f64>();
    std::array::from_fn(|i| std::array::from_fn(|j| dot(i, j) / channels[0].len() as f64))
}

/// Symmetric `C^(−1/2)`.
fn inverse_square_root(matrix: Matrix) -> Result<Matrix> {
    let eigen = symmetric(matrix);
    let largest = eigen.values.iter().copied().fold(0.0, f64::max);
    if eigen.values.iter().any(|&value| value <= 1e-14 * largest) {
        return Err(SignalError::Flat("the difference between colour channels"));
    }
    let entry = |i: usize, j: usize| {
        (0..3).map(|k| eigen.vectors[k][i] * eigen.vectors[k][j] / eigen.values[k].sqrt()).sum::<f64>()
    };
    Ok(std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j))))
}

fn combine(matrix: &Matrix, channels: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let row = |weights: &[f64; 3]| {
        (0..channels[0].len()).map(|t| (0..3).map(|c| weights[c] * channels[c][t]).sum()).collect()
    };
    matrix.iter().map(row).collect()
}

/// The three eigenmatrices of the fourth-order cumulant tensor with the largest |λ|, each scaled by its |λ|.
fn cumulant_matrices(white: &[Vec<f64>]) -> [Matrix; 3] {
    let samples = white[0].len() as f64;
    let second = covariance(white);
    let moment = |i: usize, j: usize, k: usize, l: usize| {
        (0..white[0].len()).map(|t| white[i][t] * white[j][t] * white[k][t] * white[l][t]).sum::<f64>() / samples
    };
    let tensor = std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            let (l, k, j, i) = (row / 3, row % 3, column / 3, column % 3);
            moment(l, k, j, i) - second[i][j] * second[l][k] - second[i][k] * second[l][j] - second[i][l] * second[j][k]
        })
    });
    let eigen = symmetric::<9>(tensor);
    let mut order: [usize; 9] = std::array::from_fn(|k| k);
    order.sort_by(|&a, &b| eigen.values[b].abs().total_cmp(&eigen.values[a].abs()));
    std::array::from_fn(|k| {
        let (scale, vector) = (eigen.values[order[k]].abs(), &eigen.vectors[order[k]]);
        std::array::from_fn(|i| std::array::from_fn(|j| scale * vector[3 * i + j]))
    })
}

/// The rotation that best diagonalises all matrices at once, by Jacobi sweeps until no sine exceeds `threshold`.
fn joint_diagonaliser(mut matrices: [Matrix; 3], threshold: f64) -> Matrix {
    let mut rotation: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..MAX_SWEEPS {
        let mut moved = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (cosine, sine) = best_rotation(&matrices, p, q);
            if sine.abs() <= threshold {
                continue;
            }
            moved = true;
            let turn = |x: f64, y: f64| (cosine * x + sine * y, cosine * y - sine * x);
            for row in &mut rotation {
                (row[p], row[q]) = turn(row[p], row[q]);
            }
            for m in &mut matrices {
                for row in m.iter_mut() {
                    (row[p], row[q]) = turn(row[p], row[q]);
                }
                let (upper, lower) = (m[p], m[q]);
                for column in 0..3 {
                    (m[p][column], m[q][column]) = turn(upper[column], lower[column]);
                }
            }
        }
        if !moved {
            break;
        }
    }
    rotation
}

/// Cosine and sine of the inner rotation: half the angle of the leading eigenvector of Σ ggᵀ with
/// `g = (M_pp − M_qq, M_pq + M_qp)`, taken in the right half-plane.
fn best_rotation(matrices: &[Matrix; 3], p: usize, q: usize) -> (f64, f64) {
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for m in matrices {
        let (x, y) = (m[p][p] - m[q][q], m[p][q] + m[q][p]);
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
    }
    let double_angle = (2.0 * xy).atan2(xx - yy) / 2.0;
    let (x, y) = (double_angle.cos(), double_angle.sin());
    let cosine = (0.5 + x / 2.0).sqrt();
    (cosine, 0.5 * y / cosine)
}
