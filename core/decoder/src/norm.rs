//! Normalisations that look at the data: over a whole channel, and over a token's channels. Sums in f64.

use heartian_ops::{Extent, Volume};
use rayon::prelude::*;

/// ε of the instance norm.
const INSTANCE_EPSILON: f64 = 1e-5;

/// Each channel less its mean over frames, rows and columns, over its standard deviation (biased).
pub fn instance_norm(volume: &mut Volume) {
    let Extent { frames, channels, height, width } = volume.extent();
    let count = (frames * height * width).max(1) as f64;
    let means: Vec<f32> =
        channel_sums(volume, |row, _| lanes_sum(row, |v| v)).iter().map(|s| (s / count) as f32).collect();
    // Squares about a rounded mean: what the rounding adds is the square of the sum's rest.
    let rests = channel_sums(volume, |row, c| lanes_sum(row, |v| v - means[c]));
    let squares = channel_sums(volume, |row, c| lanes_sum(row, |v| (v - means[c]) * (v - means[c])));
    let scales: Vec<(f32, f32)> = (0..channels)
        .map(|c| {
            let rest = rests[c] / count;
            let scale = 1.0 / (squares[c] / count - rest * rest + INSTANCE_EPSILON).sqrt();
            (scale as f32, (-rest * scale) as f32)
        })
        .collect();
    volume.par_frames_mut().for_each(|mut frame| {
        for c in 0..channels {
            let (mean, (scale, shift)) = (means[c], scales[c]);
            for y in 0..height {
                frame.row_mut(c, y).iter_mut().for_each(|v| *v = (*v - mean) * scale + shift);
            }
        }
    });
}

/// Sums over every row of each channel, frames in order.
fn channel_sums(volume: &Volume, row_sum: impl Fn(&[f32], usize) -> f64 + Sync) -> Vec<f64> {
    let Extent { frames, channels, height, .. } = volume.extent();
    let by_frame: Vec<Vec<f64>> = (0..frames)
        .into_par_iter()
        .map(|t| (0..channels).map(|c| (0..height).map(|y| row_sum(volume.row(t, c, y), c)).sum()).collect())
        .collect();
    (0..channels).map(|c| by_frame.iter().map(|sums| sums[c]).sum()).collect()
}

/// A short sum in eight lanes, then f64.
#[inline(always)]
fn lanes_sum(row: &[f32], term: impl Fn(f32) -> f32) -> f64 {
    let mut lanes = [0.0f32; 8];
    let (blocks, tail) = row.as_chunks::<8>();
    for block in blocks {
        for lane in 0..8 {
            lanes[lane] += term(block[lane]);
        }
    }
    lanes.iter().map(|v| f64::from(*v)).sum::<f64>() + tail.iter().map(|v| f64::from(term(*v))).sum::<f64>()
}

/// Each row less its mean, over its standard deviation (biased, ε = 10⁻⁶), times `gain`, plus `offset`.
pub fn layer_norm(rows: &[f32], gain: &[f32], offset: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; rows.len()];
    let width = gain.len().max(1);
    for (out, row) in out.chunks_exact_mut(width).zip(rows.chunks_exact(width)) {
        let mean = row.iter().map(|v| f64::from(*v)).sum::<f64>() / width as f64;
        let variance = row.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / width as f64;
        let scale = 1.0 / (variance + 1e-6).sqrt();
        for (c, out) in out.iter_mut().enumerate() {
            *out = ((f64::from(row[c]) - mean) * scale) as f32 * gain[c] + offset[c];
        }
    }
    out
}
