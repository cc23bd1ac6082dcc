//! The total loss on the fundamental path and its gradient (paper, the equation for L).

use crate::error::PulseError;
use crate::losses::{WaveformTarget, circular_loss};
use crate::numeric::mean;
use crate::phase::{Phase, PhaseGradient};
use crate::reference::{Reference, WeakPhase};
use crate::render_loss::BaseLoss;
use crate::waveform::{Waveform, WaveformGradient};

use super::PhaseOptions;

/// What is learnt.
#[derive(Clone, Debug)]
pub(super) struct Variables {
    pub phase: Phase,
    pub waveform: Waveform,
    /// A at the start, linear albedo.
    pub scale: f64,
    /// ln(A / start).
    pub log_scale: f64,
}

/// The gradient of the total loss.
pub(super) struct VariablesGradient {
    pub phase: PhaseGradient,
    pub waveform: WaveformGradient,
    pub log_scale: f64,
}

/// Terms, unweighted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Losses {
    pub phase: f64,
    pub pos: f64,
    pub mse: f64,
    pub pearson: f64,
    pub penalty: f64,
    pub base: f64,
}

/// All that the loss refers to.
pub(super) struct Objective<'a> {
    pub reference: &'a Reference,
    pub target: &'a WaveformTarget,
    pub weak: Option<&'a WeakPhase>,
    pub render: Option<&'a dyn BaseLoss>,
    pub options: &'a PhaseOptions,
}

impl Objective<'_> {
    /// Losses and gradient at a point.
    pub(super) fn evaluate(&self, variables: &Variables) -> Result<(Losses, VariablesGradient), PulseError> {
        let (weights, mut losses) = (&self.options.weights, Losses::default());
        let theta = variables.phase.theta();
        let mut to_theta = vec![0.0; theta.len()];
        losses.phase =
            circular_loss(&theta, &self.reference.phase, &self.reference.confidence, weights.phase, &mut to_theta);
        if let Some(weak) = self.weak {
            losses.pos = circular_loss(&theta, &weak.theta, &weak.confidence, weights.pos, &mut to_theta);
        }
        let (mut shape, waves) = variables.waveform.evaluate_kept(&theta);
        self.reference.envelope.apply(&mut shape);
        let waveform_loss = self.target.loss(&shape, weights)?;
        (losses.mse, losses.pearson) = (waveform_loss.mse, waveform_loss.pearson);
        let mut to_shape = waveform_loss.gradient;
        let mut to_log_scale = 0.0;
        if let Some(render) = self.render.filter(|_| weights.base > 0.0) {
            let scale = variables.scale * variables.log_scale.exp();
            let level = if self.options.centred { mean(&shape) } else { 0.0 };
            let offsets: Vec<f64> = shape.iter().map(|value| scale * (value - level)).collect();
            let mut to_offsets = vec![0.0; offsets.len()];
            losses.base = render.evaluate(&offsets, weights.base, &mut to_offsets)?;
            let average = if self.options.centred { mean(&to_offsets) } else { 0.0 };
            for ((to_shape, to_offset), offset) in to_shape.iter_mut().zip(&to_offsets).zip(&offsets) {
                *to_shape += scale * (to_offset - average);
                to_log_scale += to_offset * offset;
            }
        }
        self.reference.envelope.scale(&mut to_shape);
        let mut waveform = variables.waveform.evaluate_vjp(&waves, &to_shape, &mut to_theta);
        losses.penalty = variables.waveform.penalty(&self.options.penalties, &mut waveform);
        let phase = variables.phase.theta_vjp(&to_theta);
        Ok((losses, VariablesGradient { phase, waveform, log_scale: to_log_scale }))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::numeric::wrap;
    use crate::phase::Parameterization;
    use crate::reference::Prescription;
    use crate::render_loss::{RenderLoss, tests::made_up_operator};

    #[test]
    fn the_total_gradient_matches_finite_differences() {
        let times: Vec<f64> = (0..60).map(|t| f64::from(t) / 30.0).collect();
        let reference = Prescription {
            heart_rate_bpm: 80.0,
            breath_amplitude: 0.3,
            breath_baseline: 0.2,
            ..Prescription::default()
        };
        let reference = reference.reference(&times).unwrap();
        let target = WaveformTarget::new(&reference.waveform, 30.0).unwrap();
        let weak = WeakPhase {
            theta: reference.phase.iter().map(|p| wrap(p + 0.3)).collect(),
            confidence: (0..60).map(|t| f64::from(t % 3) / 2.0).collect(),
            coherence: 1.0,
        };
        let operator = made_up_operator(60, 12, 4, 9);
        let render = RenderLoss::new(&operator, &[0; 4], 1).unwrap();
        let mut options = PhaseOptions::default();
        // L_base is small beside the others; weigh it up so that the check sees it.
        options.weights.base = 300.0;
        let objective = Objective {
            reference: &reference,
            target: &target,
            weak: Some(&weak),
            render: Some(&render),
            options: &options,
        };
        for parameterization in [Parameterization::Cumulative, Parameterization::Direct, Parameterization::Anchored] {
            let start: Vec<f64> = reference.phase.iter().enumerate().map(|(t, p)| p + 0.2 + 0.01 * t as f64).collect();
            let variables = Variables {
                phase: Phase::following(parameterization, &start),
                waveform: Waveform::new([0.8, 0.3], [0.1, 1.4], [0.5, 0.9]),
                scale: 0.01,
                log_scale: 0.1,
            };
            let total = |v: &Variables| {
                let (l, w) = (objective.evaluate(v).unwrap().0, &options.weights);
                w.phase * l.phase + w.pos * l.pos + w.mse * l.mse + w.pearson * l.pearson + l.penalty + w.base * l.base
            };
            let gradient = objective.evaluate(&variables).unwrap().1;
            let check = |name: &str, exact: f64, change: &dyn Fn(&mut Variables, f64)| {
                let (h, mut up, mut down) = (1e-6, variables.clone(), variables.clone());
                change(&mut up, h);
                change(&mut down, -h);
                let slope = (total(&up) - total(&down)) / (2.0 * h);
                assert!((slope - exact).abs() < 2e-6 * slope.abs().max(1.0), "{name}: {slope} {exact}");
            };
            for k in 0..variables.phase.raw.len() {
                check("raw", gradient.phase.raw[k], &|v, h| v.phase.raw[k] += h);
            }
            check("initial", gradient.phase.initial, &|v, h| v.phase.initial += h);
            check("log scale", gradient.log_scale, &|v, h| v.log_scale += h);
            for k in 0..6 {
                check("waveform", gradient.waveform.to_array()[k], &|v, h| {
                    let mut p = v.waveform.to_array();
                    p[k] += h;
                    v.waveform = Waveform::from_array(p);
                });
            }
        }
    }
}
