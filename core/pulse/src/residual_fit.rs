//! Stage 2, second half: the residual network on top of a frozen fundamental (paper, Optimization: the losses on the full
//! modulation provide gradients to the network, and to B, alone).
//!
//! The mean over all skin Gaussians that the losses need is estimated, step by step, from one Gaussian drawn from each of
//! a few compact patches of skin (seeded): unbiased, and the network is smooth in position. The finished modulation
//! evaluates every Gaussian (`residual_fit/evaluate.rs`).

mod evaluate;
mod patches;

pub use evaluate::{Evaluation, evaluate_all};

use heartian_space::{Modulation, Progress, Skin};

use crate::adam::{Adam, AdamF32, Schedule};
use crate::error::{PulseError, check_length};
use crate::fit::{FitReport, Watch};
use crate::limit::Limited;
use crate::losses::{LossWeights, WaveformTarget};
use crate::numeric::{Random, mean};
use crate::pulse::Pulse;
use crate::render_loss::{BaseLoss, FrozenRenderer};
use crate::residual::matrix::Real;
use crate::residual::{Residual, Shape};
use patches::Patches;

/// In which arithmetic the network is trained; it is kept and evaluated in f32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Precision {
    /// f32.
    #[default]
    Single,
    /// f64: what f32 is judged by.
    Double,
}

/// Settings of [`fit_residual`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ResidualOptions {
    /// Full-batch steps over all frames.
    pub steps: u32,
    /// Width of the trunk (paper: 128).
    pub width: usize,
    /// Skin patches, each represented by one random Gaussian a step; fewer for clips beyond a thousand frames.
    pub patches: usize,
    /// Rate of the network (paper: 3.8e-3 → 5e-4), laid onto the steps taken.
    pub rate: Schedule,
    /// B at the start; the paper does not state it.
    pub residual_weight: f64,
    /// Rate of B (paper: 1e-4).
    pub residual_weight_rate: f64,
    /// Arithmetic of the training.
    pub precision: Precision,
    /// λ of the losses; those of phase are not used here.
    pub weights: LossWeights,
    /// Seed of the initial weights and of the draws.
    pub seed: u64,
    /// How the finished modulation is evaluated.
    pub evaluation: Evaluation,
}

impl Default for ResidualOptions {
    fn default() -> Self {
        Self {
            steps: 300,
            width: 128,
            patches: 4,
            rate: Schedule { first: 3.8e-3, last: 5e-4, steps: 1.0 },
            residual_weight: 0.3,
            residual_weight_rate: 1e-4,
            precision: Precision::Single,
            weights: LossWeights::default(),
            seed: 0,
            evaluation: Evaluation::default(),
        }
    }
}

impl ResidualOptions {
    /// The paper's length: its decay runs over 80,000 frame-level iterations, of which 60 epochs take 60,000.
    pub fn paper() -> Self {
        Self { steps: 60_000, rate: Schedule { first: 3.8e-3, last: 5e-4, steps: 8.0 / 6.0 }, ..Self::default() }
    }

    fn check(&self) -> Result<(), PulseError> {
        let refuse = |name, value, range| Err(PulseError::Parameter { name, value, range });
        if !(1..=64).contains(&self.patches) {
            return refuse("patches", self.patches as f64, "1 to 64");
        }
        if !(self.residual_weight > 0.0 && self.residual_weight <= 10.0) {
            return refuse("residual_weight", self.residual_weight, "(0, 10]");
        }
        Ok(())
    }
}

/// Evaluations (frame, Gaussian) a step beyond which fewer patches are drawn.
const MOST_EVALUATIONS: usize = 8192;

