//! The fundamental waveform: two Gaussians in phase (paper, equation 2; Tang et al. 2020), with its derivative and the
//! quadratic penalties that keep it a pulse: 1 ≥ A₁ > A₂ ≥ 0, 2 ≥ σ₂ > σ₁ ≥ 0, π ≥ μ₂ > μ₁ ≥ −π.
//!
//! Phase in radians, amplitudes without unit (albedo enters with the scale A outside). f64.

use crate::numeric::{sigmoid, softplus, softplus_inverse, wrap};

/// Added to every width, radians: no Gaussian narrower than a hundredth of a frame's phase step.
const LEAST_WIDTH: f64 = 1e-3;

/// Learnable parameters; index 0 is the systolic, 1 the diastolic wave.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Waveform {
    /// A_k before softplus.
    pub raw_amplitude: [f64; 2],
    /// μ_k, radians.
    pub center: [f64; 2],
    /// σ_k before softplus.
    pub raw_width: [f64; 2],
}

/// Distance to each wave's centre in widths, and its height, one pair of pairs a frame.
pub struct Waves(Vec<[[f64; 2]; 2]>);

/// Gradient with respect to the fields of [`Waveform`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WaveformGradient {
    /// ∂L/∂raw_amplitude.
    pub raw_amplitude: [f64; 2],
    /// ∂L/∂center.
    pub center: [f64; 2],
    /// ∂L/∂raw_width.
    pub raw_width: [f64; 2],
}

/// Weights of the three penalties (paper: λ_A = λ_σ = 0.6, λ_μ = 0.1).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PenaltyWeights {
    /// λ_A.
    pub amplitude: f64,
    /// λ_σ.
    pub width: f64,
    /// λ_μ.
    pub center: f64,
}

impl Default for PenaltyWeights {
    fn default() -> Self {
        Self { amplitude: 0.6, width: 0.6, center: 0.1 }
    }
}

impl Default for Waveform {
    /// A systolic wave at phase 0 and a broader, lower diastolic wave a quarter beat later: a common adult finger PPG.
    fn default() -> Self {
        Self::new([0.9, 0.4], [0.0, 1.6], [0.6, 1.0])
    }
}

impl Waveform {
    /// From amplitudes (> 0), centres (radians) and widths (> 1e-3 radians).
    pub fn new(amplitude: [f64; 2], center: [f64; 2], width: [f64; 2]) -> Self {
        Self {
            raw_amplitude: amplitude.map(|value| softplus_inverse(value.max(1e-6))),
            center,
            raw_width: width.map(|value| softplus_inverse((value - LEAST_WIDTH).max(1e-6))),
        }
    }

    /// A₁, A₂.
    pub fn amplitude(&self) -> [f64; 2] {
        self.raw_amplitude.map(softplus)
    }

    /// σ₁, σ₂, radians.
    pub fn width(&self) -> [f64; 2] {
        self.raw_width.map(|raw| LEAST_WIDTH + softplus(raw))
    }

    /// The fundamental at one phase.
    pub fn at(&self, theta: f64) -> f64 {
        let (amplitude, width) = (self.amplitude(), self.width());
        (0..2).map(|k| amplitude[k] * (-0.5 * (wrap(theta - self.center[k]) / width[k]).powi(2)).exp()).sum()
    }

    /// The fundamental at every phase of a clip.
    pub fn evaluate(&self, theta: &[f64]) -> Vec<f64> {
        self.evaluate_kept(theta).0
    }

    /// The same, with what the backward pass needs.
    pub fn evaluate_kept(&self, theta: &[f64]) -> (Vec<f64>, Waves) {
        let (amplitude, narrow) = (self.amplitude(), self.width().map(|width| 1.0 / width));
        let mut waves = Vec::with_capacity(theta.len());
        let value = |theta: &f64| {
            let wave = |k: usize| {
                let z = wrap(theta - self.center[k]) * narrow[k];
                [z, (-0.5 * z * z).exp()]
            };
            let both = [wave(0), wave(1)];
            waves.push(both);
            amplitude[0] * both[0][1] + amplitude[1] * both[1][1]
        };
        let values = theta.iter().map(value).collect();
        (values, Waves(waves))
    }

    /// Vector–Jacobian product of [`Self::evaluate_kept`]: from ∂L/∂u (one a frame) to the parameters, and to θ, which
    /// it adds to `theta_gradient`.
    pub fn evaluate_vjp(&self, waves: &Waves, output: &[f64], theta_gradient: &mut [f64]) -> WaveformGradient {
        let (amplitude, width) = (self.amplitude(), self.width());
        let mut gradient = WaveformGradient::default();
        for k in 0..2 {
            let (mut to_amplitude, mut to_center, mut to_width) = (0.0, 0.0, 0.0);
            for ((waves, pulled), theta_gradient) in waves.0.iter().zip(output).zip(theta_gradient.iter_mut()) {
                let [z, shape] = waves[k];
                let wave = pulled * amplitude[k] * shape;
                to_amplitude += pulled * shape;
                to_center += wave * z;
                to_width += wave * z * z;
                *theta_gradient -= wave * z / width[k];
            }
            gradient.raw_amplitude[k] = to_amplitude * sigmoid(self.raw_amplitude[k]);
            gradient.center[k] = to_center / width[k];
            gradient.raw_width[k] = to_width / width[k] * sigmoid(self.raw_width[k]);
        }
        gradient
    }

