//! Stage 2, first half: phase and fundamental waveform against the reference (paper, Optimization), full batch, f64.
//!
//! The gradient separation of the paper: losses on the fundamental train phase and waveform here; the same losses on the
//! full modulation train the network alone (`residual_fit.rs`), with everything of this file frozen.

mod objective;
mod options;
mod warm;

pub use options::{PhaseOptions, PhaseRates, Start};

use std::ops::ControlFlow;

use heartian_space::Progress;

use crate::adam::Adam;
use crate::error::{PulseError, check_length};
use crate::limit::{KNEE, Limited};
use crate::losses::WaveformTarget;
use crate::numeric::mean;
use crate::phase::{Parameterization, Phase};
use crate::pulse::{Pulse, Strength};
use crate::reference::{Reference, WeakPhase};
use crate::render_loss::FrozenRenderer;
use crate::waveform::Waveform;
use objective::{Losses, Objective, Variables};
use warm::warm_waveform;

/// What the fit sees beside the reference: the video's weak phase and the renderer, both optional, and the skin.
#[derive(Clone, Copy, Default)]
pub struct Scene<'a> {
    /// θ_POS of the recording.
    pub weak_phase: Option<&'a WeakPhase>,
    /// The frozen renderer.
    pub renderer: Option<&'a dyn FrozenRenderer>,
    /// Mean green albedo over the skin Gaussians, in (0, 1].
    pub mean_green_albedo: f64,
}

/// How a fit went.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FitReport {
    /// Steps taken.
    pub steps: u64,
    /// L_phase at the end, radians².
    pub phase_loss: f64,
    /// L_pos at the end, radians²; 0 without a weak phase.
    pub pos_loss: f64,
    /// L_mse of the last path fitted.
    pub mse: f64,
    /// Pearson correlation of the fundamental with the reference, after detrending.
    pub fundamental_pearson: f64,
    /// The same of the full modulation, once the residual is fitted.
    pub full_pearson: Option<f64>,
    /// L_base, sRGB units; 0 without a renderer.
    pub base_loss: f64,
    /// Peak-to-peak of the fundamental on the picture, 8-bit levels, mean over the lit skin.
    pub levels: f64,
    /// The same at the pixel and in the frame that answer most.
    pub most_levels: f64,
    /// Where the bound on 8-bit levels acted.
    pub limited: Limited,
}

/// A callback that may stop the work.
pub type Watch<'a> = &'a mut dyn FnMut(Progress) -> ControlFlow<()>;

/// Fits phase, waveform and scale.
///
/// # Errors
/// When inputs disagree in length, a parameter is out of range, or the callback stops the work.
pub fn fit_phase(
    reference: &Reference,
    scene: &Scene<'_>,
    options: &PhaseOptions,
    progress: Watch<'_>,
) -> Result<(Pulse, FitReport), PulseError> {
    options.check()?;
    if !(scene.mean_green_albedo > 0.0 && scene.mean_green_albedo <= 1.0) {
        let (name, value) = ("the skin's mean green albedo", scene.mean_green_albedo);
        return Err(PulseError::Parameter { name, value, range: "(0, 1]; an avatar with black skin cannot pulse" });
    }
    if let Some(weak) = scene.weak_phase {
        check_length("the weak phase", reference.len(), weak.theta.len())?;
    }
    let target = WaveformTarget::new(&reference.waveform, reference.rate_hertz())?;
    let (phase, waveform) = starting_point(reference, &target, options)?;
    let render = scene.renderer.map(|r| r.base_loss(&vec![0; r.gaussians()], 1)).transpose()?;
    let scale = options.amplitude * scene.mean_green_albedo / waveform.peak_to_peak().max(1e-9);
    let objective =
        Objective { reference, target: &target, weak: scene.weak_phase, render: render.as_deref(), options };
    let mut variables = Variables { phase, waveform, scale, log_scale: 0.0 };
    let losses = descend(&objective, &mut variables, progress)?;
    finish(&objective, variables, losses, scene)
}

/// Phase and waveform before the first step.
fn starting_point(
    reference: &Reference,
    target: &WaveformTarget,
    options: &PhaseOptions,
) -> Result<(Phase, Waveform), PulseError> {
    let unwrapped = match options.start {
        Start::Beats => reference.phase.clone(),
        Start::MeanRate => {
            let count = reference.len();
            let increment = (reference.phase[count - 1] - reference.phase[0]) / (count - 1) as f64;
            let line = |t: usize| increment * t as f64;
            // φ₀ that fits best in the circular mean.
            let (mut sin, mut cos) = (0.0, 0.0);
            for (t, phase) in reference.phase.iter().enumerate() {
                sin += (phase - line(t)).sin();
                cos += (phase - line(t)).cos();
            }
            let first = sin.atan2(cos);
            (0..count).map(|t| first + line(t)).collect()
        }
    };
    let phase = Phase::following_at(options.parameterization, &reference.times_seconds, &unwrapped);
    let waveform = match options.start {
        Start::MeanRate => Waveform::default(),
        Start::Beats => warm_waveform(reference, target.values(), &options.penalties),
    };
    Ok((phase, waveform))
}

