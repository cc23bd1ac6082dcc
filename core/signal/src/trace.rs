//! The mean colour of each frame of a clip, and the heart rate that a classical method reads from it.
//!
//! Means are of sRGB codes 0–255 as the toolbox takes them (not of linear light). Sums are of integers, hence exact and
//! the same at any thread count.

use heartian_space::Clip;
use rayon::prelude::*;

use crate::error::{Result, SignalError, check_length};
use crate::methods::{Method, Rgb};
use crate::protocol::{HeartRate, Preset, resampled_evenly};

/// Which pixels count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Weighting {
    /// All of the frame, matte or not (the toolbox on a face crop).
    #[default]
    WholeFrame,
    /// Each pixel by its alpha.
    Alpha,
}

/// Mean RGB of each frame, codes 0–255.
///
/// # Errors
/// With [`Weighting::Alpha`], when a frame has no pixel under the matte.
pub fn mean_rgb(clip: &Clip, weighting: Weighting) -> Result<Vec<Rgb>> {
    let mean = |frame: usize| match weighting {
        Weighting::WholeFrame => {
            let count = (clip.width * clip.height) as f64;
            Ok(channel_sums(clip.frame(frame)).map(|sum| sum as f64 / count))
        }
        Weighting::Alpha => {
            let alpha = clip.frame_alpha(frame);
            let total: u64 = alpha.iter().map(|&a| u64::from(a)).sum();
            if total == 0 {
                return Err(SignalError::Masked { frame });
            }
            Ok(weighted_sums(clip.frame(frame), alpha).map(|sum| sum as f64 / total as f64))
        }
    };
    // Gathered before the first error is taken: at any number of threads it names the first frame.
    let means: Vec<Result<Rgb>> = (0..clip.len()).into_par_iter().map(mean).collect();
    means.into_iter().collect()
}

/// The heart rate a classical method reads from a clip: mean RGB, evened out in time, the method, the protocol
/// (whose smoothness the method's own detrending shares).
///
/// # Errors
/// As [`mean_rgb`], [`Method::trace`] and [`estimate`](crate::estimate); a clip of one frame has no rate.
pub fn clip_heart_rate(clip: &Clip, weighting: Weighting, method: Method, preset: Preset) -> Result<HeartRate> {
    check_length("a heart rate", 2, clip.len())?;
    let (rgb, rate_hertz) = even_rgb(&clip.times_seconds, &mean_rgb(clip, weighting)?)?;
    let protocol = preset.protocol();
    protocol.estimate(&method.trace_smoothed(&rgb, rate_hertz, protocol.detrend)?, rate_hertz)
}

/// Colours on the even grid of their mean rate, and that rate in hertz.
///
/// # Errors
/// As [`resampled_evenly`].
pub fn even_rgb(times_seconds: &[f64], rgb: &[Rgb]) -> Result<(Vec<Rgb>, f64)> {
    let mut even = rgb.to_vec();
    let mut rate_hertz = 0.0;
    for channel in 0..3 {
        let values: Vec<f64> = rgb.iter().map(|color| color[channel]).collect();
        let trace = resampled_evenly(times_seconds, &values)?;
        rate_hertz = trace.rate_hertz;
        for (color, value) in even.iter_mut().zip(trace.values) {
            color[channel] = value;
        }
    }
    Ok((even, rate_hertz))
}

/// Bytes added lane by lane before lanes are folded: a multiple of 3 (a channel keeps its lane) and of 16 (SIMD width).
const LANES: usize = 48;
/// Rows of lanes that 16-bit sums hold: 257·255 = 65,535.
const ROWS: usize = 257;

/// Sum of each channel of interleaved RGB.
fn channel_sums(pixels: &[u8]) -> [u64; 3] {
    let mut sums = [0u64; 3];
    for block in pixels.chunks(LANES * ROWS) {
        let (rows, rest) = block.as_chunks::<LANES>();
        let mut lanes = [0u16; LANES];
        for row in rows {
            for (lane, byte) in lanes.iter_mut().zip(row) {
                // Cannot overflow within ROWS rows; wrapping keeps the loop free of checks, so that it vectorises.
                *lane = lane.wrapping_add(u16::from(*byte));
            }
        }
        for (lane, value) in lanes.into_iter().enumerate() {
            sums[lane % 3] += u64::from(value);
        }
        for (lane, byte) in rest.iter().enumerate() {
            sums[lane % 3] += u64::from(*byte);
        }
    }
    sums
}

/// Pixels that [`LANES`] bytes hold.
const PIXELS: usize = LANES / 3;

/// Sum of each channel times alpha. A matte is opaque or empty nearly everywhere: sixteen pixels at once where it is.
fn weighted_sums(pixels: &[u8], alpha: &[u8]) -> [u64; 3] {
    let mut sums = [0u64; 3];
    for (colors, weights) in pixels.chunks(LANES * ROWS).zip(alpha.chunks(PIXELS * ROWS)) {
        let ((rows, rest), (weight_rows, weight_rest)) = (colors.as_chunks::<LANES>(), weights.as_chunks::<PIXELS>());
        let mut opaque = [0u16; LANES];
        let mut partial = [0u64; 3];
        for (row, weights) in rows.iter().zip(weight_rows) {
            match u128::from_ne_bytes(*weights) {
                0 => {}
                u128::MAX => {
                    for (lane, byte) in opaque.iter_mut().zip(row) {
                        *lane = lane.wrapping_add(u16::from(*byte));
                    }
                }
                _ => add_products(&mut partial, row, weights),
            }
        }
        add_products(&mut partial, rest, weight_rest);
        for (lane, value) in opaque.into_iter().enumerate() {
            sums[lane % 3] += 255 * u64::from(value);
        }
        for channel in 0..3 {
            sums[channel] += partial[channel];
        }
    }
    sums
}

