//! Butterworth band-pass filters and their zero-phase application, with the conventions of SciPy's `butter` and `filtfilt`.
//!
//! The design goes analogue prototype → band-pass → bilinear transform with both edges prewarped. The filter is kept as
//! second-order sections: mathematically the same as SciPy's `b, a` form, and still exact at order 3 and 1 kHz where the
//! polynomial form loses its digits. Frequencies are hertz; filtering is linear and has no state between calls.

use rustfft::num_complex::Complex64;

use crate::error::{Result, SignalError, check_finite, check_length, check_rate};

/// A pass band, hertz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Lower edge (−3 dB), hertz, above 0.
    pub low_hertz: f64,
    /// Upper edge (−3 dB), hertz, below half the sampling rate.
    pub high_hertz: f64,
}

impl Band {
    /// The paper's cardiac band, 0.75–3.0 Hz (45–180 bpm).
    pub const PAPER: Self = Self { low_hertz: 0.75, high_hertz: 3.0 };
    /// rPPG-Toolbox's band, 0.6–3.3 Hz (36–198 bpm).
    pub const TOOLBOX: Self = Self { low_hertz: 0.6, high_hertz: 3.3 };

    /// Whether a frequency lies in the band, edges included.
    pub fn contains(&self, hertz: f64) -> bool {
        hertz >= self.low_hertz && hertz <= self.high_hertz
    }

    /// Refuses a band that does not lie strictly between 0 and half the rate.
    ///
    /// # Errors
    /// [`SignalError::Rate`] or [`SignalError::Band`].
    pub fn check(&self, rate_hertz: f64) -> Result<()> {
        check_rate(rate_hertz)?;
        let Self { low_hertz, high_hertz } = *self;
        if low_hertz > 0.0 && low_hertz < high_hertz && high_hertz < rate_hertz / 2.0 {
            Ok(())
        } else {
            Err(SignalError::Band { low_hertz, high_hertz, rate_hertz })
        }
    }
}

/// One second-order section: `gain·(1 − z⁻²)/(1 + a₁z⁻¹ + a₂z⁻²)`.
#[derive(Clone, Copy, Debug)]
struct Section {
    gain: f64,
    a1: f64,
    a2: f64,
}

/// A digital Butterworth band-pass filter of order 1, 2 or 3 (2, 4 or 6 poles).
#[derive(Clone, Debug)]
pub struct Butterworth {
    sections: Vec<Section>,
}

impl Butterworth {
    /// Designs the filter.
    ///
    /// # Errors
    /// When the order is not 1, 2 or 3, or the band does not fit the rate.
    pub fn bandpass(order: usize, band: Band, rate_hertz: f64) -> Result<Self> {
        if !(1..=3).contains(&order) {
            return Err(SignalError::Setting { name: "the filter's order", value: order as f64, range: "1, 2 or 3" });
        }
        band.check(rate_hertz)?;
        // Analogue frequencies with the bilinear transform's 2·fs taken as 1.
        let warp = |hertz: f64| (std::f64::consts::PI * hertz / rate_hertz).tan();
        let (low, high) = (warp(band.low_hertz), warp(band.high_hertz));
        let (width, centre_squared) = (high - low, low * high);
        let prototype: &[Complex64] = match order {
            1 => &[Complex64::new(-1.0, 0.0)],
            2 => &[Complex64::new(-std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2)],
            _ => &[Complex64::new(-1.0, 0.0), Complex64::new(-0.5, 0.866_025_403_784_438_6)],
        };
        let mut sections = Vec::with_capacity(order);
        for pole in prototype {
            let half = pole * (width / 2.0);
            let root = (half * half - centre_squared).sqrt();
            let pair = [half + root, half - root];
            if pole.im == 0.0 {
                // A real prototype pole makes one section: a conjugate pair, or two real poles when the band is wide.
                sections.push(Self::section(pair[0], pair[1], width));
            } else {
                sections.extend(pair.map(|p| Self::section(p, p.conj(), width)));
            }
        }
        Ok(Self { sections })
    }

    /// Bilinear image of `width·s/((s − p)(s − q))`: zeros at ±1, one factor of the band's width in each section.
    fn section(p: Complex64, q: Complex64, width: f64) -> Section {
        let one = Complex64::new(1.0, 0.0);
        let scale = ((one - p) * (one - q)).re;
        let (zp, zq) = ((one + p) / (one - p), (one + q) / (one - q));
        Section { gain: width / scale, a1: -(zp + zq).re, a2: (zp * zq).re }
    }

    /// The transfer function's coefficients `(b, a)`, lowest delay first, `a[0] = 1`, as SciPy prints them.
    pub fn coefficients(&self) -> (Vec<f64>, Vec<f64>) {
        let multiply = |polynomial: &[f64], factor: [f64; 3]| {
            let mut product = vec![0.0; polynomial.len() + 2];
            for (i, x) in polynomial.iter().enumerate() {
                for (j, y) in factor.iter().enumerate() {
                    product[i + j] += x * y;
                }
            }
            product
        };
        self.sections.iter().fold((vec![1.0], vec![1.0]), |(b, a), s| {
            (multiply(&b, [s.gain, 0.0, -s.gain]), multiply(&a, [1.0, s.a1, s.a2]))
        })
    }

    /// Samples by which the signal is extended at each end, `3·(2·order + 1)`; a signal must be longer than this.
    pub fn padding(&self) -> usize {
        3 * (2 * self.sections.len() + 1)
    }

