//! POS and CHROM: chrominance projections of short, mean-normalised windows.

use crate::detrend::{Smoothness, detrend};
use crate::error::{Result, SignalError, check_length};
use crate::filter::{Band, Butterworth, bandpass};
use crate::hilbert::envelope;
use crate::stats::{mean, standard_deviation};

use super::{Rgb, TOOLBOX_SMOOTHNESS, check_colors, check_colors_at, window_mean};

/// Window of POS and CHROM in the papers and the toolbox, seconds: just over one beat at 37.5 bpm.
const WINDOW_SECONDS: f64 = 1.6;

/// How POS normalises colours in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PosWindow {
    /// Overlapping windows of this many seconds, one starting at each frame (Wang et al. 2017, algorithm 1).
    Sliding {
        /// Length, seconds (1.6 in the paper).
        seconds: f64,
    },
    /// One window over the whole recording (the simplified form that Heartian's paper uses on uncompressed video).
    Global,
}

impl PosWindow {
    /// The 1.6 s windows of the POS paper.
    pub const SLIDING: Self = Self::Sliding { seconds: WINDOW_SECONDS };
}

/// POS without detrending or filtering, zero-mean per window; one sample a frame.
///
/// # Errors
/// When colours or rate are unusable, the recording is shorter than a window, or a channel is black over a window.
pub fn pos_trace(rgb: &[Rgb], rate_hertz: f64, window: PosWindow) -> Result<Vec<f64>> {
    let length = match window {
        PosWindow::Global => {
            check_colors(rgb)?;
            rgb.len()
        }
        PosWindow::Sliding { seconds } => {
            check_colors_at(rgb, rate_hertz)?;
            window_length(seconds, rate_hertz)?
        }
    };
    check_length("POS", length.max(2), rgb.len())?;
    overlap_add(rgb, length, rgb.len() - length + 1)
}

/// POS exactly as rPPG-Toolbox computes it: 1.6 s windows, detrended (λ = 100) and band-passed 0.75–3.0 Hz, order 1.
///
/// Differs from the POS paper as the toolbox does: the window that ends with the last frame is left out, so that the last
/// sample is zero before filtering.
///
/// # Errors
/// As [`pos_trace`], and when the band does not fit the rate.
pub fn pos(rgb: &[Rgb], rate_hertz: f64) -> Result<Vec<f64>> {
    pos_smoothed(rgb, rate_hertz, TOOLBOX_SMOOTHNESS)
}

/// [`pos`] with another smoothness of its detrending.
pub(super) fn pos_smoothed(rgb: &[Rgb], rate_hertz: f64, smoothness: Smoothness) -> Result<Vec<f64>> {
    filtered_pos(rgb, rate_hertz, Butterworth::bandpass(1, Band::PAPER, rate_hertz)?, smoothness)
}

/// The toolbox's pseudo label: POS at order 2 over 0.70–3.0 Hz, divided by its own envelope.
///
/// # Errors
/// As [`pos`].
pub fn pseudo_label(rgb: &[Rgb], rate_hertz: f64) -> Result<Vec<f64>> {
    let filter = Butterworth::bandpass(2, Band { low_hertz: 0.7, high_hertz: 3.0 }, rate_hertz)?;
    let trace = filtered_pos(rgb, rate_hertz, filter, TOOLBOX_SMOOTHNESS)?;
    let heights = envelope(&trace)?;
    let scaled = trace.iter().zip(&heights).map(|(value, height)| if *height > 0.0 { value / height } else { 0.0 });
    Ok(scaled.collect())
}

fn filtered_pos(rgb: &[Rgb], rate_hertz: f64, filter: Butterworth, smoothness: Smoothness) -> Result<Vec<f64>> {
    check_colors_at(rgb, rate_hertz)?;
    let length = window_length(WINDOW_SECONDS, rate_hertz)?;
    check_length("POS", (length + 1).max(filter.padding() + 1), rgb.len())?;
    let trace = overlap_add(rgb, length, rgb.len() - length)?;
    filter.filtfilt(&detrend(&trace, smoothness.lambda(rate_hertz))?)
}

