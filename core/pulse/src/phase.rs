//! Cardiac phase over a clip: cumulative (paper, equation 3) or direct on the unit circle (the paper's alternative).
//!
//! One value a frame, radians in [−π, π], 0 at the systolic peak. Everything f64: the accumulated phase of 10⁶ frames
//! keeps an error below 1e-8 rad, tested.

use crate::numeric::{sigmoid, softplus, softplus_inverse, wrap};

/// How θ(t) is parameterised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Parameterization {
    /// φ(t) = φ₀ + Σ softplus(raw_k), θ = atan2(sin φ, cos φ): time never runs backwards.
    #[default]
    Cumulative,
    /// One free point (x, y) of the unit circle a frame.
    Direct,
}

/// The learnable phase of a clip of T ≥ 1 frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// The parameterisation, which says what `raw` holds.
    pub parameterization: Parameterization,
    /// φ₀, radians; unused by `Direct`.
    pub initial: f64,
    /// `Cumulative`: T raw increments, softplus of which is δ_k. `Direct`: T pairs (x, y), interleaved.
    pub raw: Vec<f64>,
}

/// Gradient with respect to the fields of [`Phase`].
#[derive(Clone, Debug, PartialEq)]
pub struct PhaseGradient {
    /// ∂L/∂φ₀.
    pub initial: f64,
    /// ∂L/∂raw, the layout of [`Phase::raw`].
    pub raw: Vec<f64>,
}

/// Least increment at initialisation, radians a frame: 0.6 beats a minute at 30 frames/s. Softplus cannot reach 0.
const LEAST_INCREMENT: f64 = 2e-3;

impl Phase {
    /// A phase that follows `unwrapped` (radians, one a frame) as closely as its parameterisation can; increments are
    /// floored at 2e-3 rad a frame, since the cumulative form only moves forward.
    pub fn following(parameterization: Parameterization, unwrapped: &[f64]) -> Self {
        match parameterization {
            Parameterization::Direct => {
                let raw = unwrapped.iter().flat_map(|angle| [angle.cos(), angle.sin()]).collect();
                Self { parameterization, initial: 0.0, raw }
            }
            Parameterization::Cumulative => {
                let first = unwrapped.first().copied().unwrap_or(0.0);
                let second = unwrapped.get(1).copied().unwrap_or(first + 0.2);
                let before = first - (second - first).max(LEAST_INCREMENT);
                let (mut reached, mut raw) = (before, Vec::with_capacity(unwrapped.len()));
                for &target in unwrapped {
                    let increment = (target - reached).max(LEAST_INCREMENT);
                    raw.push(softplus_inverse(increment));
                    reached += increment;
                }
                Self { parameterization, initial: before, raw }
            }
        }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        match self.parameterization {
            Parameterization::Cumulative => self.raw.len(),
            Parameterization::Direct => self.raw.len() / 2,
        }
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.raw.is_empty()
    }

    /// θ(t), radians in [−π, π], one a frame (paper, equation 3).
    pub fn theta(&self) -> Vec<f64> {
        match self.parameterization {
            Parameterization::Cumulative => {
                let mut phi = self.initial;
                let step = |raw: &f64| {
                    // Wrapping as it goes keeps the sum small: its rounding never grows with the clip.
                    phi = wrap(phi + softplus(*raw));
                    phi
                };
                self.raw.iter().map(step).collect()
            }
            Parameterization::Direct => self.raw.as_chunks::<2>().0.iter().map(|[x, y]| y.atan2(*x)).collect(),
        }
    }