    /// Forward–backward filtering: no phase shift, the magnitude response squared. The ends are extended oddly by
    /// [`padding`](Self::padding) samples, each pass starting from the steady state of its first sample.
    ///
    /// # Errors
    /// When the signal is not finite or not longer than the padding.
    pub fn filtfilt(&self, signal: &[f64]) -> Result<Vec<f64>> {
        check_finite("the signal to filter", signal)?;
        let (n, pad) = (signal.len(), self.padding());
        check_length("zero-phase band-pass filtering", pad + 1, n)?;
        let mut extended = Vec::with_capacity(n + 2 * pad);
        extended.extend((1..=pad).rev().map(|i| 2.0 * signal[0] - signal[i]));
        extended.extend_from_slice(signal);
        extended.extend((1..=pad).map(|i| 2.0 * signal[n - 1] - signal[n - 1 - i]));
        self.run(&mut extended);
        extended.reverse();
        self.run(&mut extended);
        extended.reverse();
        Ok(extended[pad..pad + n].to_vec())
    }

    /// One causal pass in place, from the steady state of the first sample. Only the first section sees a constant: its
    /// zero at DC leaves nothing for the next ones, whose steady state is therefore zero.
    fn run(&self, signal: &mut [f64]) {
        let mut constant = signal.first().copied().unwrap_or(0.0);
        for Section { gain, a1, a2 } in &self.sections {
            let (mut z0, mut z1) = (-gain * constant, -gain * constant);
            for value in &mut *signal {
                let input = gain * *value;
                let output = input + z0;
                z0 = z1 - a1 * output;
                z1 = -input - a2 * output;
                *value = output;
            }
            constant = 0.0;
        }
    }
}

/// Zero-phase Butterworth band-pass of a signal; the paper's is order 1 over [`Band::PAPER`].
///
/// # Errors
/// When the signal is too short or not finite, or the band does not fit the rate.
pub fn bandpass(signal: &[f64], rate_hertz: f64, band: Band, order: usize) -> Result<Vec<f64>> {
    Butterworth::bandpass(order, band, rate_hertz)?.filtfilt(signal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_the_middle_stops_the_rest_and_halves_at_the_edges() -> Result<()> {
        for (order, rate) in [(1, 30.0), (2, 24.0), (3, 30.0), (3, 1000.0), (1, 7.0)] {
            let band = Band::PAPER;
            let n = (rate * 120.0) as usize;
            let gain = |hertz: f64| -> Result<f64> {
                let tone: Vec<f64> = (0..n).map(|i| (std::f64::consts::TAU * hertz * i as f64 / rate).cos()).collect();
                let out = bandpass(&tone, rate, band, order)?;
                let (from, to) = (n / 4, 3 * n / 4);
                let dot: f64 = tone[from..to].iter().zip(&out[from..to]).map(|(a, b)| a * b).sum();
                Ok(dot / tone[from..to].iter().map(|a| a * a).sum::<f64>())
            };
            assert!((gain(0.75)? - 0.5).abs() < 0.02, "order {order} at {rate} Hz: {}", gain(0.75)?);
            assert!((gain(3.0)? - 0.5).abs() < 0.02);
            let warp = |hertz: f64| (std::f64::consts::PI * hertz / rate).tan();
            let centre = rate / std::f64::consts::PI * (warp(0.75) * warp(3.0)).sqrt().atan();
            assert!((gain(centre)? - 1.0).abs() < 1e-3);
            assert!(gain(0.1)? < 0.05_f64.powi(order as i32) * 2.0);
        }
        Ok(())
    }

    #[test]
    fn a_constant_becomes_zero_and_time_reversal_commutes() -> Result<()> {
        assert!(bandpass(&[7.0; 64], 30.0, Band::PAPER, 3)?.iter().all(|v| v.abs() < 1e-12));
        let x: Vec<f64> = (0..600).map(|i| (f64::from(i * i) * 0.01).sin()).collect();
        let back: Vec<f64> = x.iter().rev().copied().collect();
        let (forward, mut backward) = (bandpass(&x, 30.0, Band::PAPER, 1)?, bandpass(&back, 30.0, Band::PAPER, 1)?);
        backward.reverse();
        // Exact only far from the ends, where the padding's finite length is forgotten.
        assert!((200..400).all(|i| (forward[i] - backward[i]).abs() < 1e-9));
        Ok(())
    }

    #[test]
    fn refuses_short_signals_and_bands_that_do_not_fit() {
        let band = Band::PAPER;
        assert!(matches!(bandpass(&[1.0; 9], 30.0, band, 1), Err(SignalError::TooShort { needed: 10, .. })));
        assert!(bandpass(&[1.0; 10], 30.0, band, 1).is_ok());
        assert!(matches!(bandpass(&[], 30.0, band, 1), Err(SignalError::Empty(_))));
        for rate in [0.0, -30.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(bandpass(&[1.0; 99], rate, band, 1), Err(SignalError::Rate { .. })), "{rate}");
        }
        assert!(matches!(bandpass(&[1.0; 99], 6.0, band, 1), Err(SignalError::Band { .. })));
        let odd = Band { low_hertz: 2.0, high_hertz: f64::NAN };
        assert!(matches!(bandpass(&[1.0; 99], 30.0, odd, 1), Err(SignalError::Band { .. })));
        assert!(matches!(bandpass(&[1.0; 99], 30.0, band, 4), Err(SignalError::Setting { .. })));
        assert!(matches!(bandpass(&[f64::NAN; 99], 30.0, band, 1), Err(SignalError::NotFinite { .. })));
    }
}
