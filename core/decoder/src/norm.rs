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

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Mean and deviation in f64, two passes.
    fn exact(values: &[f32], epsilon: f64) -> Vec<f64> {
        let n = values.len() as f64;
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
        let variance = values.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / n;
        values.iter().map(|v| (f64::from(*v) - mean) / (variance + epsilon).sqrt()).collect()
    }

    #[test]
    fn channels_far_from_zero_are_normalised_too() {
        let extent = Extent { frames: 7, channels: 3, height: 5, width: 19 };
        let each = extent.values() / 3;
        let levels = [0.0, 100.0, -0.999];
        let spreads = [1.0, 0.5, 1e-3];
        let dense: Vec<f32> =
            (0..extent.values()).map(|i| levels[i / each] + spreads[i / each] * (i as f32 * 0.7).sin()).collect();
        let mut volume = Volume::from_dense(extent, 1, &dense, false).unwrap();
        instance_norm(&mut volume);
        let got = volume.to_dense();
        for c in 0..3 {
            let want = exact(&dense[c * each..(c + 1) * each], INSTANCE_EPSILON);
            for (got, want) in got[c * each..].iter().zip(want) {
                assert!((f64::from(*got) - want).abs() < 2e-5, "channel {c}: {got} {want}");
            }
        }
    }

    #[test]
    fn rows_are_normalised_by_themselves() {
        let rows: Vec<f32> = (0..24).map(|i| (i as f32).cos() + 5.0).collect();
        let (gain, offset): (Vec<f32>, Vec<f32>) = (0..8).map(|i| (1.0 + i as f32, 0.1 * i as f32)).unzip();
        let got = layer_norm(&rows, &gain, &offset);
        for (row, got) in rows.chunks(8).zip(got.chunks(8)) {
            for (c, want) in exact(row, 1e-6).into_iter().enumerate() {
                assert!((f64::from(got[c]) - (want * f64::from(gain[c]) + f64::from(offset[c]))).abs() < 1e-5);
            }
        }
    }
}
