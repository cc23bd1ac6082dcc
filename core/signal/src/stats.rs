//! Means, deviations and correlations. Deviations are population ones (divide by n), as in NumPy's default and the toolbox.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;

use crate::error::{Result, SignalError, check_finite, check_length};

/// Mean; NaN of nothing.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Population standard deviation; NaN of nothing.
pub fn standard_deviation(values: &[f64]) -> f64 {
    let centre = mean(values);
    (values.iter().map(|value| (value - centre).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Median (mean of the middle two of an even count); NaN of nothing.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => (sorted[n / 2 - 1] + sorted[n / 2]) / 2.0,
    }
}

/// Pearson correlation in [−1, 1].
///
/// # Errors
/// When the lengths differ, fewer than two samples are given, one is not finite, or either signal does not vary.
pub fn pearson(left: &[f64], right: &[f64]) -> Result<f64> {
    let (a, b) = (unit("the first signal", left)?, unit("the second signal", right)?);
    if a.len() != b.len() {
        return Err(SignalError::Length { what: "the second signal", expected: a.len(), found: b.len() });
    }
    Ok(a.iter().zip(&b).map(|(x, y)| x * y).sum::<f64>().clamp(-1.0, 1.0))
}

/// Maximum amplitude of cross-correlation: the largest |Pearson r| over the circular lags `0..n−1` of the second signal,
/// after truncation to the common length n. By FFT in `O(n log n)`: mean and norm do not change under rolling.
/// The toolbox leaves out the last lag, and so does this.
///
/// # Errors
/// As [`pearson`], lengths excepted.
pub fn macc(prediction: &[f64], reference: &[f64]) -> Result<f64> {
    let n = prediction.len().min(reference.len());
    let (a, b) = (unit("the prediction", &prediction[..n])?, unit("the reference", &reference[..n])?);
    let mut planner = FftPlanner::new();
    let (forward, inverse) = (planner.plan_fft_forward(n), planner.plan_fft_inverse(n));
    // One transform of both real signals: z = a + ib; A·conj(B) follows from Z's symmetries.
    let mut z: Vec<Complex64> = a.iter().zip(&b).map(|(&re, &im)| Complex64::new(re, im)).collect();
    forward.process(&mut z);
    let mut product: Vec<Complex64> = (0..n)
        .map(|k| {
            let (here, mirror) = (z[k], z[(n - k) % n].conj());
            let (spectrum_a, spectrum_b) = ((here + mirror) * 0.5, (here - mirror) * Complex64::new(0.0, -0.5));
            spectrum_a * spectrum_b.conj()
        })
        .collect();
    inverse.process(&mut product);
    Ok(product[..n - 1].iter().map(|value| value.re.abs()).fold(0.0, f64::max) / n as f64)
}

/// Centred and scaled to norm 1.
fn unit(what: &'static str, signal: &[f64]) -> Result<Vec<f64>> {
    check_finite(what, signal)?;
    check_length("a correlation", 2, signal.len())?;
    let centre = mean(signal);
    let largest = signal.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let norm = signal.iter().map(|value| (value - centre).powi(2)).sum::<f64>().sqrt();
    if norm <= 1e-14 * largest * (signal.len() as f64).sqrt() {
        return Err(SignalError::Flat(what));
    }
    Ok(signal.iter().map(|value| (value - centre) / norm).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn macc_is_the_largest_rolled_correlation() -> Result<()> {
        let a: Vec<f64> = (0..97).map(|i| (f64::from(i) * 0.31).sin() + 0.2 * (f64::from(i) * 1.9).cos()).collect();
        let b: Vec<f64> = (0..90).map(|i| (f64::from(i) * 0.33 + 1.0).cos()).collect();
        let n = 90;
        let mut most: f64 = 0.0;
        for lag in 0..n - 1 {
            let rolled: Vec<f64> = (0..n).map(|i| b[(i + n - lag) % n]).collect();
            most = most.max(pearson(&a[..n], &rolled)?.abs());
        }
        assert!((macc(&a, &b)? - most).abs() < 1e-12);
        Ok(())
    }

    #[test]
    fn correlation_needs_something_that_varies() {
        assert!(matches!(pearson(&[1.0, 2.0], &[3.0, 3.0]), Err(SignalError::Flat(_))));
        assert!(matches!(pearson(&[], &[]), Err(SignalError::Empty(_))));
        assert!(matches!(macc(&[1.0], &[1.0, 2.0]), Err(SignalError::TooShort { .. })));
        assert!(matches!(pearson(&[1.0, 2.0, 4.0], &[3.0, 1.0]), Err(SignalError::Length { .. })));
        assert!(matches!(macc(&[1.0, f64::NAN], &[1.0, 2.0]), Err(SignalError::NotFinite { .. })));
        assert!(pearson(&[1.0, 2.0, 3.0], &[-2.0, -4.0, -6.0]).is_ok_and(|r| (r + 1.0).abs() < 1e-12));
        assert!(median(&[]).is_nan());
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
    }
}
