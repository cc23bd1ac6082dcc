//! Scalars and small vectors in stable form, f64. Angles are radians; wrapped angles lie in [−π, π].

/// ln(1 + eˣ) without overflow; > 0 for every finite x above about −745.
pub fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// The x with softplus(x) = y, for y > 0.
pub fn softplus_inverse(y: f64) -> f64 {
    y + (-(-y).exp_m1()).ln()
}

/// Derivative of [`softplus`].
pub fn sigmoid(x: f64) -> f64 {
    if x >= 0.0 {
        1.0 / (1.0 + (-x).exp())
    } else {
        let e = x.exp();
        e / (1.0 + e)
    }
}

/// The shortest signed angle: atan2(sin x, cos x), in [−π, π] (paper, equation 2's d).
///
/// Written as a rounded remainder: equal to the arctangent form up to rounding and an order cheaper. Adding and taking
/// away 1.5·2⁵² rounds to the nearest integer without a call; good for angles below 1e15.
#[inline]
pub fn wrap(angle: f64) -> f64 {
    use std::f64::consts::TAU;
    const ROUNDER: f64 = 6_755_399_441_055_744.0;
    let turns = (angle * (1.0 / TAU) + ROUNDER) - ROUNDER;
    angle - TAU * turns
}

/// Mean in f64; 0 for nothing.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// The value at a fraction of the sorted order, linearly interpolated; NaN sorts last, 0 for nothing.
pub fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let at = fraction.clamp(0.0, 1.0) * last as f64;
    let (below, rest) = (at.floor() as usize, at.fract());
    sorted[below] + rest * (sorted[(below + 1).min(last)] - sorted[below])
}

/// SplitMix64: a seeded stream for initial weights and samples; equal on every machine.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// A stream of its own for each seed.
    pub fn new(seed: u64) -> Self {
        Self(seed ^ 0x9E37_79B9_7F4A_7C15)
    }

    /// 64 even bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Even in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Even in 0..count (count ≥ 1).
    pub fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Standard normal (Box–Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn softplus_is_stable_and_inverts() {
        for x in [-700.0, -30.0, -1.0, 0.0, 1e-9, 2.0, 40.0, 700.0] {
            let y = softplus(x);
            assert!(y.is_finite() && y > 0.0, "{x} {y}");
            assert!((softplus_inverse(y) - x).abs() <= 1e-9 * x.abs().max(1.0), "{x} {y}");
            let h = 1e-6;
            let slope = (softplus(x + h) - softplus(x - h)) / (2.0 * h);
            assert!((slope - sigmoid(x)).abs() < 1e-6);
        }
    }

    #[test]
    fn wrapping_equals_the_arctangent() {
        let mut random = Random::new(1);
        for _ in 0..10_000 {
            let angle = 1e3 * (random.unit() - 0.5);
            let (s, c) = angle.sin_cos();
            let difference = (wrap(angle) - s.atan2(c)).abs();
            assert!(difference < 1e-10 || (difference - std::f64::consts::TAU).abs() < 1e-10, "{angle}");
        }
        assert!(wrap(std::f64::consts::PI).abs() <= std::f64::consts::PI);
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(&[1.0, 2.0], 0.25), 1.25);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }
}