    /// Vector–Jacobian product: from ∂L/∂θ (one a frame) to the parameters.
    pub fn theta_vjp(&self, theta_gradient: &[f64]) -> PhaseGradient {
        match self.parameterization {
            Parameterization::Cumulative => {
                let mut raw = vec![0.0; self.raw.len()];
                let mut later = 0.0;
                for (k, gradient) in theta_gradient.iter().enumerate().rev() {
                    later += gradient;
                    raw[k] = later * sigmoid(self.raw[k]);
                }
                PhaseGradient { initial: later, raw }
            }
            Parameterization::Direct => {
                let points = self.raw.as_chunks::<2>().0.iter();
                let pull = |([x, y], gradient): (&[f64; 2], &f64)| {
                    let scale = gradient / (x * x + y * y).max(1e-12);
                    [-y * scale, x * scale]
                };
                PhaseGradient { initial: 0.0, raw: points.zip(theta_gradient).flat_map(pull).collect() }
            }
        }
    }

    /// Returns the points of the direct form to the unit circle; the cumulative form needs nothing.
    pub fn project(&mut self) {
        if self.parameterization == Parameterization::Direct {
            for point in self.raw.as_chunks_mut::<2>().0 {
                let radius = point[0].hypot(point[1]);
                *point = if radius > 1e-9 { [point[0] / radius, point[1] / radius] } else { [1.0, 0.0] };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::Random;
    use std::f64::consts::PI;

    fn check_gradient(phase: &Phase) {
        let mut random = Random::new(7);
        let weights: Vec<f64> = (0..phase.len()).map(|_| random.normal()).collect();
        let loss = |phase: &Phase| phase.theta().iter().zip(&weights).map(|(t, w)| w * t.sin()).sum::<f64>();
        let theta = phase.theta();
        let pulled: Vec<f64> = theta.iter().zip(&weights).map(|(t, w)| w * t.cos()).collect();
        let gradient = phase.theta_vjp(&pulled);
        let h = 1e-6;
        for k in 0..phase.raw.len() {
            let (mut up, mut down) = (phase.clone(), phase.clone());
            up.raw[k] += h;
            down.raw[k] -= h;
            let slope = (loss(&up) - loss(&down)) / (2.0 * h);
            assert!((slope - gradient.raw[k]).abs() < 1e-7 * slope.abs().max(1.0), "{k}: {slope} {}", gradient.raw[k]);
        }
        let (mut up, mut down) = (phase.clone(), phase.clone());
        up.initial += h;
        down.initial -= h;
        let slope = (loss(&up) - loss(&down)) / (2.0 * h);
        assert!((slope - gradient.initial).abs() < 1e-7 * slope.abs().max(1.0));
    }

    #[test]
    fn gradients_match_finite_differences() {
        let unwrapped: Vec<f64> = (0..40).map(|t| -PI + 0.21 * t as f64).collect();
        for parameterization in [Parameterization::Cumulative, Parameterization::Direct] {
            check_gradient(&Phase::following(parameterization, &unwrapped));
        }
    }

    #[test]
    fn follows_what_it_is_given_across_the_cut() {
        let unwrapped: Vec<f64> = (0..500).map(|t| PI - 0.5 + 0.2 * t as f64).collect();
        for parameterization in [Parameterization::Cumulative, Parameterization::Direct] {
            let theta = Phase::following(parameterization, &unwrapped).theta();
            for (found, wanted) in theta.iter().zip(&unwrapped) {
                assert!(wrap(found - wanted).abs() < 1e-9 && found.abs() <= PI + 1e-12);
            }
        }
    }

    #[test]
    fn a_million_frames_do_not_drift() {
        let increment = 0.209_439_510_239_319_56;
        let phase = Phase {
            parameterization: Parameterization::Cumulative,
            initial: -increment,
            raw: vec![softplus_inverse(increment); 1_000_000],
        };
        let theta = phase.theta();
        let worst = (0..theta.len()).map(|t| wrap(theta[t] - increment * t as f64).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-8, "{worst}");
        let single: f32 = (0..1_000_000).fold(0.0f32, |sum, _| sum + increment as f32);
        let drift = (f64::from(single) - increment * 1e6).abs();
        println!("drift over 1e6 frames: f64 {worst:.1e} rad, f32 {drift:.1e} rad");
        assert!(drift > 1.0, "the f32 sum is expected to fail");
    }
}
