//! Smoothness-prior detrending (Tarvainen, Ranta-aho & Karjalainen 2002): what is left of a signal after its smooth trend.
//!
//! With D the `(n−2)×n` second difference, the trend is `(I + λ²DᵀD)⁻¹y`. The push-through identity turns the
//! remainder into `λ²Dᵀ(I + λ²DDᵀ)⁻¹D·y`, which never subtracts two large numbers: a constant or a line goes to zero up to
//! `|y|·λ·1e-16`. `I + λ²DDᵀ` is pentadiagonal and Toeplitz; its banded factor is made once, so applying costs `O(n)`.
//! The operator is symmetric (self-adjoint), hence its own transpose in a gradient. `λ` has no unit: it counts samples.

use crate::error::{Result, SignalError, check_finite};

/// Largest λ accepted: beyond it rounding (`λ·1e-16` of the signal's size) would reach a millionth of the signal.
pub const MAX_LAMBDA: f64 = 1e9;

/// How λ is given. λ counts samples: at 30 Hz, λ = 100 halves the amplitude at 0.48 Hz, but at 100 Hz it halves it at
/// 1.6 Hz and takes a resting pulse away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Smoothness {
    /// This λ at any sampling rate (the toolbox).
    Fixed(f64),
    /// The λ that acts at any sampling rate as this one acts at 30 Hz.
    AsAt30Hertz(f64),
}

impl Smoothness {
    /// The λ to use at a sampling rate; the cut-off goes with `rate/√λ`.
    pub fn lambda(self, rate_hertz: f64) -> f64 {
        match self {
            Self::Fixed(lambda) => lambda,
            Self::AsAt30Hertz(lambda) => lambda * (rate_hertz / 30.0).powi(2),
        }
    }
}

/// The detrending operator for one length and one λ, factored.
#[derive(Clone, Debug)]
pub struct Detrender {
    length: usize,
    lambda_squared: f64,
    /// `LDLᵀ` of `I + λ²DDᵀ`: per row 1/d, and the two entries of L left of the diagonal.
    inverse_pivot: Vec<f64>,
    below: Vec<[f64; 2]>,
}

impl Detrender {
    /// Factors the operator for signals of `length` samples. Fewer than three samples have no second difference: all of
    /// the signal is trend and the result is zero.
    ///
    /// # Errors
    /// When `length` is zero or `lambda` is outside `0..=`[`MAX_LAMBDA`].
    pub fn new(length: usize, lambda: f64) -> Result<Self> {
        if length == 0 {
            return Err(SignalError::Empty("the signal to detrend"));
        }
        if !(0.0..=MAX_LAMBDA).contains(&lambda) {
            return Err(SignalError::Setting { name: "detrending λ", value: lambda, range: "between 0 and 1e9" });
        }
        let rows = length.saturating_sub(2);
        let square = lambda * lambda;
        let (diagonal, first, second) = (1.0 + 6.0 * square, -4.0 * square, square);
        let mut inverse_pivot = Vec::with_capacity(rows);
        let mut below: Vec<[f64; 2]> = Vec::with_capacity(rows);
        let (mut pivot_1, mut pivot_2, mut left_1) = (0.0, 0.0, 0.0);
        for row in 0..rows {
            // Row of L: (…, far, near, 1); pivots d of the two rows before.
            let far = if row >= 2 { second / pivot_2 } else { 0.0 };
            let near = if row >= 1 { (first - far * pivot_2 * left_1) / pivot_1 } else { 0.0 };
            let pivot = diagonal - near * near * pivot_1 - far * far * pivot_2;
            inverse_pivot.push(1.0 / pivot);
            below.push([far, near]);
            (pivot_2, pivot_1, left_1) = (pivot_1, pivot, near);
        }
        Ok(Self { length, lambda_squared: square, inverse_pivot, below })
    }

    /// Number of samples the operator was made for.
    pub fn len(&self) -> usize {
        self.length
    }

