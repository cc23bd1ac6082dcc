//! The analytic signal and the instantaneous phase of a band-passed trace (the paper's θ_POS).
//!
//! The phase is 0 at a maximum and grows by 2π a beat. It is that of the trace as given: an rPPG trace is brightness, so a
//! real face's POS phase is shifted against a contact PPG's by about π plus the transit delay, a constant that a user
//! removes with [`circular_offset`].

use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;

use crate::error::{Result, SignalError, check_finite};

/// The analytic signal `x + i·H(x)`, by zeroing the negative frequencies; same length.
///
/// # Errors
/// When the signal is empty or not finite.
pub fn analytic_signal(signal: &[f64]) -> Result<Vec<Complex64>> {
    check_finite("the signal", signal)?;
    let n = signal.len();
    let mut planner = FftPlanner::new();
    let mut spectrum: Vec<Complex64> = signal.iter().map(|&value| Complex64::new(value, 0.0)).collect();
    planner.plan_fft_forward(n).process(&mut spectrum);
    for (bin, value) in spectrum.iter_mut().enumerate() {
        let weight = match bin {
            0 => 1.0,
            _ if 2 * bin < n => 2.0,
            _ if 2 * bin == n => 1.0,
            _ => 0.0,
        };
        *value *= weight / n as f64;
    }
    planner.plan_fft_inverse(n).process(&mut spectrum);
    Ok(spectrum)
}

/// Envelope `|x + i·H(x)|`, same unit as the signal.
///
/// # Errors
/// As [`analytic_signal`].
pub fn envelope(signal: &[f64]) -> Result<Vec<f64>> {
    Ok(analytic_signal(signal)?.iter().map(|value| value.norm()).collect())
}

/// Instantaneous phase in (−π, π], radians, 0 at a maximum of the signal.
///
/// # Errors
/// As [`analytic_signal`], and when the signal is zero throughout.
pub fn instantaneous_phase(signal: &[f64]) -> Result<Vec<f64>> {
    let analytic = analytic_signal(signal)?;
    if signal.iter().all(|value| *value == 0.0) {
        return Err(SignalError::Flat("the signal whose phase is asked for"));
    }
    Ok(analytic.iter().map(|value| value.im.atan2(value.re)).collect())
}

/// A phase made continuous: whole turns are added so that no step exceeds π.
pub fn unwrap(phase_radians: &[f64]) -> Vec<f64> {
    let mut turned = Vec::with_capacity(phase_radians.len());
    for &phase in phase_radians {
        let before = turned.last().copied().unwrap_or(phase);
        turned.push(before + wrap(phase - before));
    }
    turned
}

/// An angle brought to [−π, π].
pub fn wrap(radians: f64) -> f64 {
    radians.sin().atan2(radians.cos())
}

/// Circular mean of `left − right` and its resultant length in [0, 1] (1 = the two keep one constant distance).
///
/// # Errors
/// When the lengths differ, or are zero, or a phase is not finite.
pub fn circular_offset(left: &[f64], right: &[f64]) -> Result<(f64, f64)> {
    check_finite("the first phase", left)?;
    check_finite("the second phase", right)?;
    if left.len() != right.len() {
        return Err(SignalError::Length { what: "the second phase", expected: left.len(), found: right.len() });
    }
    let sum: Complex64 = left.iter().zip(right).map(|(a, b)| Complex64::cis(a - b)).sum();
    Ok((sum.im.atan2(sum.re), sum.norm() / left.len() as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn phase_of_a_cosine_is_its_argument() -> Result<()> {
        for n in [300, 301] {
            let argument = |i: usize| TAU * 10.0 * i as f64 / n as f64 + 0.4;
            let signal: Vec<f64> = (0..n).map(|i| argument(i).cos()).collect();
            let phase = unwrap(&instantaneous_phase(&signal)?);
            assert!((0..n).all(|i| (phase[i] - argument(i)).abs() < 1e-9));
            assert!(envelope(&signal)?.iter().all(|e| (e - 1.0).abs() < 1e-9));
        }
        Ok(())
    }

    #[test]
    fn offsets_are_circular() -> Result<()> {
        let a: Vec<f64> = (0..50).map(|i| f64::from(i) * 0.3).collect();
        let b: Vec<f64> = a.iter().map(|v| v + 3.0 + TAU).collect();
        let (offset, length) = circular_offset(&a, &b)?;
        assert!((offset + 3.0).abs() < 1e-9 && (length - 1.0).abs() < 1e-12);
        assert!((wrap(3.0 * PI + 0.1) - (0.1 - PI)).abs() < 1e-12);
        Ok(())
    }

    #[test]
    fn refuses_nothing_nan_and_silence() -> Result<()> {
        assert!(matches!(analytic_signal(&[]), Err(SignalError::Empty(_))));
        assert!(matches!(envelope(&[f64::INFINITY]), Err(SignalError::NotFinite { .. })));
        assert!(matches!(instantaneous_phase(&[0.0; 8]), Err(SignalError::Flat(_))));
        assert_eq!(instantaneous_phase(&[2.0])?, [0.0]);
        assert!(matches!(circular_offset(&[0.0], &[0.0, 1.0]), Err(SignalError::Length { .. })));
        assert!(unwrap(&[]).is_empty());
        Ok(())
    }
}
