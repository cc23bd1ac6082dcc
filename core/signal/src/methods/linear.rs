//! LGI, PBV and OMIT: one linear projection of the three mean-colour channels over the whole recording.

use crate::error::{Result, SignalError};

use super::eigen::symmetric;
use super::{Rgb, check_colors, window_mean};

/// LGI: the green row after removing the dominant colour direction (first left singular vector) of the recording.
///
/// # Errors
/// When there is no frame or a colour is not finite.
pub fn lgi(rgb: &[Rgb]) -> Result<Vec<f64>> {
    check_colors(rgb)?;
    let mut gram = [[0.0; 3]; 3];
    for color in rgb {
        for i in 0..3 {
            for j in 0..3 {
                gram[i][j] += color[i] * color[j];
            }
        }
    }
    let eigen = symmetric(gram);
    let dominant = (1..3).fold(0, |best, k| if eigen.values[k] > eigen.values[best] { k } else { best });
    Ok(green_without(rgb, eigen.vectors[dominant]))
}

/// OMIT: the green row after removing the first frame's colour direction.
///
/// Follows the toolbox: the QR decomposition there is of channels × frames, so its first column is the first frame only.
///
/// # Errors
/// When there is no frame, a colour is not finite, or the first frame is black.
pub fn omit(rgb: &[Rgb]) -> Result<Vec<f64>> {
    check_colors(rgb)?;
    let first = rgb[0];
    let norm = first.iter().map(|value| value * value).sum::<f64>().sqrt();
    if norm == 0.0 {
        return Err(SignalError::Dark { channel: "whole", value: 0.0, frame: 0 });
    }
    Ok(green_without(rgb, first.map(|value| value / norm)))
}

/// Green component of each colour's part orthogonal to a unit direction.
fn green_without(rgb: &[Rgb], direction: Rgb) -> Vec<f64> {
    let remainder = |color: &Rgb| {
        let along: f64 = color.iter().zip(direction).map(|(value, unit)| value * unit).sum();
        color[1] - along * direction[1]
    };
    rgb.iter().map(remainder).collect()
}

/// PBV: the projection that responds to the recording's own relative pulsatile amplitudes. Not zero-mean.
///
/// # Errors
/// When there is no frame, a colour is not finite, a channel is black, or colours vary in fewer than three directions.
pub fn pbv(rgb: &[Rgb]) -> Result<Vec<f64>> {
    check_colors(rgb)?;
    let mean = window_mean(rgb, 0)?;
    let relative: Vec<Rgb> = rgb.iter().map(|color| std::array::from_fn(|c| color[c] / mean[c])).collect();
    // Variances about each normalised channel's own mean, which is 1 up to rounding.
    let centre: Rgb = std::array::from_fn(|c| relative.iter().map(|x| x[c]).sum::<f64>() / rgb.len() as f64);
    let variance: Rgb =
        std::array::from_fn(|c| relative.iter().map(|x| (x[c] - centre[c]).powi(2)).sum::<f64>() / rgb.len() as f64);
    let total = variance.iter().sum::<f64>().sqrt();
    if total <= 1e-14 {
        return Err(SignalError::Flat("the mean colour"));
    }
    let signature = variance.map(|value| value.sqrt() / total);
    let gram: [[f64; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| relative.iter().map(|x| x[i] * x[j]).sum()));
    let weights = solve(gram, signature).ok_or(SignalError::Flat("the difference between colour channels"))?;
    let scale: f64 = signature.iter().zip(weights).map(|(s, w)| s * w).sum();
    Ok(relative.iter().map(|x| x.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() / scale).collect())
}

/// Gaussian elimination with partial pivoting; `None` when singular to working precision.
fn solve(matrix: [[f64; 3]; 3], right: Rgb) -> Option<Rgb> {
    let mut rows: [[f64; 4]; 3] = std::array::from_fn(|i| [matrix[i][0], matrix[i][1], matrix[i][2], right[i]]);
    let size = matrix.as_flattened().iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    for k in 0..3 {
        let pivot = (k..3).max_by(|&a, &b| rows[a][k].abs().total_cmp(&rows[b][k].abs()))?;
        rows.swap(k, pivot);
        if rows[k][k].abs() <= 1e-15 * size {
            return None;
        }
        let pivot_row = rows[k];
        for row in rows.iter_mut().skip(k + 1) {
            let factor = row[k] / pivot_row[k];
            for (value, upper) in row.iter_mut().zip(pivot_row).skip(k) {
                *value -= factor * upper;
            }
        }
    }
    let mut x = [0.0; 3];
    for k in (0..3).rev() {
        let known: f64 = (k + 1..3).map(|j| rows[k][j] * x[j]).sum();
        x[k] = (rows[k][3] - known) / rows[k][k];
    }
    Some(x)
}
