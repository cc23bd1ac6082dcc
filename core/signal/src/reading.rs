//! Reading a heart rate one of several ways: strongest bin or distance of maxima, between bins or not, whole or window by
//! window; and how far to trust it.

use crate::beats::{BeatOptions, detect_beats};
use crate::error::{Result, SignalError};
use crate::hrv::{Variability, variability};
use crate::metrics::RateMode;
use crate::protocol::{HeartRate, Protocol};

/// How a rate is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reader {
    /// Detrending, band and spectrum.
    pub protocol: Protocol,
    /// Strongest bin, or mean distance of maxima.
    pub mode: RateMode,
    /// Whether the strongest bin's place is refined by a parabola through its neighbours.
    pub between_bins: bool,
}

/// The rate of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowRate {
    /// Middle of the window, seconds from the first sample.
    pub middle_seconds: f64,
    /// Its rate, bpm; NaN where it has none.
    pub bpm: f64,
    /// See [`HeartRate::confidence`]; 0 where there is no rate.
    pub confidence: f64,
}

impl HeartRate {
    /// How far the spectrum speaks for its own strongest rate, in [0, 1]: the share of the band's power within 6 bpm of it
    /// and of its double. White noise over a minute has about 0.15, a clean pulse above 0.9.
    pub fn confidence(&self) -> f64 {
        let ratio = 10f64.powf(self.snr_db(self.bpm) / 10.0);
        if ratio.is_finite() { ratio / (1.0 + ratio) } else { 1.0 }
    }
}

impl Reader {
    /// The strongest bin of a protocol.
    pub fn new(protocol: Protocol) -> Self {
        Self { protocol, mode: RateMode::Fft, between_bins: false }
    }

    /// The heart rate of a trace sampled evenly at `rate_hertz`; its `bpm` is read as this reader says.
    ///
    /// # Errors
    /// As [`Protocol::estimate`], and in peak mode when fewer than two maxima are found.
    pub fn read(&self, signal: &[f64], rate_hertz: f64) -> Result<HeartRate> {
        let found = self.protocol.estimate(signal, rate_hertz)?;
        let bpm = match self.mode {
            RateMode::Peak => found.peak_bpm()?,
            RateMode::Fft if self.between_bins => found.spectrum.refined_bpm(self.protocol.bin(&found.spectrum)?),
            RateMode::Fft => found.bpm,
        };
        Ok(HeartRate { bpm, ..found })
    }

    /// Rates of windows of `window_seconds`, one every `hop_seconds`, as long as a whole window fits; a window without a
    /// rate (flat, no maxima) is NaN.
    ///
    /// # Errors
    /// When window or hop are not above zero, or the trace is shorter than a window.
    pub fn windows(
        &self,
        signal: &[f64],
        rate_hertz: f64,
        window_seconds: f64,
        hop_seconds: f64,
    ) -> Result<Vec<WindowRate>> {
        for (name, value) in [("the window", window_seconds), ("the distance of windows", hop_seconds)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SignalError::Setting { name, value, range: "above 0 s" });
            }
        }
        let window = (window_seconds * rate_hertz).round() as usize;
        if signal.len() < window.max(2) {
            let (needed, found) = (window.max(2), signal.len());
            return Err(SignalError::TooShort { what: "a window's heart rate", needed, found });
        }
        let hop = (hop_seconds * rate_hertz).max(1.0);
        let count = ((signal.len() - window) as f64 / hop) as usize + 1;
        let at = |k: usize| {
            let from = ((k as f64 * hop) as usize).min(signal.len() - window);
            let found = self.read(&signal[from..from + window], rate_hertz);
            WindowRate {
                middle_seconds: (from as f64 + 0.5 * window as f64) / rate_hertz,
                bpm: found.as_ref().map_or(f64::NAN, |found| found.bpm),
                confidence: found.as_ref().map_or(0.0, HeartRate::confidence),
            }
        };
        Ok((0..count).map(at).collect())
    }
}

/// Variability of the beats of a pulse trace sampled evenly: systolic peaks, then their intervals.
///
/// # Errors
/// As [`detect_beats`] and [`variability`].
pub fn pulse_variability(signal: &[f64], rate_hertz: f64) -> Result<Variability> {
    let found = detect_beats(signal, rate_hertz, &BeatOptions::default())?;
    let observed: Vec<bool> = found.beats.iter().map(|beat| beat.observed).collect();
    variability(&found.seconds(), &observed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Preset;

    fn pulse(bpm: impl Fn(f64) -> f64, seconds: f64) -> Vec<f64> {
        let mut phase = 0.0;
        let sample = |k: usize| {
            phase += std::f64::consts::TAU * bpm(k as f64 / 30.0) / 60.0 / 30.0;
            phase.cos() + 0.3 * (2.0 * phase + 1.0).cos()
        };
        (0..(30.0 * seconds) as usize).map(sample).collect()
    }

    #[test]
    fn every_way_of_reading_finds_the_rate() -> Result<()> {
        let signal = pulse(|_| 71.3, 40.0);
        for (preset, between_bins, allowed) in
            [(Preset::Paper, false, 0.1), (Preset::Paper, true, 0.06), (Preset::Toolbox, true, 0.5)]
        {
            let reader = Reader { between_bins, ..Reader::new(preset.protocol()) };
            let found = reader.read(&signal, 30.0)?;
            assert!((found.bpm - 71.3).abs() < allowed && found.confidence() > 0.9, "{preset:?}: {}", found.bpm);
        }
        let reader = Reader { mode: RateMode::Peak, ..Reader::new(Protocol::PAPER) };
        assert!((reader.read(&signal, 30.0)?.bpm - 71.3).abs() < 0.5);
        Ok(())
    }

    #[test]
    fn windows_follow_a_changing_rate_and_noise_is_not_trusted() -> Result<()> {
        let signal = pulse(|time| if time < 30.0 { 60.0 } else { 90.0 }, 60.0);
        let reader = Reader { between_bins: true, ..Reader::new(Protocol::PAPER) };
        let windows = reader.windows(&signal, 30.0, 10.0, 5.0)?;
        assert_eq!(windows.len(), 11);
        assert!((windows[0].bpm - 60.0).abs() < 1.0 && (windows[10].bpm - 90.0).abs() < 1.0);
        assert!((windows[10].middle_seconds - 55.0).abs() < 1e-9);
        let noise: Vec<f64> = (0..1800).map(|k| (f64::from(k * k) * 0.37).sin()).collect();
        assert!(reader.read(&noise, 30.0)?.confidence() < 0.4);
        let flat = vec![1.0; 600];
        assert!(reader.windows(&flat, 30.0, 10.0, 5.0)?.iter().all(|w| w.bpm.is_nan() && w.confidence == 0.0));
        assert!(matches!(reader.windows(&signal, 30.0, 61.0, 5.0), Err(SignalError::TooShort { .. })));
        for (window, hop) in [(0.0, 1.0), (10.0, 0.0), (f64::NAN, 1.0), (10.0, f64::INFINITY)] {
            assert!(matches!(reader.windows(&signal, 30.0, window, hop), Err(SignalError::Setting { .. })));
        }
        Ok(())
    }
}
