//! From a raw trace to a heart rate: the paper's protocol and the toolbox's, and an even grid for unevenly timed frames.
//!
//! Both detrend (smoothness prior, λ = 100 at 30 Hz), band-pass (Butterworth order 1, forward and backward) and take the strongest
//! bin of the band. The paper's uses 0.75–3.0 Hz and bins of at most 0.1 bpm; the toolbox's 0.6–3.3 Hz and a power of two.
//! `Fundamental` is ours: POS over 1.6 s windows and two band-passes weaken slow pulses more than their second harmonic,
//! which below about 60 bpm then is the strongest bin although the fundamental stands beside it.

use crate::detrend::{Smoothness, detrend};
use crate::error::{Result, SignalError, check_finite, check_length, check_times};
use crate::filter::{Band, Butterworth};
use crate::spectrum::{Resolution, Spectrum, peak_heart_rate_bpm};

/// Variation below this share of the signal's size is rounding, not a pulse.
const FLAT_SHARE: f64 = 1e-11;
/// Largest deviation from an even grid, in frame intervals, that is left as it is: clock jitter of a tenth of a percent.
const EVEN_SHARE: f64 = 1e-3;

/// A named protocol.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preset {
    /// Heartian's paper, with a spectrum fine enough not to limit the result.
    #[default]
    Paper,
    /// rPPG-Toolbox's evaluation, bins and all.
    Toolbox,
    /// rPPG-Toolbox's filter and band with bins of at most 0.1 bpm.
    ToolboxFine,
    /// As `ToolboxFine`, and the fundamental rather than its second harmonic where both stand out.
    Fundamental,
}

impl Preset {
    /// Its settings.
    pub fn protocol(self) -> Protocol {
        match self {
            Self::Paper => Protocol::PAPER,
            Self::Toolbox => Protocol::TOOLBOX,
            Self::ToolboxFine => Protocol { resolution: Resolution::FINE, ..Protocol::TOOLBOX },
            Self::Fundamental => Protocol { fundamental: true, ..Self::ToolboxFine.protocol() },
        }
    }
}

/// How a heart rate is read from a trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Protocol {
    /// Smoothness of the detrending.
    pub detrend: Smoothness,
    /// Pass band, also searched for the rate, hertz.
    pub band: Band,
    /// Butterworth order, 1 to 3.
    pub order: usize,
    /// Bins of the spectrum.
    pub resolution: Resolution,
    /// Whether the strongest bin is asked if it is a second harmonic ([`Spectrum::fundamental_bin`]).
    pub fundamental: bool,
}

impl Protocol {
    /// λ = 100 at 30 Hz and alike at other rates, order 1, 0.75–3.0 Hz, bins ≤ 0.1 bpm.
    pub const PAPER: Self = Self {
        detrend: Smoothness::AsAt30Hertz(100.0),
        band: Band::PAPER,
        order: 1,
        resolution: Resolution::FINE,
        fundamental: false,
    };
    /// λ = 100 whatever the rate, order 1, 0.6–3.3 Hz, next power of two.
    pub const TOOLBOX: Self = Self {
        detrend: Smoothness::Fixed(100.0),
        band: Band::TOOLBOX,
        order: 1,
        resolution: Resolution::Toolbox,
        fundamental: false,
    };

    /// Detrended and band-passed, same length and unit.
    ///
    /// # Errors
    /// When the signal is not finite or not longer than the filter's padding (9 samples at order 1), the band does not fit
    /// the rate, or nothing varies.
    pub fn filtered(&self, signal: &[f64], rate_hertz: f64) -> Result<Vec<f64>> {
        check_finite("the trace", signal)?;
        let filter = Butterworth::bandpass(self.order, self.band, rate_hertz)?;
        check_length("a heart rate", filter.padding() + 1, signal.len())?;
        let size = signal.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let filtered = filter.filtfilt(&detrend(signal, self.detrend.lambda(rate_hertz))?)?;
        let varies = filtered.iter().any(|value| value.abs() > FLAT_SHARE * size);
        if varies { Ok(filtered) } else { Err(SignalError::Flat("the trace")) }
    }