/// Fits the network and evaluates the modulation of every skin Gaussian. Returns the pulse with network and B filled in.
///
/// # Errors
/// When there is no skin, inputs disagree in length, a parameter is out of range, or the callback stops the work.
pub fn fit_residual(
    pulse: &Pulse,
    skin: &Skin,
    renderer: Option<&dyn FrozenRenderer>,
    options: &ResidualOptions,
    progress: Watch<'_>,
) -> Result<(Pulse, Modulation), PulseError> {
    options.check()?;
    if skin.gaussians.is_empty() {
        return Err(PulseError::NoSkin);
    }
    check_length("the skin positions", skin.gaussians.len(), skin.positions.len())?;
    let beats = pulse.beat.iter().max().map_or(1, |&last| last as usize + 1);
    let network = Residual::<f32>::new(Shape { beats, width: options.width }, options.seed)?;
    let count = (MOST_EVALUATIONS / pulse.len().max(1)).clamp(1, options.patches);
    let patches = Patches::new(&skin.positions, count);
    let render = renderer.map(|renderer| renderer.base_loss(&patches.patch_of, patches.len())).transpose()?;
    let shape = pulse.shape();
    let training = Training {
        pulse,
        shape: &shape,
        target: WaveformTarget::new(&pulse.reference, pulse.rate_hertz())?,
        positions: &skin.positions,
        patches,
        render,
        options,
    };
    let (network, residual_weight) = match options.precision {
        Precision::Single => {
            let mut adam = AdamF32::new(network.weights.len());
            training.run(network, |weights, gradient, rate| adam.step(weights, gradient, rate), progress)?
        }
        Precision::Double => {
            let mut adam = Adam::new(network.weights.len());
            let step = |weights: &mut [f64], gradient: &[f64], rate: f64| adam.step(weights, gradient, |_| rate);
            let (network, residual_weight) = training.run(network.cast::<f64>(), step, progress)?;
            (network.cast(), residual_weight)
        }
    };
    let mut fitted = pulse.clone();
    fitted.strength.residual_weight = residual_weight;
    fitted.residual = Some(network);
    let (modulation, limited) = finish(&mut fitted, skin, options)?;
    let full = mean_offsets(&modulation);
    fitted.report = FitReport {
        steps: pulse.report.steps + u64::from(options.steps),
        full_pearson: Some(training.target.correlation(&full)?),
        mse: training.target.loss(&full, &options.weights)?.mse,
        limited,
        ..pulse.report
    };
    Ok((fitted, modulation))
}

/// Evaluates the modulation and holds its strength: where the residual adds more than [`MOST_GROWTH`] to the rms of the
/// fundamental (a recording that is mostly motion), A is lowered until it does not.
fn finish(pulse: &mut Pulse, skin: &Skin, options: &ResidualOptions) -> Result<(Modulation, Limited), PulseError> {
    let first = evaluate_all(pulse, skin, &options.evaluation)?;
    let growth = deviation(&mean_offsets(&first.0)) / deviation(&pulse.fundamental).max(1e-12);
    if growth <= MOST_GROWTH {
        return Ok(first);
    }
    let factor = MOST_GROWTH / growth;
    pulse.strength.scale *= factor;
    pulse.fundamental.iter_mut().for_each(|value| *value *= factor);
    evaluate_all(pulse, skin, &options.evaluation)
}

/// Largest ratio of the full modulation's rms to the fundamental's.
const MOST_GROWTH: f64 = 1.5;

fn deviation(values: &[f64]) -> f64 {
    let centre = mean(values);
    mean(&values.iter().map(|value| (value - centre).powi(2)).collect::<Vec<_>>()).sqrt()
}

/// Mean offset over all Gaussians, one a frame: the attribute signal less the constant mean albedo.
pub fn mean_offsets(modulation: &Modulation) -> Vec<f64> {
    let count = modulation.gaussians.len();
    let average = |frame: &[f32]| frame.iter().map(|&offset| f64::from(offset)).sum::<f64>() / count as f64;
    modulation.offsets.chunks_exact(count).map(average).collect()
}

struct Training<'a> {
    pulse: &'a Pulse,
    shape: &'a [f64],
    target: WaveformTarget,
    positions: &'a [[f32; 3]],
    patches: Patches,
    render: Option<Box<dyn BaseLoss + 'a>>,
    options: &'a ResidualOptions,
}