    /// L_reg and its gradient, added to `gradient` (paper, equation for L_reg; squared hinges).
    pub fn penalty(&self, weights: &PenaltyWeights, gradient: &mut WaveformGradient) -> f64 {
        use std::f64::consts::PI;
        let (amplitude, width) = (self.amplitude(), self.width());
        let (l_a, d_a) = ordered_penalty([0.0, amplitude[1], amplitude[0], 1.0]);
        let (l_s, d_s) = ordered_penalty([0.0, width[0], width[1], 2.0]);
        let (l_m, d_m) = ordered_penalty([-PI, self.center[0], self.center[1], PI]);
        for k in 0..2 {
            gradient.raw_amplitude[k] += weights.amplitude * d_a[1 - k] * sigmoid(self.raw_amplitude[k]);
            gradient.raw_width[k] += weights.width * d_s[k] * sigmoid(self.raw_width[k]);
            gradient.center[k] += weights.center * d_m[k];
        }
        weights.amplitude * l_a + weights.width * l_s + weights.center * l_m
    }

    /// Peak-to-peak of the waveform over a whole beat, sampled at 1024 phases.
    pub fn peak_to_peak(&self) -> f64 {
        let (low, high) = (0..1024)
            .map(|k| self.at(std::f64::consts::TAU * f64::from(k) / 1024.0))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        high - low
    }

    /// Parameters as one list: raw amplitudes, centres, raw widths.
    pub fn to_array(&self) -> [f64; 6] {
        let (a, m, w) = (self.raw_amplitude, self.center, self.raw_width);
        [a[0], a[1], m[0], m[1], w[0], w[1]]
    }

    /// Inverse of [`Self::to_array`].
    pub fn from_array(p: [f64; 6]) -> Self {
        Self { raw_amplitude: [p[0], p[1]], center: [p[2], p[3]], raw_width: [p[4], p[5]] }
    }
}

impl WaveformGradient {
    /// In the order of [`Waveform::to_array`].
    pub fn to_array(&self) -> [f64; 6] {
        let (a, m, w) = (self.raw_amplitude, self.center, self.raw_width);
        [a[0], a[1], m[0], m[1], w[0], w[1]]
    }
}

/// Squared hinges of v₀ ≤ v₁ ≤ v₂ ≤ v₃ and their derivatives with respect to v₁ and v₂.
fn ordered_penalty(v: [f64; 4]) -> (f64, [f64; 2]) {
    let excess = [v[0] - v[1], v[1] - v[2], v[2] - v[3]].map(|difference| difference.max(0.0));
    let loss = excess.iter().map(|e| e * e).sum();
    (loss, [2.0 * (excess[1] - excess[0]), 2.0 * (excess[2] - excess[1])])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::Random;

    #[test]
    fn gradients_match_finite_differences() {
        let mut random = Random::new(3);
        let theta: Vec<f64> = (0..64).map(|_| std::f64::consts::TAU * (random.unit() - 0.5)).collect();
        let weights: Vec<f64> = (0..64).map(|_| random.normal()).collect();
        let penalties = PenaltyWeights::default();
        // The second waveform violates every constraint, so that every hinge is open.
        for waveform in [Waveform::default(), Waveform::new([1.2, 1.7], [3.5, -3.6], [2.9, 2.4])] {
            let loss = |p: [f64; 6], theta: &[f64]| {
                let waveform = Waveform::from_array(p);
                let fit: f64 = waveform.evaluate(theta).iter().zip(&weights).map(|(u, w)| u * w).sum();
                fit + waveform.penalty(&penalties, &mut WaveformGradient::default())
            };
            let mut to_theta = vec![0.0; theta.len()];
            let mut gradient = waveform.evaluate_vjp(&waveform.evaluate_kept(&theta).1, &weights, &mut to_theta);
            waveform.penalty(&penalties, &mut gradient);
            let (h, p) = (1e-6, waveform.to_array());
            for k in 0..6 {
                let (mut up, mut down) = (p, p);
                up[k] += h;
                down[k] -= h;
                let slope = (loss(up, &theta) - loss(down, &theta)) / (2.0 * h);
                let exact = gradient.to_array()[k];
                assert!((slope - exact).abs() < 1e-6 * slope.abs().max(1.0), "parameter {k}: {slope} {exact}");
            }
            for t in 0..theta.len() {
                let (mut up, mut down) = (theta.clone(), theta.clone());
                up[t] += h;
                down[t] -= h;
                let slope = (loss(p, &up) - loss(p, &down)) / (2.0 * h);
                assert!((slope - to_theta[t]).abs() < 1e-6 * slope.abs().max(1.0), "phase {t}");
            }
        }
    }

    #[test]
    fn a_valid_waveform_is_not_penalised_and_each_violation_is() {
        let penalties = PenaltyWeights::default();
        let penalty = |w: &Waveform| w.penalty(&penalties, &mut WaveformGradient::default());
        assert_eq!(penalty(&Waveform::default()), 0.0);
        for bad in [
            Waveform::new([1.2, 0.4], [0.0, 1.6], [0.6, 1.0]),
            Waveform::new([0.4, 0.6], [0.0, 1.6], [0.6, 1.0]),
            Waveform::new([0.9, 0.4], [1.7, 1.6], [0.6, 1.0]),
            Waveform::new([0.9, 0.4], [0.0, 3.3], [0.6, 1.0]),
            Waveform::new([0.9, 0.4], [-3.3, 1.6], [0.6, 1.0]),
            Waveform::new([0.9, 0.4], [0.0, 1.6], [1.2, 1.0]),
            Waveform::new([0.9, 0.4], [0.0, 1.6], [0.6, 2.2]),
        ] {
            assert!(penalty(&bad) > 0.0, "{bad:?}");
        }
    }
}
