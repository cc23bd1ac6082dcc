//! How pixels become a network's numbers, labels become a target, and recordings become chunks.
//!
//! The toolbox normalises a whole recording before it cuts it; a stream can only normalise what it holds. Both are the same
//! function here: give it the recording, or a chunk. Numbers that have no value (0/0 where nothing varies) become 0.

use std::sync::OnceLock;

use crate::input::Normalisation;

/// The guard of [`Normalisation::DiffNormalized`] against black pixels.
const GUARD: f64 = 1e-7;

/// The scalars of a normalisation, measured over frames, to be applied to these or to parts of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scaling {
    normalisation: Normalisation,
    centre: f64,
    deviation: f64,
}

impl Scaling {
    /// Measures the scalars over all of `frames`, of `frame_bytes` codes each.
    pub fn of(frames: &[u8], frame_bytes: usize, normalisation: Normalisation) -> Self {
        let (centre, deviation) = match normalisation {
            Normalisation::Raw => (0.0, 1.0),
            Normalisation::Standardized => {
                let n = frames.len() as f64;
                let (sum, squares) = frames.iter().fold((0u64, 0u64), |(sum, squares), code| {
                    (sum + u64::from(*code), squares + u64::from(*code) * u64::from(*code))
                });
                let mean = sum as f64 / n;
                // Sums of integers are exact, so the difference of squares loses nothing that matters.
                (mean, (squares as f64 / n - mean * mean).max(0.0).sqrt())
            }
            Normalisation::DiffNormalized => {
                let next = frames.get(frame_bytes..).unwrap_or(&[]);
                let relative = |(next, this): (&u8, &u8)| f64::from(relative_difference(*next, *this));
                let n = next.len() as f64;
                let mean = next.iter().zip(frames).map(relative).sum::<f64>() / n;
                let squares = next.iter().zip(frames).map(|pair| (relative(pair) - mean).powi(2)).sum::<f64>();
                (0.0, (squares / n).sqrt())
            }
        };
        Self { normalisation, centre, deviation }
    }

    /// Whether nothing varies over what was measured, so that every number becomes 0.
    pub fn is_flat(&self) -> bool {
        self.deviation.is_nan() || self.deviation == 0.0
    }

    /// Numbers of `frames`; `next` is the frame after them, empty at the end of a recording.
    pub fn apply(&self, frames: &[u8], next: &[u8], frame_bytes: usize) -> Vec<f32> {
        let number = |value: f64| if value.is_finite() { value as f32 } else { 0.0 };
        match self.normalisation {
            Normalisation::Raw => frames.iter().map(|code| f32::from(*code)).collect(),
            Normalisation::Standardized => {
                let of_code: Vec<f32> =
                    (0..=255u8).map(|code| number((f64::from(code) - self.centre) / self.deviation)).collect();
                frames.iter().map(|code| of_code[usize::from(*code)]).collect()
            }
            Normalisation::DiffNormalized => {
                let later = frames.get(frame_bytes..).unwrap_or(&[]).iter().chain(next);
                let relative =
                    |(next, this): (&u8, &u8)| number(f64::from(relative_difference(*next, *this)) / self.deviation);
                let mut out: Vec<f32> = later.zip(frames).map(relative).collect();
                out.resize(frames.len(), 0.0);
                out
            }
        }
    }
}

/// Change from one code to the next over their sum.
fn relative_difference(next: u8, this: u8) -> f32 {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        let of = |index: u32| {
            let (next, this) = (f64::from(index >> 8), f64::from(index & 255));
            ((next - this) / (next + this + GUARD)) as f32
        };
        (0..1 << 16).map(of).collect()
    });
    table[usize::from(next) << 8 | usize::from(this)]
}

/// Frames of `frame_bytes` codes each under one normalisation, same layout and length.
///
/// The scalars (mean, standard deviation) are over all frames given. A trailing part of a frame is dropped.
pub fn normalised(frames: &[u8], frame_bytes: usize, normalisation: Normalisation) -> Vec<f32> {
    let frames = if frame_bytes == 0 { &[][..] } else { &frames[..frames.len() - frames.len() % frame_bytes] };
    Scaling::of(frames, frame_bytes, normalisation).apply(frames, &[], frame_bytes)
}