    /// The bin that is read as the heart rate.
    ///
    /// # Errors
    /// As [`Spectrum::peak_bin`].
    pub fn bin(&self, spectrum: &Spectrum) -> Result<usize> {
        if self.fundamental { spectrum.fundamental_bin(self.band) } else { spectrum.peak_bin(self.band) }
    }

    /// The heart rate of a trace sampled evenly at `rate_hertz`.
    ///
    /// # Errors
    /// As [`filtered`](Self::filtered), and when the rate is too high for the spectrum's resolution.
    pub fn estimate(&self, signal: &[f64], rate_hertz: f64) -> Result<HeartRate> {
        let filtered = self.filtered(signal, rate_hertz)?;
        let spectrum = Spectrum::of(&filtered, rate_hertz, self.resolution)?;
        let bpm = 60.0 * spectrum.hertz(self.bin(&spectrum)?);
        Ok(HeartRate { bpm, filtered, spectrum, rate_hertz, band: self.band })
    }
}

/// A heart rate and what it was read from.
#[derive(Clone, Debug, PartialEq)]
pub struct HeartRate {
    /// Rate at the bin the protocol reads, bpm.
    pub bpm: f64,
    /// The detrended, band-passed trace.
    pub filtered: Vec<f64>,
    /// Its spectrum.
    pub spectrum: Spectrum,
    /// Sampling rate of the trace, hertz.
    pub rate_hertz: f64,
    /// The band searched, hertz.
    pub band: Band,
}

impl HeartRate {
    /// Signal-to-noise ratio around a reference rate and its double, dB (the toolbox's definition). Give the contact PPG's
    /// rate: the trace's own flatters it.
    pub fn snr_db(&self, reference_bpm: f64) -> f64 {
        self.spectrum.snr_db(reference_bpm, self.band)
    }

    /// Rate from the distance of the filtered trace's maxima (the toolbox's "peak" mode), bpm.
    ///
    /// # Errors
    /// When fewer than two maxima are found.
    pub fn peak_bpm(&self) -> Result<f64> {
        peak_heart_rate_bpm(&self.filtered, self.rate_hertz)
    }
}

/// The heart rate of an evenly sampled trace by a named protocol.
///
/// # Errors
/// As [`Protocol::estimate`].
pub fn estimate(signal: &[f64], rate_hertz: f64, preset: Preset) -> Result<HeartRate> {
    preset.protocol().estimate(signal, rate_hertz)
}

/// A trace on an even grid.
#[derive(Clone, Debug, PartialEq)]
pub struct EvenTrace {
    /// Sampling rate, hertz.
    pub rate_hertz: f64,
    /// Samples; the first and last are at the first and last given time.
    pub values: Vec<f64>,
}

/// Puts a trace on the even grid of its mean rate, from its first to its last time, as many samples. Times even to a
/// thousandth of an interval leave the values untouched; otherwise a cubic with three-point slopes goes through them.
///
/// # Errors
/// When lengths differ, there are fewer than two samples, one is not finite, or times do not increase.
pub fn resampled_evenly(times_seconds: &[f64], values: &[f64]) -> Result<EvenTrace> {
    check_times("the frame times", times_seconds)?;
    check_finite("the trace", values)?;
    let n = times_seconds.len();
    if values.len() != n {
        return Err(SignalError::Length { what: "the trace", expected: n, found: values.len() });
    }
    check_length("a sampling rate", 2, n)?;
    let (first, last) = (times_seconds[0], times_seconds[n - 1]);
    let step = (last - first) / (n - 1) as f64;
    let even = |index: usize| first + step * index as f64;
    let off = times_seconds.iter().enumerate().map(|(k, time)| (time - even(k)).abs()).fold(0.0, f64::max);
    let rate_hertz = 1.0 / step;
    if off <= EVEN_SHARE * step {
        return Ok(EvenTrace { rate_hertz, values: values.to_vec() });
    }
    let slopes = three_point_slopes(times_seconds, values);
    let at = |time: f64| {
        let after = times_seconds.partition_point(|&t| t <= time).clamp(1, n - 1);
        let (t0, t1) = (times_seconds[after - 1], times_seconds[after]);
        let (width, s) = (t1 - t0, ((time - t0) / (t1 - t0)).clamp(0.0, 1.0));
        let (v0, v1) = (values[after - 1], values[after]);
        let (d0, d1) = (slopes[after - 1] * width - (v1 - v0), (v1 - v0) - slopes[after] * width);
        v0 + s * (v1 - v0) + s * (1.0 - s) * ((1.0 - s) * d0 + s * d1)
    };
    Ok(EvenTrace { rate_hertz, values: (0..n).map(|k| at(even(k))).collect() })
}

