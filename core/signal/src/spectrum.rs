//! Power spectra, the heart rate in them, and the signal-to-noise ratio around a known rate.
//!
//! A spectrum is a one-sided boxcar periodogram, `2·|X|²/(rate·n)` per bin (DC and Nyquist not doubled), in units² per hertz.
//! Two conventions of zero-padding: the toolbox's next power of two, and the product's, fine enough that a bin is ≤ 0.1 bpm.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;

use crate::error::{Result, SignalError, check_finite, check_rate};
use crate::filter::Band;
use crate::peaks::local_maxima;

/// Largest transform: 2²⁴ points (256 MiB), 0.1 bpm up to a rate of 27.9 kHz.
const MAX_POINTS: usize = 1 << 24;

/// Half-width of the window taken around a harmonic when signal is told from noise, hertz (6 bpm).
const HARMONIC_HERTZ: f64 = 0.1;

/// Least share of the strongest bin's power at half its frequency that makes it a second harmonic.
const FUNDAMENTAL_SHARE: f64 = 0.25;
/// How far from half the strongest frequency the fundamental is looked for, hertz (3 bpm).
const FUNDAMENTAL_HERTZ: f64 = 0.05;

/// How far a signal is padded with zeros before the transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Resolution {
    /// The next power of two not below the length (rPPG-Toolbox): 0.88 bpm for a minute at 30 Hz, 7 bpm for 6 s.
    Toolbox,
    /// A power of two with bins no wider than this many beats per minute.
    Bin {
        /// Widest bin, bpm.
        bpm: f64,
    },
}

impl Resolution {
    /// The product's: bins of at most 0.1 bpm.
    pub const FINE: Self = Self::Bin { bpm: 0.1 };

    fn points(self, samples: usize, rate_hertz: f64) -> Result<usize> {
        let wanted = match self {
            Self::Toolbox => samples as f64,
            Self::Bin { bpm } if bpm > 0.0 => (60.0 * rate_hertz / bpm).max(samples as f64),
            Self::Bin { bpm } => {
                return Err(SignalError::Setting { name: "the spectrum's bin", value: bpm, range: "above 0 bpm" });
            }
        };
        if wanted > MAX_POINTS as f64 {
            let most_hertz = rate_hertz * MAX_POINTS as f64 / wanted;
            return Err(SignalError::Rate { rate_hertz, most_hertz });
        }
        Ok((wanted.ceil() as usize).next_power_of_two())
    }
}

/// A one-sided power spectrum; bin `k` is at `k·step_hertz`.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    /// Distance of bins, hertz.
    pub step_hertz: f64,
    /// Power density, `nfft/2 + 1` bins, units²/Hz, ≥ 0.
    pub power: Vec<f64>,
}

impl Spectrum {
    /// The periodogram of a signal.
    ///
    /// # Errors
    /// When the signal is empty or not finite, the rate not positive, or the transform would be too large.
    pub fn of(signal: &[f64], rate_hertz: f64, resolution: Resolution) -> Result<Self> {
        check_finite("the signal", signal)?;
        check_rate(rate_hertz)?;
        let n = resolution.points(signal.len(), rate_hertz)?;
        let bins = half_transform(signal, n);
        let scale = 1.0 / (rate_hertz * signal.len() as f64);
        let power = bins
            .iter()
            .enumerate()
            .map(|(k, value)| value.norm_sqr() * if k == 0 || 2 * k == n { scale } else { 2.0 * scale })
            .collect();
        // The toolbox's frequencies, to the last bit: its band edges are compared inclusively.
        Ok(Self { step_hertz: 1.0 / (n as f64 * (1.0 / rate_hertz)), power })
    }

    /// Frequency of a bin, hertz.
    pub fn hertz(&self, bin: usize) -> f64 {
        bin as f64 * self.step_hertz
    }

    /// The strongest bin in the band (the first of equals).
    ///
    /// # Errors
    /// When the band holds no bin or no power.
    pub fn peak_bin(&self, band: Band) -> Result<usize> {
        let mut best: Option<usize> = None;
        for (bin, &power) in self.power.iter().enumerate() {
            if band.contains(self.hertz(bin)) && best.is_none_or(|b| power > self.power[b]) {
                best = Some(bin);
            }
        }
        best.filter(|&bin| self.power[bin] > 0.0).ok_or(SignalError::Flat("the signal's spectrum within the band"))
    }

    /// The strongest bin of the band, or the fundamental of which it is the second harmonic: the strongest bin within 3 bpm
    /// of half its frequency, if that lies in the band, is a maximum and holds at least a quarter of its power.
    ///
    /// # Errors
    /// As [`peak_bin`](Self::peak_bin).
    pub fn fundamental_bin(&self, band: Band) -> Result<usize> {
        let peak = self.peak_bin(band)?;
        let near = |bin: &usize| (self.hertz(*bin) - 0.5 * self.hertz(peak)).abs() <= FUNDAMENTAL_HERTZ;
        let half = (1..peak).filter(near).max_by(|a, b| self.power[*a].total_cmp(&self.power[*b]));
        let stands = |bin: &usize| {
            let power = self.power[*bin];
            band.contains(self.hertz(*bin))
                && power >= FUNDAMENTAL_SHARE * self.power[peak]
                && power >= self.power[bin - 1]
                && power >= self.power[bin + 1]
        };
        Ok(half.filter(stands).unwrap_or(peak))
    }

