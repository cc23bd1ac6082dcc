//! Makes a raw PPG fit for a peak search: outliers bridged, band-passed 0.5–8 Hz, local amplitude evened out, at ≥ 50 Hz.

use crate::error::{Result, SignalError};
use crate::filter::{Band, Butterworth};
use crate::stats::{mean, median, standard_deviation};

/// Lowest rate at which peaks are searched, hertz; slower signals are interpolated up to it.
const SEARCH_HERTZ: f64 = 50.0;
/// Pass band that keeps the shape of the systolic wave.
const SHAPE_BAND: Band = Band { low_hertz: 0.5, high_hertz: 8.0 };
/// Half-width of the windowed-sinc interpolator, input samples.
const SINC_REACH: isize = 12;
/// Windows of the local statistics, seconds.
const LIMIT_SECONDS: f64 = 6.0;
const GAIN_SECONDS: f64 = 3.0;
/// Skewness that counts as a lean.
const CLEAR_LEAN: f64 = 0.15;

/// A conditioned pulse: zero-mean, local deviation about 1.
pub(super) struct Pulse {
    pub(super) values: Vec<f64>,
    pub(super) rate_hertz: f64,
}

/// Conditions a raw PPG.
pub(super) fn condition(signal: &[f64], rate_hertz: f64) -> Result<Pulse> {
    let largest = signal.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let plain = without_outliers(signal, rate_hertz);
    let band = Band { high_hertz: SHAPE_BAND.high_hertz.min(0.45 * rate_hertz), ..SHAPE_BAND };
    let filtered = Butterworth::bandpass(2, band, rate_hertz)?.filtfilt(&plain)?;
    if standard_deviation(&filtered) <= 1e-12 * largest {
        return Err(SignalError::Flat("the PPG"));
    }
    let (dense, rate_hertz) = densify(&filtered, rate_hertz);
    Ok(Pulse { values: even_gain(&dense, rate_hertz), rate_hertz })
}

/// Replaces samples beyond the local 5–95 % range extended by itself on both sides by a line between their neighbours:
/// spikes go, peaky pulses stay.
fn without_outliers(signal: &[f64], rate_hertz: f64) -> Vec<f64> {
    let n = signal.len();
    let window = ((LIMIT_SECONDS * rate_hertz) as usize).clamp(1, n);
    let hop = (window / 3).max(1);
    let mut kept = Vec::with_capacity(n);
    let mut scratch = Vec::with_capacity(window);
    for start in (0..n).step_by(hop) {
        let from = (start + hop / 2).saturating_sub(window / 2).min(n - window);
        scratch.clear();
        scratch.extend_from_slice(&signal[from..from + window]);
        let (at_low, at_high) = (window / 20, window - 1 - window / 20);
        let low = *scratch.select_nth_unstable_by(at_low, f64::total_cmp).1;
        let high = *scratch.select_nth_unstable_by(at_high, f64::total_cmp).1;
        let range = high - low;
        let inside = |index: &usize| (low - range..=high + range).contains(&signal[*index]);
        kept.extend((start..(start + hop).min(n)).filter(inside));
    }
    let mut result = signal.to_vec();
    for pair in kept.windows(2).filter(|pair| pair[1] > pair[0] + 1) {
        let (left, right, gap) = (signal[pair[0]], signal[pair[1]], (pair[1] - pair[0]) as f64);
        for (step, value) in (1..).zip(&mut result[pair[0] + 1..pair[1]]) {
            *value = left + f64::from(step) / gap * (right - left);
        }
    }
    if let (Some(&first), Some(&last)) = (kept.first(), kept.last()) {
        result[..first].fill(signal[first]);
        result[last + 1..].fill(signal[last]);
    }
    result
}