/// Derivative at each sample of the parabola through it and its neighbours (one-sided at the ends).
fn three_point_slopes(times: &[f64], values: &[f64]) -> Vec<f64> {
    let secant = |k: usize| (values[k + 1] - values[k]) / (times[k + 1] - times[k]);
    let n = times.len();
    (0..n)
        .map(|k| match k {
            0 => secant(0),
            _ if k == n - 1 => secant(n - 2),
            _ => {
                let (before, after) = (times[k] - times[k - 1], times[k + 1] - times[k]);
                (after * secant(k - 1) + before * secant(k)) / (before + after)
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tone(bpm: f64, times: &[f64]) -> Vec<f64> {
        times.iter().map(|t| 500.0 + 0.3 * t + (std::f64::consts::TAU * bpm / 60.0 * t).sin()).collect()
    }

    #[test]
    fn reads_a_tone_and_its_noise() -> Result<()> {
        let times: Vec<f64> = (0..900).map(|i| f64::from(i) / 30.0).collect();
        let paper = estimate(&tone(71.3, &times), 30.0, Preset::Paper)?;
        assert!((paper.bpm - 71.3).abs() < 0.1 && paper.snr_db(71.3) > 10.0 && paper.snr_db(110.0) < -10.0);
        assert!((paper.peak_bpm()? - 71.3).abs() < 0.5);
        let toolbox = estimate(&tone(71.3, &times), 30.0, Preset::Toolbox)?;
        let step = 60.0 * 30.0 / 1024.0;
        assert!((toolbox.bpm - 71.3).abs() <= step && (toolbox.bpm / step).fract() < 1e-9);
        Ok(())
    }

    #[test]
    fn uneven_times_are_evened_out() -> Result<()> {
        let jittered: Vec<f64> =
            (0..900).map(|i| (f64::from(i) + 0.4 * (f64::from(i * i) * 0.77).sin()) / 30.0).collect();
        let even = resampled_evenly(&jittered, &tone(71.3, &jittered))?;
        let step = (jittered[899] - jittered[0]) / 899.0;
        let grid: Vec<f64> = (0..900).map(|i| jittered[0] + step * f64::from(i)).collect();
        let worst = even.values.iter().zip(tone(71.3, &grid)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 0.02, "{worst}");
        assert!((estimate(&even.values, even.rate_hertz, Preset::Paper)?.bpm - 71.3).abs() < 0.1);
        let times: Vec<f64> = (0..9).map(f64::from).collect();
        assert_eq!(resampled_evenly(&times, &times)?.values, times);
        Ok(())
    }

    #[test]
    fn refuses_what_has_no_heart_rate() {
        let refusal = |signal: &[f64], rate: f64| estimate(signal, rate, Preset::Paper).err();
        assert!(matches!(refusal(&[], 30.0), Some(SignalError::Empty(_))));
        assert!(matches!(refusal(&[1.0], 30.0), Some(SignalError::TooShort { .. })));
        assert!(matches!(refusal(&[7.3; 300], 30.0), Some(SignalError::Flat(_))));
        let line: Vec<f64> = (0..300).map(|i| 100.0 + f64::from(i)).collect();
        assert!(matches!(refusal(&line, 30.0), Some(SignalError::Flat(_))));
        assert!(matches!(refusal(&[f64::NAN; 300], 30.0), Some(SignalError::NotFinite { index: 0, .. })));
        assert!(matches!(refusal(&line, 0.0), Some(SignalError::Rate { .. })));
        assert!(matches!(refusal(&line, 5.0), Some(SignalError::Band { .. })));
        assert!(matches!(resampled_evenly(&[0.0], &[1.0]), Err(SignalError::TooShort { .. })));
        assert!(matches!(resampled_evenly(&[0.0, 0.0], &[1.0, 2.0]), Err(SignalError::Times { index: 1, .. })));
        assert!(matches!(resampled_evenly(&[0.0, 1.0], &[1.0]), Err(SignalError::Length { .. })));
    }
}
