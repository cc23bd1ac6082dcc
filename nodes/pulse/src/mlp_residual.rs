//! MlpResidual: what the fundamental leaves out, per Gaussian and frame (paper, Methods: f_MLP).

use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_pulse::{Pulse, ResidualOptions, fit_residual};
use heartian_space::{AlbedoOperator, Metrics, Modulation, Skin};

use crate::bound::bound_message;

params! {
    /// Fits the residual network (10 phase harmonics, beat embedding, position encoder, two residual tanh blocks) on top of
    /// a frozen fundamental, and evaluates the modulation of every skin Gaussian at every frame.
    pub struct MlpResidual {
        /// Full-batch steps over all frames; the paper takes 60,000 of one frame each.
        steps: u32 = 300, range(0.0, 200000.0);
        /// Width of the trunk.
        width: usize = 128, range(1.0, 1024.0);
        /// B at the start: how much the residual weighs beside the fundamental.
        weight: f64 = 0.3, range(0.0001, 10.0);
    }
}
register!(MlpResidual);

impl Node for MlpResidual {
    const KIND: &'static str = "MlpResidual";
    const REVISION: u32 = 4;
    const INPUTS: &'static [Port] = &[
        Port::one::<Pulse>("pulse", "The fitted fundamental; it stays as it is."),
        Port::one::<Skin>("skin", "The Gaussians to modulate."),
        Port::one::<AlbedoOperator>("operator", "The frozen renderer; without it the photometric loss is left out.")
            .optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Pulse>("pulse", "The pulse with its network."),
        Port::one::<Modulation>("modulation", "Offsets of green albedo, per Gaussian and frame."),
        Port::one::<Metrics>("metrics", "residual.*: how the full modulation follows the reference."),
    ];

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (pulse, skin) = (inputs.get::<Pulse>("pulse")?, inputs.get::<Skin>("skin")?);
        let operator = inputs.optional::<AlbedoOperator>("operator")?;
        let Self { steps, width, weight, .. } = *self;
        let options =
            ResidualOptions { steps, width, residual_weight: weight, seed: context.seed(), ..Default::default() };
        let watch = &mut |p: heartian_space::Progress| context.progress(p.step, p.total, p.metric);
        let (pulse, modulation) = fit_residual(&pulse, &skin, operator.as_deref().map(|o| o as _), &options, watch)?;
        let metrics = Metrics::new()
            .with("residual.waveform_pearson", pulse.report.full_pearson.unwrap_or(f64::NAN))
            .with("residual.limited_offsets", pulse.report.limited.offsets as f64)
            .with("residual.limited_frames", pulse.report.limited.frames as f64)
            .with("residual.bound_levels", pulse.strength.most_levels);
        if let Some(message) = bound_message(&pulse.report.limited, &pulse) {
            context.warn(&message);
        }
        Ok(Outputs::new().put("pulse", pulse).put("modulation", modulation).put("metrics", metrics))
    }
}
