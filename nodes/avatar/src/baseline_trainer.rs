//! BaselineTrainer: stage 1, a relightable avatar of Gaussians on the tracked head (after HRAvatar).

use heartian_avatar::{Avatar, TrainOptions, state_bytes_per_gaussian, train};
use heartian_face::Track;
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, Resources, params, register};
use heartian_space::{Clip, Metrics};
use heartian_splat::{Device, Gpu};

use crate::hosted::Hosted;

params! {
    /// Fits Gaussians with albedo, roughness, reflectance and normals, their motion with the head, and the light, to the
    /// frames of a tracked clip: L1 + D-SSIM + matte, deferred shading, Adam. The end of the clip is held out.
    pub struct BaselineTrainer {
        /// Most Gaussians.
        gaussians: usize = TrainOptions::default().gaussians, range(100.0, 200000.0);
        /// Steps of one frame each, at most; the fit stops earlier when it gains no more.
        steps: u32 = TrainOptions::default().steps, range(1.0, 1000000.0);
        /// Most expression modes kept, strongest first.
        expression_modes: usize = TrainOptions::default().expression_modes, range(0.0, 64.0);
        /// Share of the clip at its end that is never trained on.
        held_out: f64 = TrainOptions::default().held_out, range(0.0, 0.5);
        /// What makes the pictures and their gradients: the CPU, a GPU, or `Auto` for a GPU where there is a real one. What
        /// is fitted on a GPU is cached apart.
        device: Device = Device::Cpu, choices(&["Auto", "Cpu", "Gpu"]), unkeyed();
    }
}
register!(BaselineTrainer);

impl Node for BaselineTrainer {
    const KIND: &'static str = "BaselineTrainer";
    const REVISION: u32 = 4;
    const INPUTS: &'static [Port] =
        &[Port::one::<Clip>("clip", "The recording."), Port::one::<Track>("track", "The head tracked through it.")];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Avatar>("avatar", "Gaussians, their motion, the light, and the refined poses."),
        Port::one::<Metrics>("metrics", "avatar.*: size and fit."),
    ];

    fn numerics(&self) -> Option<String> {
        Gpu::numerics(self.device)
    }

    fn resources(&self) -> Resources {
        Resources { gpu: self.device != Device::Cpu, ..Resources::default() }
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (clip, track) = (inputs.get::<Clip>("clip")?, inputs.get::<Track>("track")?);
        let Self { gaussians, steps, expression_modes, held_out, device } = *self;
        let seed = context.seed();
        let options =
            TrainOptions { gaussians, steps, seed, expression_modes, held_out, device, ..TrainOptions::default() };
        let (avatar, report) = train(&clip, &track, &options, &mut Hosted(context))?;
        let metrics = Metrics::new()
            .with("avatar.gaussians", report.gaussians as f64)
            .with("avatar.steps", f64::from(report.steps))
            .with("avatar.motion_modes", report.modes as f64)
            .with("avatar.motion_drivers", report.drivers as f64)
            .with("avatar.state_bytes_per_gaussian", state_bytes_per_gaussian(report.modes) as f64)
            .with("avatar.training_psnr_db", report.training.psnr_db)
            .with("avatar.training_ssim", report.training.ssim);
        Ok(Outputs::new().put("avatar", avatar).put("metrics", metrics))
    }
}