/// Adds each channel times alpha, pixel by pixel; at most a few thousand pixels.
fn add_products(sums: &mut [u64; 3], pixels: &[u8], alpha: &[u8]) {
    let mut products = [0u32; 3];
    for (color, &weight) in pixels.as_chunks::<3>().0.iter().zip(alpha) {
        for channel in 0..3 {
            products[channel] = products[channel].wrapping_add(u32::from(color[channel]) * u32::from(weight));
        }
    }
    for channel in 0..3 {
        sums[channel] += u64::from(products[channel]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_space::Sequence;

    fn clip(size: usize, frames: usize, color: impl Fn(usize, usize) -> [u8; 3], alpha: u8) -> Option<Clip> {
        let pixels = size * size;
        let sequence = Sequence {
            frames: (0..frames).flat_map(|t| (0..pixels).map(move |p| (t, p))).flat_map(|(t, p)| color(t, p)).collect(),
            alpha: (0..frames * pixels).map(|p| if p % pixels == 0 { 255 } else { alpha }).collect(),
            times_seconds: (0..frames).map(|t| t as f64 / 30.0).collect(),
        };
        Clip::new("test", size, size, sequence).ok()
    }

    #[test]
    fn sums_are_the_plain_ones_at_any_length() {
        for pixels in [0, 1, 5, 16, 17, 4111, 4112, 4113, 70_001, (1 << 20) + 35] {
            let data: Vec<u8> =
                (0..3 * pixels).map(|i| (i * 31 % 256).max(usize::from(i % 7 == 0) * 255) as u8).collect();
            let alpha: Vec<u8> = (0..pixels).map(|i| [0, 255, (i * 17 % 256) as u8][i / 200 % 3]).collect();
            let plain = |weight: &dyn Fn(usize) -> u64| {
                let mut sums = [0u64; 3];
                data.iter().enumerate().for_each(|(i, &byte)| sums[i % 3] += u64::from(byte) * weight(i / 3));
                sums
            };
            assert_eq!(channel_sums(&data), plain(&|_| 1));
            assert_eq!(weighted_sums(&data, &alpha), plain(&|p| u64::from(alpha[p])));
            assert_eq!(weighted_sums(&vec![255; 3 * pixels], &vec![255; pixels]), [65_025 * pixels as u64; 3]);
        }
    }

    #[test]
    fn pos_on_a_clip_reads_the_pulse_that_was_painted() -> std::result::Result<(), Box<dyn std::error::Error>> {
        // Dithered codes: each pixel rounds at its own threshold, so the mean moves by less than a code.
        // Sensor noise of a tenth of the pulse, different in each channel, and light that drifts by a percent.
        let paint = |t: usize, p: usize| {
            let seconds = t as f64 / 30.0;
            let beat = (std::f64::consts::TAU * 66.0 / 60.0 * seconds).sin();
            let light = 1.0 + 0.01 * (std::f64::consts::TAU * 0.13 * seconds).sin();
            let dither = (p * 7919 % 1000) as f64 / 1000.0;
            let noise = |channel: usize| {
                let mixed = ((3 * t + channel + 1) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                ((mixed ^ (mixed >> 32)) % 1000) as f64 / 1000.0 - 0.5
            };
            let pulse = [0.3, 0.9, 0.5];
            std::array::from_fn(|c| (light * [170.0, 110.0, 90.0][c] + pulse[c] * beat + 0.3 * noise(c) + dither) as u8)
        };
        let clip = clip(24, 450, paint, 255).ok_or("clip")?;
        for method in Method::ALL {
            let rate = clip_heart_rate(&clip, Weighting::Alpha, method, Preset::Paper)?;
            assert!((rate.bpm - 66.0).abs() < 0.5, "{}: {}", method.name(), rate.bpm);
        }
        Ok(())
    }

    #[test]
    fn alpha_weighs_and_an_empty_matte_is_refused() -> std::result::Result<(), Box<dyn std::error::Error>> {
        let clip = clip(2, 1, |_, p| if p == 0 { [10, 20, 30] } else { [200; 3] }, 0).ok_or("clip")?;
        assert_eq!(mean_rgb(&clip, Weighting::Alpha)?, [[10.0, 20.0, 30.0]]);
        assert_eq!(mean_rgb(&clip, Weighting::WholeFrame)?, [[152.5, 155.0, 157.5]]);
        let refused = clip_heart_rate(&clip, Weighting::Alpha, Method::Pos, Preset::Paper);
        assert!(matches!(refused, Err(SignalError::TooShort { .. })));
        let mut bare = clip;
        bare.alpha.fill(0);
        assert!(matches!(mean_rgb(&bare, Weighting::Alpha), Err(SignalError::Masked { frame: 0 })));
        Ok(())
    }
}
