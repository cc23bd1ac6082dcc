//! The local beat period along a recording: harmonic spectra of short windows, joined by the smoothest likely path.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;

use crate::error::Result;

use super::condition::Pulse;

/// Window and hop of the short spectra, seconds.
const WINDOW_SECONDS: f64 = 8.0;
const HOP_SECONDS: f64 = 1.0;
/// Number of rates on the logarithmic grid.
const RATES: usize = 96;
/// Cost of a squared step of the logarithm of the rate from hop to hop: a jump by an octave outweighs two windows.
const STEP_COST: f64 = 6.0;
/// Rate of the short spectra's input, hertz: more than twice the second harmonic of any rate.
const SPECTRUM_HERTZ: f64 = 25.0;

/// Beat period over time, interpolated between hops.
pub(super) struct Periods {
    hop_seconds: f64,
    first_seconds: f64,
    seconds: Vec<f64>,
}

impl Periods {
    /// Period around a time, seconds.
    pub(super) fn at(&self, seconds: f64) -> f64 {
        let last = self.seconds.len() - 1;
        let position = ((seconds - self.first_seconds) / self.hop_seconds).clamp(0.0, last as f64);
        let before = (position as usize).min(last);
        let after = (before + 1).min(last);
        let fraction = position - before as f64;
        self.seconds[before] + fraction * (self.seconds[after] - self.seconds[before])
    }
}

/// Tracks the period of a conditioned pulse within a range of rates (hertz).
pub(super) fn track(pulse: &Pulse, range_hertz: [f64; 2]) -> Result<Periods> {
    let stride = (pulse.rate_hertz / SPECTRUM_HERTZ).floor().max(1.0) as usize;
    let rate = pulse.rate_hertz / stride as f64;
    let coarse: Vec<f64> = pulse.values.iter().step_by(stride).copied().collect();
    let window = ((WINDOW_SECONDS * rate) as usize).min(coarse.len());
    let hop = ((HOP_SECONDS * rate) as usize).max(1);
    let grid: Vec<f64> = (0..RATES)
        .map(|k| range_hertz[0] * (range_hertz[1] / range_hertz[0]).powf(k as f64 / (RATES - 1) as f64))
        .collect();
    let scores: Vec<Vec<f64>> = (0..=coarse.len() - window)
        .step_by(hop)
        .map(|start| harmonic_shares(&coarse[start..start + window], rate, &grid))
        .collect();
    let step = (range_hertz[1] / range_hertz[0]).ln() / (RATES - 1) as f64;
    let seconds = smoothest_path(&scores, step).into_iter().map(|k| 1.0 / grid[k]).collect();
    Ok(Periods { hop_seconds: hop as f64 / rate, first_seconds: window as f64 / rate / 2.0, seconds })
}

/// For each rate, the share of a window's power at the rate and (half-weighted) at its double.
fn harmonic_shares(window: &[f64], rate_hertz: f64, grid_hertz: &[f64]) -> Vec<f64> {
    let n = (window.len() * 8).next_power_of_two();
    let mut spectrum = vec![Complex64::default(); n];
    for (index, (into, value)) in spectrum.iter_mut().zip(window).enumerate() {
        let hann = 0.5 - 0.5 * (std::f64::consts::TAU * (index as f64 + 0.5) / window.len() as f64).cos();
        into.re = hann * value;
    }
    FftPlanner::new().plan_fft_forward(n).process(&mut spectrum);
    let power = |hertz: f64| {
        let bin = (hertz / rate_hertz * n as f64).round() as usize;
        if bin <= n / 2 { spectrum[bin].norm_sqr() } else { 0.0 }
    };
    let raw: Vec<f64> = grid_hertz.iter().map(|&hertz| power(hertz) + 0.5 * power(2.0 * hertz)).collect();
    let most = raw.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    raw.into_iter().map(|value| value / most).collect()
}

/// Indices of the path with the largest sum of scores less squared steps (Viterbi).
fn smoothest_path(scores: &[Vec<f64>], step: f64) -> Vec<usize> {
    let mut best = scores[0].clone();
    let mut back: Vec<Vec<usize>> = Vec::with_capacity(scores.len());
    for row in &scores[1..] {
        let mut next = vec![0.0; RATES];
        let mut from = vec![0; RATES];
        for (here, score) in row.iter().enumerate() {
            let mut most = (f64::NEG_INFINITY, 0);
            for (there, value) in best.iter().enumerate() {
                let jump = (here as f64 - there as f64) * step;
                let total = value - STEP_COST * jump * jump;
                if total > most.0 {
                    most = (total, there);
                }
            }
            (next[here], from[here]) = (most.0 + score, most.1);
        }
        best = next;
        back.push(from);
    }
    let mut at = (1..RATES).fold(0, |most, k| if best[k] > best[most] { k } else { most });
    let mut path = vec![at];
    for from in back.iter().rev() {
        at = from[at];
        path.push(at);
    }
    path.reverse();
    path
}
