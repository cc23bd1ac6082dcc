//! Scores of predicted against reference pulses: per window, and over a data set with standard errors (rPPG-Toolbox §4).
//!
//! A window is scored by both heart rates (same mode), the SNR of the prediction at the reference's rate, and MACC. A
//! window without two peaks has no rate in peak mode: it becomes NaN and, as in the toolbox, shows in every mean it enters.

use crate::error::{Result, SignalError, check_length};
use crate::filter::Butterworth;
use crate::protocol::Protocol;
use crate::spectrum::{Spectrum, peak_heart_rate_bpm};
use crate::stats::{macc, mean, pearson, standard_deviation};

/// How a rate is read from the filtered window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RateMode {
    /// Strongest bin of the band.
    #[default]
    Fft,
    /// Mean distance of maxima.
    Peak,
}

/// How recordings are scored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// Detrending, band and spectrum.
    pub protocol: Protocol,
    /// How rates are read.
    pub mode: RateMode,
    /// Whether the signals are derivatives of the pulse and must be summed up first (label type DiffNormalized).
    pub derivative: bool,
    /// Length of non-overlapping windows, seconds; the whole recording when `None`. The last, partial window counts too.
    pub window_seconds: Option<f64>,
}

impl Default for Evaluation {
    /// The toolbox's: FFT mode, pulse signals, whole recordings.
    fn default() -> Self {
        Self { protocol: Protocol::TOOLBOX, mode: RateMode::Fft, derivative: false, window_seconds: None }
    }
}

/// Scores of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowScore {
    /// Rate of the reference, bpm; NaN where it has none.
    pub reference_bpm: f64,
    /// Rate of the prediction, bpm; NaN where it has none.
    pub predicted_bpm: f64,
    /// SNR of the prediction at the reference's rate, dB; −∞ where that is NaN.
    pub snr_db: f64,
    /// Largest absolute correlation over circular lags, in [0, 1].
    pub macc: f64,
}

impl Evaluation {
    /// Scores each window of a recording. Both signals start with it; the longer one tells its length (CHROM's trace ends
    /// early; crop a reference that goes on after the last frame). Windows in which the prediction is not longer than the
    /// filter's padding (9 samples at order 1) are left out.
    ///
    /// # Errors
    /// When a signal is empty, not finite or flat within a window, the rate or the window length is unusable, or no
    /// window is long enough.
    pub fn score(&self, predicted: &[f64], reference: &[f64], rate_hertz: f64) -> Result<Vec<WindowScore>> {
        let padding = Butterworth::bandpass(self.protocol.order, self.protocol.band, rate_hertz)?.padding();
        check_length("scoring", padding + 1, predicted.len())?;
        let length = predicted.len().max(reference.len());
        let window = match self.window_seconds {
            None => length,
            Some(seconds) if (padding as f64) < seconds * rate_hertz => ((seconds * rate_hertz) as usize).min(length),
            Some(value) => {
                let range = "longer than the filter's padding (0.3 s at order 1 and 30 Hz)";
                return Err(SignalError::Setting { name: "the scoring window", value, range });
            }
        };
        (0..length)
            .step_by(window)
            .map(|from| (part(predicted, from, window), part(reference, from, window)))
            .filter(|(predicted, _)| predicted.len() > padding)
            .map(|(predicted, reference)| self.score_window(predicted, reference, rate_hertz))
            .collect()
    }

    /// Scores one window.
    fn score_window(&self, predicted: &[f64], reference: &[f64], rate_hertz: f64) -> Result<WindowScore> {
        let filtered = |signal: &[f64]| {
            let integrated = if self.derivative { cumulative_sum(signal) } else { signal.to_vec() };
            self.protocol.filtered(&integrated, rate_hertz)
        };
        let (predicted, reference) = (filtered(predicted)?, filtered(reference)?);
        let spectrum_of = |signal: &[f64]| Spectrum::of(signal, rate_hertz, self.protocol.resolution);
        let spectrum = spectrum_of(&predicted)?;
        let band = self.protocol.band;
        let (reference_bpm, predicted_bpm) = match self.mode {
            RateMode::Fft => (spectrum_of(&reference)?.heart_rate_bpm(band)?, spectrum.heart_rate_bpm(band)?),
            RateMode::Peak => (peak_rate_or_nan(&reference, rate_hertz)?, peak_rate_or_nan(&predicted, rate_hertz)?),
        };
        let snr_db = spectrum.snr_db(reference_bpm, band);
        Ok(WindowScore { reference_bpm, predicted_bpm, snr_db, macc: macc(&predicted, &reference)? })
    }
}