impl Training<'_> {
    /// Adam over the network, one `step` of weights, gradient and rate at a time, and over B.
    fn run<T: Real>(
        &self,
        mut network: Residual<T>,
        mut adam: impl FnMut(&mut [T], &[T], f64),
        progress: Watch<'_>,
    ) -> Result<(Residual<T>, f64), PulseError> {
        let options = self.options;
        let mut adam_b = Adam::new(1);
        let mut residual_weight = [options.residual_weight];
        let mut random = Random::new(options.seed.wrapping_add(1));
        for step in 0..options.steps {
            let drawn = self.patches.draw(&mut random);
            let points: Vec<[f32; 3]> = drawn.iter().map(|&gaussian| self.positions[gaussian]).collect();
            let frames = network.frames(&self.pulse.theta, &self.pulse.beat);
            let positions = network.positions(&points);
            let (out, kept) = network.forward_kept(&frames, &positions);
            let out: Vec<f64> = out.into_iter().map(Real::to_f64).collect();
            let losses = self.losses(&out, residual_weight[0])?;
            let pulled: Vec<T> = losses.to_outputs.iter().map(|&g| T::from_f64(g)).collect();
            let gradient = network.backward(&frames, &positions, &kept, &pulled);
            let at = f64::from(step) / f64::from(options.steps);
            adam(&mut network.weights, &gradient, options.rate.at(at));
            adam_b.step(&mut residual_weight, &[losses.to_residual_weight], |_| options.residual_weight_rate);
            residual_weight[0] = residual_weight[0].max(1e-3);
            if step % 20 == 0 || step + 1 == options.steps {
                let metric = Some(("waveform_pearson", 1.0 - losses.pearson));
                let report = Progress { step: u64::from(step + 1), total: u64::from(options.steps), metric };
                if progress(report).is_break() {
                    return Err(PulseError::Cancelled);
                }
            }
        }
        Ok((network, residual_weight[0]))
    }

    /// The losses on the full modulation, given the drawn outputs f (T×patches) and B.
    fn losses(&self, out: &[f64], residual_weight: f64) -> Result<Losses, PulseError> {
        let (count, share) = (self.patches.len(), &self.patches.share);
        let averages: Vec<f64> =
            out.chunks_exact(count).map(|frame| frame.iter().zip(share).map(|(f, share)| f * share).sum()).collect();
        let full: Vec<f64> = self.shape.iter().zip(&averages).map(|(u, f)| u + residual_weight * f).collect();
        let loss = self.target.loss(&full, &self.options.weights)?;
        let weights = &self.options.weights;
        let mut losses = Losses {
            pearson: loss.pearson,
            total: weights.mse * loss.mse + weights.pearson * loss.pearson,
            to_outputs: loss.gradient.iter().flat_map(|g| share.iter().map(move |s| g * s * residual_weight)).collect(),
            to_residual_weight: loss.gradient.iter().zip(&averages).map(|(g, f)| g * f).sum::<f64>(),
        };
        if let Some(render) = self.render.as_deref().filter(|_| weights.base > 0.0) {
            self.add_render_loss(render, (out, residual_weight), &mut losses)?;
        }
        Ok(losses)
    }

    /// L_base on offsets A·(u − level + B·(f − mean of f)), the mean over time only when centred.
    fn add_render_loss(
        &self,
        render: &dyn BaseLoss,
        (out, residual_weight): (&[f64], f64),
        losses: &mut Losses,
    ) -> Result<(), PulseError> {
        let (count, strength) = (self.patches.len(), &self.pulse.strength);
        let centred = strength.level != 0.0;
        let means = |table: &[f64]| if centred { column_means(table, count) } else { vec![0.0; count] };
        let middle = means(out);
        let mut offsets = Vec::with_capacity(out.len());
        for (u, frame) in self.shape.iter().zip(out.chunks_exact(count)) {
            let offset = |(f, mean): (&f64, &f64)| strength.scale * (u - strength.level + residual_weight * (f - mean));
            offsets.extend(frame.iter().zip(&middle).map(offset));
        }
        let mut to_offsets = vec![0.0; offsets.len()];
        let weight = self.options.weights.base;
        losses.total += weight * render.evaluate(&offsets, weight, &mut to_offsets)?;
        let pulled_middle = means(&to_offsets);
        let rows = losses.to_outputs.chunks_exact_mut(count).zip(to_offsets.chunks_exact(count));
        for ((to_outputs, to_offsets), out) in rows.zip(out.chunks_exact(count)) {
            for k in 0..count {
                to_outputs[k] += strength.scale * residual_weight * (to_offsets[k] - pulled_middle[k]);
                losses.to_residual_weight += strength.scale * to_offsets[k] * (out[k] - middle[k]);
            }
        }
        Ok(())
    }
}