    /// Heart rate at the strongest bin of the band, bpm; no interpolation.
    ///
    /// # Errors
    /// As [`peak_bin`](Self::peak_bin).
    pub fn heart_rate_bpm(&self, band: Band) -> Result<f64> {
        Ok(60.0 * self.hertz(self.peak_bin(band)?))
    }

    /// Rate at the top of a parabola through the logarithms of a bin and its neighbours, bpm; the bin's own where there is
    /// none.
    pub fn refined_bpm(&self, bin: usize) -> f64 {
        let power = self.power.get(bin).copied().unwrap_or(0.0);
        let offset = match (bin.checked_sub(1).map(|b| self.power[b]), self.power.get(bin + 1)) {
            (Some(left), Some(&right)) if left > 0.0 && right > 0.0 => {
                let (l, c, r) = (left.ln(), power.ln(), right.ln());
                let curvature = l - 2.0 * c + r;
                if curvature < 0.0 { (0.5 * (l - r) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
            }
            _ => 0.0,
        };
        60.0 * (bin as f64 + offset) * self.step_hertz
    }

    /// Power within 0.1 Hz of the reference rate and of its double, over the band's other power, in dB. 0 when nothing
    /// else is in the band; −∞ when the harmonics hold no power (a reference that is not a number included).
    pub fn snr_db(&self, reference_bpm: f64, band: Band) -> f64 {
        let first = reference_bpm / 60.0;
        let near = |hertz: f64, harmonic: f64| hertz >= harmonic - HARMONIC_HERTZ && hertz <= harmonic + HARMONIC_HERTZ;
        let (mut at_first, mut at_second, mut noise) = (0.0, 0.0, 0.0);
        for (bin, &power) in self.power.iter().enumerate() {
            let hertz = self.hertz(bin);
            let (in_first, in_second) = (near(hertz, first), near(hertz, 2.0 * first));
            at_first += if in_first { power } else { 0.0 };
            at_second += if in_second { power } else { 0.0 };
            noise += if band.contains(hertz) && !in_first && !in_second { power } else { 0.0 };
        }
        if noise == 0.0 { 0.0 } else { 10.0 * ((at_first + at_second) / noise).log10() }
    }
}

/// Heart rate from the mean distance of a signal's local maxima, bpm (the toolbox's "peak" mode: every maximum counts, so
/// filter first).
///
/// # Errors
/// When the rate is not positive, the signal is empty or not finite, or fewer than two maxima are found.
pub fn peak_heart_rate_bpm(signal: &[f64], rate_hertz: f64) -> Result<f64> {
    check_finite("the signal", signal)?;
    check_rate(rate_hertz)?;
    let peaks = local_maxima(signal);
    match (peaks.first(), peaks.last()) {
        (Some(first), Some(last)) if last > first => {
            Ok(60.0 * (rate_hertz / ((last - first) as f64 / (peaks.len() - 1) as f64)))
        }
        _ => Err(SignalError::FewBeats { found: peaks.len(), needed: 2 }),
    }
}

/// First `n/2 + 1` bins of the transform of a real signal padded to an even power of two `n` (or `n = 1`), by one complex
/// transform of half the size.
fn half_transform(signal: &[f64], n: usize) -> Vec<Complex64> {
    if n == 1 {
        return vec![Complex64::new(signal[0], 0.0)];
    }
    let half = n / 2;
    let mut z: Vec<Complex64> = signal
        .chunks(2)
        .map(|pair| Complex64::new(pair[0], pair.get(1).copied().unwrap_or(0.0)))
        .chain(std::iter::repeat(Complex64::default()))
        .take(half)
        .collect();
    FftPlanner::new().plan_fft_forward(half).process(&mut z);
    (0..=half)
        .map(|k| {
            let (here, mirror) = (z[k % half], z[(half - k) % half].conj());
            let (even, odd) = ((here + mirror) * 0.5, (here - mirror) * Complex64::new(0.0, -0.5));
            even + odd * Complex64::cis(-std::f64::consts::TAU * k as f64 / n as f64)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tone(bpm: f64, rate: f64, n: usize) -> Vec<f64> {
        (0..n).map(|i| (std::f64::consts::TAU * bpm / 60.0 * i as f64 / rate).sin()).collect()
    }

    #[test]
    fn the_transform_is_the_definition() {
        let x: Vec<f64> = (0..11).map(|i| (f64::from(i) * 1.3).sin() + 0.2).collect();
        for (k, got) in half_transform(&x, 16).iter().enumerate() {
            let want: Complex64 =
                (0..11).map(|t| x[t] * Complex64::cis(-std::f64::consts::TAU * (k * t) as f64 / 16.0)).sum();
            assert!((got - want).norm() < 1e-12, "bin {k}");
        }
        assert_eq!(half_transform(&[2.0, 1.0], 2).iter().map(|z| z.re).collect::<Vec<_>>(), [3.0, 1.0]);
    }

    #[test]
    fn fine_bins_find_any_rate_to_a_tenth() -> Result<()> {
        for rate in [7.0, 24.0, 29.97, 60.0, 117.0] {
            for bpm in [46.3, 71.77, 120.1, 178.9] {
                let signal = tone(bpm, rate, (rate * 60.0) as usize);
                let spectrum = Spectrum::of(&signal, rate, Resolution::FINE)?;
                assert!(spectrum.step_hertz * 60.0 <= 0.1);
                assert!((spectrum.heart_rate_bpm(Band::PAPER)? - bpm).abs() < 0.1, "{rate} {bpm}");
                assert!((spectrum.refined_bpm(spectrum.peak_bin(Band::PAPER)?) - bpm).abs() < 0.06);
            }
        }
        Ok(())
    }

    #[test]
    fn a_second_harmonic_is_told_from_a_rate() -> Result<()> {
        let mix = |slow: f64, amplitude: f64| -> Vec<f64> {
            let pairs = tone(slow, 30.0, 900).into_iter().zip(tone(2.0 * slow, 30.0, 900));
            pairs.map(|(first, second)| amplitude * first + second).collect()
        };
        for (slow, amplitude, wanted) in [
            (54.0, 0.9, 54.0),
            (54.0, 0.6, 54.0),
            (54.0, 0.3, 108.0),
            (54.0, 0.0, 108.0),
            // Half of it lies below the band.
            (30.0, 0.9, 60.0),
            (54.0, 1.5, 54.0),
        ] {
            let spectrum = Spectrum::of(&mix(slow, amplitude), 30.0, Resolution::FINE)?;
            let found = 60.0 * spectrum.hertz(spectrum.fundamental_bin(Band::TOOLBOX)?);
            assert!((found - wanted).abs() < 0.2, "{slow} {amplitude}: {found}");
        }
        Ok(())
    }

    #[test]
    fn power_sums_to_the_mean_square() -> Result<()> {
        let signal = tone(77.0, 30.0, 512);
        let spectrum = Spectrum::of(&signal, 30.0, Resolution::Toolbox)?;
        let total = spectrum.power.iter().sum::<f64>() * spectrum.step_hertz;
        let mean_square = signal.iter().map(|v| v * v).sum::<f64>() / 512.0;
        assert!((total - mean_square).abs() < 1e-12);
        Ok(())
    }

    #[test]
    fn snr_rises_with_the_signal_and_is_defined_at_its_limits() -> Result<()> {
        let noise: Vec<f64> = (0..900).map(|i| (f64::from(i * i) * 0.37).sin()).collect();
        let mut last = f64::NEG_INFINITY;
        for amplitude in [0.01, 0.1, 1.0, 10.0] {
            let signal: Vec<f64> = tone(90.0, 30.0, 900).iter().zip(&noise).map(|(s, n)| amplitude * s + n).collect();
            let snr = Spectrum::of(&signal, 30.0, Resolution::Toolbox)?.snr_db(90.0, Band::TOOLBOX);
            assert!(snr > last);
            last = snr;
        }
        let spectrum = Spectrum::of(&noise, 30.0, Resolution::Toolbox)?;
        assert_eq!(spectrum.snr_db(f64::NAN, Band::TOOLBOX), f64::NEG_INFINITY);
        assert_eq!(Spectrum::of(&[0.0; 9], 30.0, Resolution::Toolbox)?.snr_db(60.0, Band::TOOLBOX), 0.0);
        Ok(())
    }

    #[test]
    fn refuses_what_has_no_rate() -> Result<()> {
        assert!(matches!(Spectrum::of(&[], 30.0, Resolution::FINE), Err(SignalError::Empty(_))));
        assert!(matches!(Spectrum::of(&[1.0], 0.0, Resolution::FINE), Err(SignalError::Rate { .. })));
        assert!(matches!(Spectrum::of(&[1.0; 4], 1e6, Resolution::FINE), Err(SignalError::Rate { .. })));
        let zero_bin = Resolution::Bin { bpm: 0.0 };
        assert!(matches!(Spectrum::of(&[1.0; 4], 30.0, zero_bin), Err(SignalError::Setting { .. })));
        assert!(matches!(Spectrum::of(&[f64::NAN], 30.0, Resolution::FINE), Err(SignalError::NotFinite { .. })));
        let flat = Spectrum::of(&[0.0; 64], 30.0, Resolution::FINE)?;
        assert!(matches!(flat.heart_rate_bpm(Band::PAPER), Err(SignalError::Flat(_))));
        assert_eq!(Spectrum::of(&[3.0], 30.0, Resolution::Toolbox)?.power.len(), 1);
        assert!(matches!(peak_heart_rate_bpm(&[0.0, 1.0, 0.0], 30.0), Err(SignalError::FewBeats { found: 1, .. })));
        assert_eq!(peak_heart_rate_bpm(&[0.0, 1.0, 0.0, 1.0, 0.0], 2.0)?, 60.0);
        Ok(())
    }
}