/// What a signal has of a window.
fn part(signal: &[f64], from: usize, window: usize) -> &[f64] {
    &signal[from.min(signal.len())..(from + window).min(signal.len())]
}

/// Peak mode with NaN for fewer than two maxima.
fn peak_rate_or_nan(signal: &[f64], rate_hertz: f64) -> Result<f64> {
    match peak_heart_rate_bpm(signal, rate_hertz) {
        Err(SignalError::FewBeats { .. }) => Ok(f64::NAN),
        other => other,
    }
}

fn cumulative_sum(signal: &[f64]) -> Vec<f64> {
    let add = |sum: &mut f64, value: &f64| {
        *sum += value;
        Some(*sum)
    };
    signal.iter().scan(0.0, add).collect()
}

/// A figure and its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// The figure.
    pub value: f64,
    /// Its standard error; NaN or infinite where too few windows define none.
    pub standard_error: f64,
}

impl Figure {
    /// Mean and `σ/√n` of values.
    fn mean_of(values: &[f64]) -> Self {
        Self { value: mean(values), standard_error: standard_deviation(values) / (values.len() as f64).sqrt() }
    }
}

/// Figures over a data set's windows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DatasetMetrics {
    /// Mean absolute error, bpm.
    pub mae: Figure,
    /// Root mean square error, bpm; its standard error is `√(σ(e²)/√n)`.
    pub rmse: Figure,
    /// Mean absolute percentage error, %.
    pub mape: Figure,
    /// Correlation of rates; NaN when they do not vary. Standard error `√((1 − r²)/(n − 2))`.
    pub pearson: Figure,
    /// Mean SNR, dB.
    pub snr_db: Figure,
    /// Mean MACC.
    pub macc: Figure,
}

/// Sums windows up.
///
/// # Errors
/// When there is none.
pub fn summarise(windows: &[WindowScore]) -> Result<DatasetMetrics> {
    if windows.is_empty() {
        return Err(SignalError::Empty("the list of scored windows"));
    }
    let count = windows.len() as f64;
    let collect = |f: fn(&WindowScore) -> f64| -> Vec<f64> { windows.iter().map(f).collect() };
    let absolute = collect(|w| (w.predicted_bpm - w.reference_bpm).abs());
    let squared = collect(|w| (w.predicted_bpm - w.reference_bpm).powi(2));
    let percent = collect(|w| 100.0 * ((w.predicted_bpm - w.reference_bpm) / w.reference_bpm).abs());
    let r = pearson(&collect(|w| w.predicted_bpm), &collect(|w| w.reference_bpm)).unwrap_or(f64::NAN);
    let rmse =
        Figure { value: mean(&squared).sqrt(), standard_error: (standard_deviation(&squared) / count.sqrt()).sqrt() };
    Ok(DatasetMetrics {
        mae: Figure::mean_of(&absolute),
        rmse,
        mape: Figure::mean_of(&percent),
        pearson: Figure { value: r, standard_error: ((1.0 - r * r) / (count - 2.0)).sqrt() },
        snr_db: Figure::mean_of(&collect(|w| w.snr_db)),
        macc: Figure::mean_of(&collect(|w| w.macc)),
    })
}

/// Agreement of two methods: differences `reference − predicted`, with the toolbox's limits (`±1.96·√2·σ`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlandAltman {
    /// Mean difference, bpm.
    pub mean: f64,
    /// Sample standard deviation (n − 1), bpm.
    pub deviation: f64,
    /// Upper limit of agreement, bpm.
    pub upper: f64,
    /// Lower limit of agreement, bpm.
    pub lower: f64,
}

