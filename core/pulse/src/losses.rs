//! The losses of stage 2 and their exact gradients, f64: circular phase losses, waveform losses on detrended and
//! normalised signals (paper, Optimization). The photometric one is in `render_loss.rs`.
//!
//! Detrending is D = I − (I + λ²D₂ᵀD₂)⁻¹, a symmetric linear map, so its transpose in the backward pass is itself.

use heartian_signal::{Detrender, Smoothness};

use crate::error::{PulseError, check_finite, check_length};
use crate::numeric::{mean, wrap};

/// Smoothness prior of the toolbox and the paper, which work at 30 Hz; alike in hertz at other frame rates.
pub const DETREND: Smoothness = Smoothness::AsAt30Hertz(100.0);

/// A standard deviation below this share of the signal's largest magnitude counts as flat.
const FLAT: f64 = 1e-12;

/// Weights of the loss terms (paper: λ_pha = λ_m = λ_p = 1, λ_pos = 0.3).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LossWeights {
    /// λ_pha, against the beat-aligned reference phase.
    pub phase: f64,
    /// λ_pos, against the weak phase from the video.
    pub pos: f64,
    /// λ_m.
    pub mse: f64,
    /// λ_p.
    pub pearson: f64,
    /// Weight of L_base (1 in the paper).
    pub base: f64,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { phase: 1.0, pos: 0.3, mse: 1.0, pearson: 1.0, base: 1.0 }
    }
}

/// Weighted mean of squared circular distances (paper, L_phase and L_pos).
///
/// `theta`, `target`: radians, one a frame; `confidence` ≥ 0 weighs frames and is normalised by its sum. Adds
/// `scale`·∂L/∂θ to `gradient` and returns the unscaled loss; 0 when no frame counts.
pub fn circular_loss(theta: &[f64], target: &[f64], confidence: &[f64], scale: f64, gradient: &mut [f64]) -> f64 {
    let total: f64 = confidence.iter().sum();
    if total <= 0.0 {
        return 0.0;
    }
    let mut loss = 0.0;
    for (((theta, target), weight), gradient) in theta.iter().zip(target).zip(confidence).zip(gradient) {
        let distance = wrap(theta - target);
        loss += weight * distance * distance;
        *gradient += scale * 2.0 * weight * distance / total;
    }
    loss / total
}

/// Zero mean and unit (population) deviation. A flat signal becomes zeros with `deviation` 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Normalised {
    /// The normalised values.
    pub values: Vec<f64>,
    /// The deviation divided by; 0 for a flat signal.
    pub deviation: f64,
}

/// Normalises.
pub fn normalise(values: &[f64]) -> Normalised {
    let centre = mean(values);
    let deviation = mean(&values.iter().map(|v| (v - centre).powi(2)).collect::<Vec<_>>()).sqrt();
    let largest = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if deviation.is_nan() || deviation <= FLAT * largest || deviation == 0.0 {
        return Normalised { values: vec![0.0; values.len()], deviation: 0.0 };
    }
    Normalised { values: values.iter().map(|v| (v - centre) / deviation).collect(), deviation }
}

/// Vector–Jacobian product of [`normalise`]: zero for a flat signal.
pub fn normalise_vjp(output: &Normalised, pulled: &[f64]) -> Vec<f64> {
    if output.deviation == 0.0 {
        return vec![0.0; pulled.len()];
    }
    let average = mean(pulled);
    let along = pulled.iter().zip(&output.values).map(|(g, y)| g * y).sum::<f64>() / pulled.len().max(1) as f64;
    pulled.iter().zip(&output.values).map(|(g, y)| (g - average - y * along) / output.deviation).collect()
}

fn detrended(detrender: &Detrender, signal: &[f64]) -> Result<Vec<f64>, PulseError> {
    let mut remainder = signal.to_vec();
    detrender.apply(&mut remainder)?;
    Ok(remainder)
}

/// The reference waveform, and the detrending both sides pass through.
pub struct WaveformTarget {
    detrender: Detrender,
    target: Normalised,
}

/// L_mse, L_pearson and their gradient.
#[derive(Clone, Debug, PartialEq)]
pub struct WaveformLoss {
    /// Mean squared difference of the normalised signals.
    pub mse: f64,
    /// 1 − Pearson correlation, in [0, 2]; 1 for a flat signal.
    pub pearson: f64,
    /// ∂(λ_m·mse + λ_p·pearson)/∂signal, one a frame.
    pub gradient: Vec<f64>,
}

impl WaveformTarget {
    /// From the reference PPG at frame times, `rate_hertz` frames a second.
    ///
    /// # Errors
    /// When values are not finite or too few to detrend.
    pub fn new(reference: &[f64], rate_hertz: f64) -> Result<Self, PulseError> {
        check_finite("the reference waveform", reference)?;
        let detrender = Detrender::new(reference.len(), DETREND.lambda(rate_hertz))?;
        let target = normalise(&detrended(&detrender, reference)?);
        Ok(Self { detrender, target })
    }

