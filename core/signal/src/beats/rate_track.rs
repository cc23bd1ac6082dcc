//! The local beat period along a recording: harmonic spectra of short windows, joined by the smoothest likely path.

use std::sync::Arc;

use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use super::condition::Pulse;

/// Window and hop of the short spectra, seconds.
const WINDOW_SECONDS: f64 = 8.0;
const HOP_SECONDS: f64 = 1.0;
/// Number of rates on the logarithmic grid.
const RATES: usize = 96;
/// Cost of a squared step of the logarithm of the rate from hop to hop: an octave's jump outweighs a clear window.
const STEP_COST: f64 = 12.0;
/// Rate of the short spectra's input, hertz: fine enough to interpolate an autocorrelation of 8 Hz content linearly.
const SPECTRUM_HERTZ: f64 = 50.0;
/// Weights of the first harmonics: less than 1/k each, so that half the true rate, which meets every harmonic at an even
/// multiple, scores at most half.
const HARMONICS: [f64; 4] = [1.0, 0.5, 0.33, 0.25];
/// Half-width of a harmonic in the Hann-windowed spectrum, hertz.
const LINE_HERTZ: f64 = 0.2;

/// Beat period and clarity over time, interpolated between hops.
pub(super) struct Periods {
    hop_seconds: f64,
    first_seconds: f64,
    seconds: Vec<f64>,
    clarity: Vec<f64>,
}

impl Periods {
    /// Period around a time, seconds.
    pub(super) fn at(&self, seconds: f64) -> f64 {
        self.interpolated(&self.seconds, seconds)
    }

    /// How alike consecutive beats are around a time: the autocorrelation at the period, at most 1.
    pub(super) fn clarity_at(&self, seconds: f64) -> f64 {
        self.interpolated(&self.clarity, seconds)
    }

    fn interpolated(&self, values: &[f64], seconds: f64) -> f64 {
        let last = values.len() - 1;
        let position = ((seconds - self.first_seconds) / self.hop_seconds).clamp(0.0, last as f64);
        let before = (position as usize).min(last);
        let after = (before + 1).min(last);
        values[before] + (position - before as f64) * (values[after] - values[before])
    }
}

/// Tracks the period of a conditioned pulse within a range of rates (hertz).
pub(super) fn track(pulse: &Pulse, range_hertz: [f64; 2]) -> Periods {
    let stride = (pulse.rate_hertz / SPECTRUM_HERTZ).floor().max(1.0) as usize;
    let rate = pulse.rate_hertz / stride as f64;
    let coarse: Vec<f64> = pulse.values.iter().step_by(stride).copied().collect();
    let window = ((WINDOW_SECONDS * rate) as usize).min(coarse.len());
    let hop = ((HOP_SECONDS * rate) as usize).max(1);
    let grid: Vec<f64> = (0..RATES)
        .map(|k| range_hertz[0] * (range_hertz[1] / range_hertz[0]).powf(k as f64 / (RATES - 1) as f64))
        .collect();
    let analyser = Analyser::new(window, rate);
    let windows: Vec<Vec<Evidence>> = (0..=coarse.len() - window)
        .step_by(hop)
        .map(|start| analyser.evidence(&coarse[start..start + window], &grid))
        .collect();
    let scores: Vec<Vec<f64>> = windows
        .iter()
        .map(|rates| rates.iter().map(|evidence| 2.0 * evidence.harmonic_share + evidence.correlation).collect())
        .collect();
    let step = (range_hertz[1] / range_hertz[0]).ln() / (RATES - 1) as f64;
    let path = smoothest_path(&scores, step);
    Periods {
        hop_seconds: hop as f64 / rate,
        first_seconds: window as f64 / rate / 2.0,
        seconds: path.iter().map(|&k| 1.0 / grid[k]).collect(),
        clarity: path.iter().zip(&windows).map(|(&k, window)| window[k].correlation).collect(),
    }
}

/// What a window says for one rate.
#[derive(Clone, Copy, Default)]
struct Evidence {
    /// Weighted share of the power at the rate's harmonics: rejects half the true rate.
    harmonic_share: f64,
    /// Autocorrelation at the rate's period: rejects twice the true rate.
    correlation: f64,
}

/// Transforms windows of one length.
struct Analyser {
    rate_hertz: f64,
    points: usize,
    taper: Vec<f64>,
    taper_correlation: Vec<f64>,
    forward: Arc<dyn Fft<f64>>,
}

impl Analyser {
    fn new(window: usize, rate_hertz: f64) -> Self {
        let points = (window * 4).next_power_of_two();
        let taper: Vec<f64> =
            (0..window).map(|k| 0.5 - 0.5 * (std::f64::consts::TAU * (k as f64 + 0.5) / window as f64).cos()).collect();
        let forward = FftPlanner::new().plan_fft_forward(points);
        let mut analyser = Self { rate_hertz, points, taper, taper_correlation: Vec::new(), forward };
        analyser.taper_correlation = analyser.correlation(&analyser.power(&vec![1.0; window]));
        analyser
    }

    /// Power per bin of the tapered window.
    fn power(&self, window: &[f64]) -> Vec<f64> {
        let mut spectrum = vec![Complex64::default(); self.points];
        for ((into, value), taper) in spectrum.iter_mut().zip(window).zip(&self.taper) {
            into.re = taper * value;
        }
        self.forward.process(&mut spectrum);
        spectrum.iter().map(Complex64::norm_sqr).collect()
    }

    /// Autocorrelation per lag; the forward transform serves, power being even.
    fn correlation(&self, power: &[f64]) -> Vec<f64> {
        let mut spectrum: Vec<Complex64> = power.iter().map(|&value| Complex64::new(value, 0.0)).collect();
        self.forward.process(&mut spectrum);
        spectrum.iter().map(|value| value.re).collect()
    }

    fn evidence(&self, window: &[f64], grid_hertz: &[f64]) -> Vec<Evidence> {
        let power = self.power(window);
        let half = &power[..self.points / 2];
        let cumulative: Vec<f64> = std::iter::once(0.0)
            .chain(half.iter().scan(0.0, |sum, value| {
                *sum += value;
                Some(*sum)
            }))
            .collect();
        let total = cumulative[half.len()];
        if total <= 0.0 {
            return vec![Evidence::default(); grid_hertz.len()];
        }
        let bin =
            |hertz: f64| ((hertz / self.rate_hertz * self.points as f64).round().max(0.0) as usize).min(half.len());
        let line = |hertz: f64| (cumulative[bin(hertz + LINE_HERTZ)] - cumulative[bin(hertz - LINE_HERTZ)]) / total;
        let correlation = self.correlation(&power);
        let at_lag = |lag: f64| {
            let (before, fraction) = (lag as usize, lag.fract());
            let value =
                |k: usize| correlation[k] / correlation[0] * self.taper_correlation[0] / self.taper_correlation[k];
            if lag + 1.0 < 0.75 * window.len() as f64 {
                value(before) + fraction * (value(before + 1) - value(before))
            } else {
                0.0
            }
        };
        let evidence = |&hertz: &f64| Evidence {
            harmonic_share: (1..).zip(HARMONICS).map(|(k, weight)| weight * line(f64::from(k) * hertz)).sum(),
            correlation: at_lag(self.rate_hertz / hertz),
        };
        grid_hertz.iter().map(evidence).collect()
    }
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