fn window_length(seconds: f64, rate_hertz: f64) -> Result<usize> {
    let length = (seconds * rate_hertz).ceil();
    if (2.0..=1e9).contains(&length) {
        Ok(length as usize)
    } else {
        Err(SignalError::Setting { name: "POS's window", value: seconds, range: "at least two frames long" })
    }
}

/// Adds up the projections of the first `count` windows of `length` frames.
fn overlap_add(rgb: &[Rgb], length: usize, count: usize) -> Result<Vec<f64>> {
    let mut trace = vec![0.0; rgb.len()];
    let (mut first, mut second) = (vec![0.0; length], vec![0.0; length]);
    for start in 0..count {
        let window = &rgb[start..start + length];
        let scale = window_mean(window, start)?.map(f64::recip);
        for (frame, color) in window.iter().enumerate() {
            let [r, g, b] = [color[0] * scale[0], color[1] * scale[1], color[2] * scale[2]];
            first[frame] = g - b;
            second[frame] = g + b - 2.0 * r;
        }
        let alpha = ratio(standard_deviation(&first), standard_deviation(&second));
        let centre = mean(&first) + alpha * mean(&second);
        for (frame, value) in trace[start..start + length].iter_mut().enumerate() {
            *value += first[frame] + alpha * second[frame] - centre;
        }
    }
    Ok(trace)
}

/// CHROM: windows of `ceil(1.6·rate)` frames (made even) hopping by half, band-passed (order 3, 0.7–2.5 Hz), Hann-weighted.
/// The result has `half·(windows + 1)` samples, at most as many as frames.
///
/// Differs from the paper as the toolbox does: the second half of each window overwrites rather than adds.
///
/// # Errors
/// When colours or rate are unusable (windows must be longer than the filter's padding: 14 Hz and more), the recording is
/// shorter than a window, or a channel is black over one.
pub fn chrom(rgb: &[Rgb], rate_hertz: f64) -> Result<Vec<f64>> {
    check_colors_at(rgb, rate_hertz)?;
    let filter = Butterworth::bandpass(3, Band { low_hertz: 0.7, high_hertz: 2.5 }, rate_hertz)?;
    let length = window_length(WINDOW_SECONDS, rate_hertz)?.next_multiple_of(2);
    check_length("CHROM", length, rgb.len())?;
    let half = length / 2;
    let windows = (rgb.len() - half) / half;
    let hann: Vec<f64> =
        (0..length).map(|i| 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / (length - 1) as f64).cos()).collect();
    let mut trace = vec![0.0; half * (windows + 1)];
    for start in (0..windows).map(|window| window * half) {
        let colors = &rgb[start..start + length];
        let [r, g, b] = window_mean(colors, start)?.map(f64::recip);
        let project = |weights: Rgb| -> Result<Vec<f64>> {
            let [wr, wg, wb] = [weights[0] * r, weights[1] * g, weights[2] * b];
            let x: Vec<f64> = colors.iter().map(|color| wr * color[0] + wg * color[1] + wb * color[2]).collect();
            filter.filtfilt(&x)
        };
        let (x, y) = (project([3.0, -2.0, 0.0])?, project([1.5, 1.0, -1.5])?);
        let alpha = ratio(standard_deviation(&x), standard_deviation(&y));
        for frame in 0..length {
            let value = (x[frame] - alpha * y[frame]) * hann[frame];
            let into = &mut trace[start + frame];
            *into = if frame < half { *into + value } else { value };
        }
    }
    Ok(trace)
}

/// `a/b`, and 0 where `b` is 0: a window without variation adds nothing.
fn ratio(a: f64, b: f64) -> f64 {
    if b > 0.0 { a / b } else { 0.0 }
}

/// POS's phase-ready form for the weak phase prior: the trace of the chosen window, detrended (as λ = 100 at 30 Hz) and band-passed
/// over the paper's band without the toolbox's missing last window.
///
/// # Errors
/// As [`pos_trace`], and when the band does not fit the rate.
pub fn pos_filtered(rgb: &[Rgb], rate_hertz: f64, window: PosWindow) -> Result<Vec<f64>> {
    let trace = pos_trace(rgb, rate_hertz, window)?;
    bandpass(&detrend(&trace, Smoothness::AsAt30Hertz(100.0).lambda(rate_hertz))?, rate_hertz, Band::PAPER, 1)
}