    /// The detrended, normalised reference s_gt.
    pub fn values(&self) -> &[f64] {
        &self.target.values
    }

    /// Detrended and normalised form of a signal, as it is compared.
    ///
    /// # Errors
    /// When the signal has another length.
    pub fn prepare(&self, signal: &[f64]) -> Result<Normalised, PulseError> {
        check_length("the signal", self.target.values.len(), signal.len())?;
        Ok(normalise(&detrended(&self.detrender, signal)?))
    }

    /// Pearson correlation of a signal with the reference after detrending.
    ///
    /// # Errors
    /// When the signal has another length.
    pub fn correlation(&self, signal: &[f64]) -> Result<f64, PulseError> {
        let s = self.prepare(signal)?;
        Ok(s.values.iter().zip(self.values()).map(|(a, b)| a * b).sum::<f64>() / s.values.len().max(1) as f64)
    }

    /// λ_m·L_mse + λ_p·L_pearson of one path, with the exact gradient through normalisation and detrending.
    ///
    /// # Errors
    /// When the signal has another length.
    pub fn loss(&self, signal: &[f64], weights: &LossWeights) -> Result<WaveformLoss, PulseError> {
        let s = self.prepare(signal)?;
        let count = s.values.len().max(1) as f64;
        let (mut mse, mut product, mut pulled) = (0.0, 0.0, Vec::with_capacity(s.values.len()));
        for (s, target) in s.values.iter().zip(self.values()) {
            mse += (s - target).powi(2);
            product += s * target;
            // Both sides are normalised, so the correlation is their mean product.
            pulled.push((2.0 * weights.mse * (s - target) - weights.pearson * target) / count);
        }
        let mut gradient = normalise_vjp(&s, &pulled);
        self.detrender.apply(&mut gradient)?;
        Ok(WaveformLoss { mse: mse / count, pearson: 1.0 - product / count, gradient })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::numeric::Random;

    #[test]
    fn waveform_gradient_matches_finite_differences_through_detrend_and_normalisation() {
        let mut random = Random::new(11);
        let reference: Vec<f64> = (0..90).map(|t| (0.3 * t as f64).sin() + 0.02 * t as f64).collect();
        let signal: Vec<f64> = (0..90).map(|t| (0.29 * t as f64 + 0.4).sin() + 0.1 * random.normal()).collect();
        let target = WaveformTarget::new(&reference, 30.0).unwrap();
        let weights = LossWeights { mse: 0.7, pearson: 1.3, ..LossWeights::default() };
        let value = |signal: &[f64]| {
            let loss = target.loss(signal, &weights).unwrap();
            0.7 * loss.mse + 1.3 * loss.pearson
        };
        let gradient = target.loss(&signal, &weights).unwrap().gradient;
        for t in 0..signal.len() {
            let (h, mut up, mut down) = (1e-5, signal.clone(), signal.clone());
            up[t] += h;
            down[t] -= h;
            let slope = (value(&up) - value(&down)) / (2.0 * h);
            assert!((slope - gradient[t]).abs() < 1e-8, "{t}: {slope} {}", gradient[t]);
        }
    }

    #[test]
    fn circular_gradient_matches_finite_differences_and_knows_the_cut() {
        let theta = [3.1, -3.1, 0.2, 1.0];
        let (target, confidence) = ([-3.1, 3.1, 0.0, -1.0], [1.0, 0.5, 0.0, 2.0]);
        let value = |theta: &[f64]| circular_loss(theta, &target, &confidence, 1.0, &mut [0.0; 4]);
        let mut gradient = [0.0; 4];
        let loss = circular_loss(&theta, &target, &confidence, 1.0, &mut gradient);
        let near = std::f64::consts::TAU - 6.2;
        assert!((loss - (1.5 * near * near + 2.0 * 4.0) / 3.5).abs() < 1e-12);
        for t in 0..4 {
            let (h, mut up, mut down) = (1e-6, theta, theta);
            up[t] += h;
            down[t] -= h;
            assert!(((value(&up) - value(&down)) / (2.0 * h) - gradient[t]).abs() < 1e-8);
        }
        assert_eq!(circular_loss(&theta, &target, &[0.0; 4], 1.0, &mut gradient), 0.0);
    }

    #[test]
    fn a_flat_signal_has_a_defined_loss_and_no_gradient() {
        let reference: Vec<f64> = (0..60).map(|t| (0.3 * t as f64).sin()).collect();
        let target = WaveformTarget::new(&reference, 30.0).unwrap();
        let loss = target.loss(&[0.25; 60], &LossWeights::default()).unwrap();
        assert!((loss.pearson - 1.0).abs() < 1e-9 && (loss.mse - 1.0).abs() < 1e-9);
        assert!(loss.gradient.iter().all(|g| *g == 0.0));
        assert!(target.loss(&[0.0; 3], &LossWeights::default()).is_err());
        assert!(WaveformTarget::new(&[f64::NAN; 60], 30.0).is_err());
    }
}