/// Adam over all groups with the paper's rates; the decays are laid onto the number of steps taken.
fn descend(objective: &Objective<'_>, variables: &mut Variables, progress: Watch<'_>) -> Result<Losses, PulseError> {
    let options = objective.options;
    let steps = options.steps_for(variables.phase.len());
    let mut increments = Adam::new(variables.phase.raw.len());
    let (mut initial, mut shape, mut scale) = (Adam::new(1), Adam::new(6), Adam::new(1));
    // Adam's first steps move every increment by the full rate; over T frames that adds up to T times as much phase.
    let calm = match options.parameterization {
        Parameterization::Cumulative => (options.calm_frames / variables.phase.len() as f64).min(1.0),
        Parameterization::Direct | Parameterization::Anchored => 1.0,
    };
    for step in 0..steps {
        let (losses, gradient) = objective.evaluate(variables)?;
        let at = f64::from(step) / f64::from(steps.max(1));
        let rates = options.rates.at(at);
        increments.step(&mut variables.phase.raw, &gradient.phase.raw, |_| rates.increments * calm);
        if options.parameterization == Parameterization::Cumulative {
            let mut first = [variables.phase.initial];
            initial.step(&mut first, &[gradient.phase.initial], |_| rates.initial);
            variables.phase.initial = first[0];
        }
        variables.phase.project();
        let mut parameters = variables.waveform.to_array();
        shape.step(&mut parameters, &gradient.waveform.to_array(), |k| rates.waveform[k]);
        variables.waveform = Waveform::from_array(parameters);
        let mut log_scale = [variables.log_scale];
        scale.step(&mut log_scale, &[gradient.log_scale], |_| rates.scale);
        variables.log_scale = log_scale[0].clamp(options.scale_range[0].ln(), options.scale_range[1].ln());
        if step % 100 == 0 || step + 1 == steps {
            let metric = Some(("waveform_pearson", 1.0 - losses.pearson));
            let report = Progress { step: u64::from(step + 1), total: u64::from(steps), metric };
            if progress(report).is_break() {
                return Err(PulseError::Cancelled);
            }
        }
    }
    Ok(objective.evaluate(variables)?.0)
}

/// Bounds the strength and takes stock.
fn finish(
    objective: &Objective<'_>,
    variables: Variables,
    losses: Losses,
    scene: &Scene<'_>,
) -> Result<(Pulse, FitReport), PulseError> {
    let (options, reference) = (objective.options, objective.reference);
    let Variables { phase, waveform, scale, log_scale } = variables;
    let theta = phase.theta();
    let mut shape = waveform.evaluate(&theta);
    reference.envelope.apply(&mut shape);
    let extent =
        shape.iter().copied().fold(f64::NEG_INFINITY, f64::max) - shape.iter().copied().fold(f64::INFINITY, f64::min);
    let wanted = options.amplitude * scene.mean_green_albedo;
    // Amplitudes and A share one degree of freedom; floor and ceiling hold for their product.
    let [floor, ceiling] = options.scale_range.map(|factor| factor * wanted);
    let per_albedo = scene.renderer.and_then(FrozenRenderer::levels_per_albedo).unwrap_or_else(|| {
        // Albedo seen under unit irradiance.
        255.0 * f64::from(heartian_space::color::srgb_from_linear_derivative(scene.mean_green_albedo as f32))
    });
    let frames = scene.renderer.and_then(|renderer| renderer.most_levels_per_albedo(reference.len()));
    let most_levels_per_albedo = frames.unwrap_or_else(|| vec![per_albedo; reference.len()]);
    let level = if options.centred { mean(&shape) } else { 0.0 };
    // How far each frame is from the level, where a beat stands farther out on one side, against where its bound begins
    // to bend; the prescribed beat stays below everywhere.
    let farthest = shape
        .iter()
        .zip(&most_levels_per_albedo)
        .fold(0.0f64, |most, (value, levels)| most.max((value - level).abs() * levels));
    let unbent = 0.5 * KNEE * options.most_levels * extent / farthest.max(1e-9);
    let strength = (scale * log_scale.exp() * extent).clamp(floor, ceiling).min(unbent);
    let scale = strength / extent.max(1e-9);
    let report = FitReport {
        steps: u64::from(options.steps_for(reference.len())),
        phase_loss: losses.phase,
        pos_loss: losses.pos,
        mse: losses.mse,
        fundamental_pearson: objective.target.correlation(&shape)?,
        full_pearson: None,
        base_loss: losses.base,
        levels: strength * per_albedo,
        most_levels: strength * most_levels_per_albedo.iter().copied().fold(0.0, f64::max),
        limited: Limited::default(),
    };
    let pulse = Pulse {
        times_seconds: reference.times_seconds.clone(),
        theta,
        beat: reference.beat.clone(),
        fundamental: shape.iter().map(|value| scale * (value - level)).collect(),
        reference: reference.waveform.clone(),
        most_levels_per_albedo,
        phase,
        waveform,
        strength: Strength {
            scale,
            level,
            residual_weight: 0.0,
            levels_per_albedo: per_albedo,
            most_levels: options.most_levels,
        },
        residual: None,
        reference_bpm: reference.mean_bpm,
        report,
    };
    Ok((pulse, report))
}