/// The total loss of one step and where it pulls.
struct Losses {
    pearson: f64,
    total: f64,
    /// ∂L/∂f, T×patches.
    to_outputs: Vec<f64>,
    /// ∂L/∂B.
    to_residual_weight: f64,
}

fn column_means(table: &[f64], count: usize) -> Vec<f64> {
    let mut sums = vec![0.0; count];
    for row in table.chunks_exact(count) {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    let rows = (table.len() / count).max(1) as f64;
    sums.into_iter().map(|sum| sum / rows).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::fit::{PhaseOptions, Scene, fit_phase};
    use crate::reference::Prescription;
    use crate::render_loss::{RenderLoss, tests::made_up_operator};

    #[test]
    fn the_gradient_of_the_full_path_matches_finite_differences() {
        let times: Vec<f64> = (0..60).map(|t| f64::from(t) / 30.0).collect();
        let reference = Prescription { heart_rate_bpm: 80.0, ..Prescription::default() }.reference(&times).unwrap();
        for centred in [true, false] {
            let scene = Scene { mean_green_albedo: 0.3, ..Scene::default() };
            let phase = PhaseOptions { steps: 20, centred, ..PhaseOptions::default() };
            let onwards = &mut |_: Progress| std::ops::ControlFlow::Continue(());
            let (pulse, _) = fit_phase(&reference, &scene, &phase, onwards).unwrap();
            let mut random = Random::new(3);
            let positions: Vec<[f32; 3]> = (0..6).map(|_| std::array::from_fn(|_| random.normal() as f32)).collect();
            let patches = Patches::new(&positions, 3);
            // L_base is small beside the others; weigh it up so that the check sees it.
            let mut options = ResidualOptions::default();
            options.weights.base = 300.0;
            let shape = pulse.waveform.evaluate(&pulse.theta);
            let training = Training {
                pulse: &pulse,
                shape: &shape,
                target: WaveformTarget::new(&pulse.reference, 30.0).unwrap(),
                positions: &positions,
                render: Some(Box::new(RenderLoss::new(&made_up_operator(60, 10, 6, 2), &patches.patch_of, 3).unwrap())),
                patches,
                options: &options,
            };
            let out: Vec<f64> = (0..180).map(|_| 0.2 * random.normal()).collect();
            let losses = training.losses(&out, 0.4).unwrap();
            let h = 1e-6;
            for k in 0..out.len() {
                let (mut up, mut down) = (out.clone(), out.clone());
                up[k] += h;
                down[k] -= h;
                let total = |out: &[f64]| training.losses(out, 0.4).unwrap().total;
                let slope = (total(&up) - total(&down)) / (2.0 * h);
                assert!((slope - losses.to_outputs[k]).abs() < 1e-7, "{k}: {slope} {}", losses.to_outputs[k]);
            }
            let total = |b: f64| training.losses(&out, b).unwrap().total;
            let slope = (total(0.4 + h) - total(0.4 - h)) / (2.0 * h);
            assert!((slope - losses.to_residual_weight).abs() < 1e-6, "{slope} {}", losses.to_residual_weight);
        }
    }
}