    /// Never true: an operator of no samples cannot be made.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Replaces the signal by its detrended self. Not-finite samples stay not finite and spread; check before.
    ///
    /// # Errors
    /// When the signal has another length than the operator.
    pub fn apply(&self, signal: &mut [f64]) -> Result<()> {
        let n = self.length;
        if signal.len() != n {
            return Err(SignalError::Length { what: "the signal to detrend", expected: n, found: signal.len() });
        }
        let rows = self.below.len();
        let mut solution: Vec<f64> = signal.windows(3).map(|w| (w[0] - w[1]) - (w[1] - w[2])).collect();
        for row in 1..rows {
            let [far, near] = self.below[row];
            let two_before = if row >= 2 { solution[row - 2] } else { 0.0 };
            solution[row] -= near * solution[row - 1] + far * two_before;
        }
        for row in (0..rows).rev() {
            let mut value = solution[row] * self.inverse_pivot[row];
            if row + 1 < rows {
                value -= self.below[row + 1][1] * solution[row + 1];
            }
            if row + 2 < rows {
                value -= self.below[row + 2][0] * solution[row + 2];
            }
            solution[row] = value;
        }
        signal.fill(0.0);
        for (row, value) in solution.into_iter().enumerate() {
            let scaled = self.lambda_squared * value;
            signal[row] += scaled;
            signal[row + 1] -= 2.0 * scaled;
            signal[row + 2] += scaled;
        }
        Ok(())
    }
}

/// The signal less its smooth trend, same length and unit.
///
/// # Errors
/// When the signal is empty or not finite, or λ is out of range.
pub fn detrend(signal: &[f64], lambda: f64) -> Result<Vec<f64>> {
    check_finite("the signal to detrend", signal)?;
    let mut remainder = signal.to_vec();
    Detrender::new(signal.len(), lambda)?.apply(&mut remainder)?;
    Ok(remainder)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition, by dense elimination.
    #[expect(clippy::needless_range_loop, reason = "elimination is clearest by index")]
    fn reference(signal: &[f64], lambda: f64) -> Vec<f64> {
        let n = signal.len();
        let mut a = vec![vec![0.0; n + 1]; n];
        for (i, row) in a.iter_mut().enumerate() {
            row[i] = 1.0;
            row[n] = signal[i];
        }
        for r in 0..n.saturating_sub(2) {
            for (i, x) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                for (j, y) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                    a[r + i][r + j] += lambda * lambda * x * y;
                }
            }
        }
        for k in 0..n {
            for i in 0..n {
                if i != k {
                    let factor = a[i][k] / a[k][k];
                    for j in k..=n {
                        let upper = a[k][j];
                        a[i][j] -= factor * upper;
                    }
                }
            }
        }
        (0..n).map(|i| signal[i] - a[i][n] / a[i][i]).collect()
    }

    #[test]
    fn equals_the_dense_definition_at_every_small_length() -> Result<()> {
        for n in 1..40 {
            let signal: Vec<f64> = (0..n).map(|i| (i as f64 * 0.9).sin() + 0.1 * i as f64).collect();
            for lambda in [0.0, 0.3, 10.0, 100.0] {
                let wanted = reference(&signal, lambda);
                for (got, want) in detrend(&signal, lambda)?.iter().zip(&wanted) {
                    assert!((got - want).abs() < 1e-9, "n {n} λ {lambda}: {got} {want}");
                }
            }
        }
        assert_eq!(detrend(&[5.0], 100.0)?, [0.0]);
        assert_eq!(detrend(&[5.0, 9.0], 100.0)?, [0.0, 0.0]);
        Ok(())
    }

    #[test]
    fn lines_vanish_and_the_operator_is_self_adjoint() -> Result<()> {
        let line: Vec<f64> = (0..1800).map(|i| 500.0 + 0.37 * f64::from(i)).collect();
        assert!(detrend(&line, 100.0)?.iter().all(|v| v.abs() < 1e-9));
        let operator = Detrender::new(257, 100.0)?;
        let u: Vec<f64> = (0..257).map(|i| (f64::from(i) * 1.7).sin()).collect();
        let v: Vec<f64> = (0..257).map(|i| (f64::from(i * i) * 0.013).cos()).collect();
        let (mut au, mut av) = (u.clone(), v.clone());
        operator.apply(&mut au)?;
        operator.apply(&mut av)?;
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        assert!((dot(&au, &v) - dot(&u, &av)).abs() < 1e-9);
        Ok(())
    }

    #[test]
    fn refuses_what_has_no_answer() -> Result<()> {
        assert!(matches!(detrend(&[], 100.0), Err(SignalError::Empty(_))));
        assert!(matches!(detrend(&[0.0, f64::NAN], 100.0), Err(SignalError::NotFinite { index: 1, .. })));
        for lambda in [f64::NAN, -1.0, f64::INFINITY] {
            assert!(matches!(Detrender::new(9, lambda), Err(SignalError::Setting { .. })));
        }
        assert!(matches!(Detrender::new(9, 1.0)?.apply(&mut [0.0; 8]), Err(SignalError::Length { .. })));
        Ok(())
    }
}