/// Bland–Altman agreement of rates.
///
/// # Errors
/// When lengths differ or fewer than two pairs are given.
pub fn bland_altman(predicted_bpm: &[f64], reference_bpm: &[f64]) -> Result<BlandAltman> {
    let n = predicted_bpm.len();
    if reference_bpm.len() != n {
        return Err(SignalError::Length { what: "the reference rates", expected: n, found: reference_bpm.len() });
    }
    check_length("Bland–Altman agreement", 2, n)?;
    let differences: Vec<f64> = reference_bpm.iter().zip(predicted_bpm).map(|(g, p)| g - p).collect();
    let deviation = standard_deviation(&differences) * (n as f64 / (n - 1) as f64).sqrt();
    let (mean, reach) = (mean(&differences), 1.96 * std::f64::consts::SQRT_2 * deviation);
    Ok(BlandAltman { mean, deviation, upper: mean + reach, lower: mean - reach })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pulse(bpm: f64, n: usize) -> Vec<f64> {
        (0..n).map(|i| (std::f64::consts::TAU * bpm / 60.0 * i as f64 / 30.0).sin()).collect()
    }

    #[test]
    fn a_perfect_prediction_has_no_error_and_full_correlation() -> Result<()> {
        let evaluation = Evaluation { window_seconds: Some(10.0), ..Evaluation::default() };
        let mut scores = evaluation.score(&pulse(70.0, 909), &pulse(70.0, 909), 30.0)?;
        assert_eq!(scores.len(), 3, "the partial window of 9 samples is left out");
        scores.extend(evaluation.score(&pulse(90.0, 909), &pulse(90.0, 909), 30.0)?);
        let metrics = summarise(&scores)?;
        assert_eq!((metrics.mae.value, metrics.rmse.value, metrics.mape.standard_error), (0.0, 0.0, 0.0));
        assert!((metrics.macc.value - 1.0).abs() < 1e-12 && (metrics.pearson.value - 1.0).abs() < 1e-12);
        Ok(())
    }

    #[test]
    fn a_derivative_is_summed_up_first() -> Result<()> {
        let (target, evaluation) = (pulse(80.0, 600), Evaluation { derivative: true, ..Evaluation::default() });
        let slope: Vec<f64> = target.windows(2).map(|pair| pair[1] - pair[0]).chain([0.0]).collect();
        let score = evaluation.score(&slope, &slope, 30.0)?[0];
        let direct = Evaluation::default().score(&target[1..], &target[1..], 30.0)?[0];
        assert_eq!(score.predicted_bpm, direct.predicted_bpm);
        Ok(())
    }

    #[test]
    fn refuses_nothing_and_defines_few() -> Result<()> {
        assert!(matches!(summarise(&[]), Err(SignalError::Empty(_))));
        let one = WindowScore { reference_bpm: 60.0, predicted_bpm: 63.0, snr_db: 1.0, macc: 0.5 };
        let metrics = summarise(&[one])?;
        assert_eq!((metrics.mae.value, metrics.mape.value), (3.0, 5.0));
        assert!(metrics.pearson.value.is_nan());
        let short = Evaluation::default().score(&pulse(70.0, 9), &pulse(70.0, 9), 30.0);
        assert!(matches!(short, Err(SignalError::TooShort { .. })));
        let missing = Evaluation::default().score(&pulse(70.0, 300), &[], 30.0);
        assert!(matches!(missing, Err(SignalError::Empty(_))));
        for seconds in [0.0, 0.2, f64::NAN] {
            let evaluation = Evaluation { window_seconds: Some(seconds), ..Evaluation::default() };
            let refused = evaluation.score(&pulse(70.0, 300), &pulse(70.0, 300), 30.0);
            assert!(matches!(refused, Err(SignalError::Setting { .. })));
        }
        assert!(matches!(bland_altman(&[1.0], &[1.0]), Err(SignalError::TooShort { .. })));
        Ok(())
    }
}