/// A label as the derivative networks are trained on: differences over their standard deviation, a 0 at the end.
pub fn label_difference(label: &[f64]) -> Vec<f64> {
    let differences: Vec<f64> = label.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut out = scaled(&differences, 0.0);
    out.resize(label.len(), 0.0);
    out
}

/// A label less its mean, over its standard deviation.
pub fn label_standardised(label: &[f64]) -> Vec<f64> {
    scaled(label, label.iter().sum::<f64>() / label.len() as f64)
}

/// Values less `centre` over their population deviation; 0 where that has no value.
fn scaled(values: &[f64], centre: f64) -> Vec<f64> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let deviation = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt();
    let scale = |value: &f64| (value - centre) / deviation;
    values.iter().map(scale).map(|value| if value.is_finite() { value } else { 0.0 }).collect()
}

/// A trace of any length on `frames` samples, by straight lines over sample numbers and without times, as the toolbox
/// resamples PURE, MMPD and iBVP labels. Nothing of nothing.
pub fn resampled_to_frames(trace: &[f64], frames: usize) -> Vec<f64> {
    let Some(last) = trace.len().checked_sub(1) else { return Vec::new() };
    let step = if frames > 1 { last as f64 / (frames - 1) as f64 } else { 0.0 };
    let at = |frame: usize| {
        let position = (frame as f64 * step).min(last as f64);
        let before = position.floor() as usize;
        let after = (before + 1).min(last);
        trace[before] + (position - before as f64) * (trace[after] - trace[before])
    };
    (0..frames).map(at).collect()
}

/// How many whole chunks fit; the frames after the last one are dropped.
pub fn chunk_count(frames: usize, chunk_frames: usize) -> usize {
    frames.checked_div(chunk_frames).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_vary_becomes_zero_and_never_nan() {
        for kind in [Normalisation::DiffNormalized, Normalisation::Standardized] {
            for frames in [&[0u8; 24][..], &[200; 24], &[0, 0, 0], &[]] {
                assert_eq!(normalised(frames, 3, kind), vec![0.0; frames.len()], "{kind:?}");
            }
        }
        assert_eq!(normalised(&[1, 2, 3, 4], 3, Normalisation::Raw), [1.0, 2.0, 3.0]);
        assert!(normalised(&[1, 2], 0, Normalisation::DiffNormalized).is_empty());
        assert_eq!(label_difference(&[]), [0.0; 0]);
        assert_eq!(label_standardised(&[4.0; 3]), [0.0; 3]);
        assert_eq!(label_difference(&[f64::NAN, 1.0, 2.0]), [0.0; 3]);
        assert_eq!((chunk_count(10, 0), chunk_count(359, 180)), (0, 1));
    }

    #[test]
    fn chunks_of_a_clip_differ_from_the_clip_only_by_their_scale() {
        let frames: Vec<u8> = (0..30 * 12).map(|i| (i * 31 % 200) as u8).collect();
        let (whole, part) = (
            normalised(&frames, 12, Normalisation::DiffNormalized),
            normalised(&frames[..15 * 12], 12, Normalisation::DiffNormalized),
        );
        let ratio = part[7] / whole[7];
        assert!((0..14 * 12).all(|i| (part[i] - ratio * whole[i]).abs() < 1e-5) && part[14 * 12..] == [0.0; 12]);
    }

    #[test]
    fn resampling_keeps_both_ends() {
        assert_eq!(resampled_to_frames(&[1.0, 3.0], 3), [1.0, 2.0, 3.0]);
        assert_eq!(resampled_to_frames(&[5.0], 2), [5.0, 5.0]);
        assert_eq!(resampled_to_frames(&[5.0, 6.0], 1), [5.0]);
        assert!(resampled_to_frames(&[], 4).is_empty());
    }
}