/// Interpolates to at least the search rate by a Hann-windowed sinc over the oddly extended signal.
fn densify(signal: &[f64], rate_hertz: f64) -> (Vec<f64>, f64) {
    let factor = (SEARCH_HERTZ / rate_hertz).ceil().max(1.0) as usize;
    if factor == 1 {
        return (signal.to_vec(), rate_hertz);
    }
    let last = signal.len() as isize - 1;
    let at = |index: isize| {
        let inside = |i: isize| signal[i.clamp(0, last) as usize];
        match index {
            i if i < 0 => 2.0 * signal[0] - inside(-i),
            i if i > last => 2.0 * inside(last) - inside(2 * last - i),
            i => inside(i),
        }
    };
    let kernels: Vec<Vec<f64>> = (0..factor).map(|phase| sinc_kernel(phase as f64 / factor as f64)).collect();
    let count = (signal.len() - 1) * factor + 1;
    let sample = |dense: usize| {
        let (base, kernel) = ((dense / factor) as isize, &kernels[dense % factor]);
        kernel.iter().enumerate().map(|(k, weight)| weight * at(base + k as isize - SINC_REACH + 1)).sum()
    };
    ((0..count).map(sample).collect(), rate_hertz * factor as f64)
}

/// Weights of the samples `−reach+1 … reach` for a position `fraction` after sample 0; they sum to 1.
fn sinc_kernel(fraction: f64) -> Vec<f64> {
    let pi = std::f64::consts::PI;
    let weights: Vec<f64> = (1 - SINC_REACH..=SINC_REACH)
        .map(|k| {
            let x = fraction - k as f64;
            let sinc = if x == 0.0 { 1.0 } else { (pi * x).sin() / (pi * x) };
            sinc * (0.5 + 0.5 * (pi * x / (SINC_REACH as f64 + 1.0)).cos())
        })
        .collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}

/// Divides by the local root mean square (boxcar of a few seconds), floored at a fraction of the whole signal's, so that
/// a dropout is not blown up to look like a pulse.
fn even_gain(signal: &[f64], rate_hertz: f64) -> Vec<f64> {
    let n = signal.len();
    let floor = 0.1 * (signal.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
    let half = ((GAIN_SECONDS * rate_hertz / 2.0) as usize).max(1);
    let mut energy = Vec::with_capacity(n + 1);
    energy.push(0.0);
    for value in signal {
        energy.push(energy[energy.len() - 1] + value * value);
    }
    let gain = |index: usize| {
        let (from, to) = (index.saturating_sub(half), (index + half + 1).min(n));
        ((energy[to] - energy[from]).max(0.0) / (to - from) as f64).sqrt().max(floor).recip()
    };
    signal.iter().enumerate().map(|(index, value)| (value * gain(index)).clamp(-4.0, 4.0)).collect()
}

/// Whether systolic peaks point down. Peaks are narrower than troughs, so values lean upwards; where they hardly lean,
/// the systolic rise is steeper than the fall. Medians over windows, so that artefacts have no vote.
pub(super) fn is_inverted(pulse: &Pulse) -> bool {
    let window = ((LIMIT_SECONDS * pulse.rate_hertz) as usize).clamp(8, pulse.values.len().max(8));
    let lean_of = |signal: &[f64]| {
        let leans: Vec<f64> =
            signal.chunks(window).filter(|part| 2 * part.len() > window).filter_map(skewness).collect();
        median(&leans)
    };
    let slopes: Vec<f64> = pulse.values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let (of_values, of_slopes) = (lean_of(&pulse.values), lean_of(&slopes));
    of_values < -CLEAR_LEAN || (of_values < CLEAR_LEAN && of_slopes < -CLEAR_LEAN)
}

/// Third standardised moment; `None` of a constant.
fn skewness(values: &[f64]) -> Option<f64> {
    let (centre, deviation) = (mean(values), standard_deviation(values));
    let cubes = values.iter().map(|value| ((value - centre) / deviation).powi(3)).sum::<f64>();
    (deviation > 0.0).then(|| cubes / values.len() as f64)
}
