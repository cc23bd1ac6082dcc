//! Renderer: the avatar on its track, with and without the heartbeat.

use heartian_avatar::{Avatar, RenderOptions, Score, evaluate, render_clip};
use heartian_face::Track;
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, Resources, params, register};
use heartian_space::{Clip, Metrics, Modulation};
use heartian_splat::{Device, Gpu};

use crate::hosted::open_gpu;

params! {
    /// Renders the avatar on a track under the recording's light: the unmodulated baseline and, with a modulation, the
    /// avatar that carries the pulse; scores both against the recording's held-out frames.
    pub struct Renderer {
        /// What to render on: the CPU, a GPU, or `Auto` for a GPU where there is a real one. A GPU's frames are the CPU's
        /// within a code or so, and are cached apart from them.
        device: Device = Device::Cpu, choices(&["Auto", "Cpu", "Gpu"]), unkeyed();
    }
}
register!(Renderer);

impl Node for Renderer {
    const KIND: &'static str = "Renderer";
    const REVISION: u32 = 3;
    const INPUTS: &'static [Port] = &[
        Port::one::<Avatar>("avatar", "What to render."),
        Port::one::<Track>("track", "How it moves."),
        Port::one::<Modulation>("modulation", "Offsets of green albedo, frame by frame."),
        Port::one::<Clip>("clip", "The recording to score against.").optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Clip>("baseline", "Without the pulse, labelled `baseline_rendered`."),
        Port::one::<Clip>("modulated", "With the pulse, labelled `rendered`."),
        Port::one::<Metrics>("metrics", "baseline.* and modulated.*: PSNR and SSIM over the held-out frames."),
    ];

    fn numerics(&self) -> Option<String> {
        Gpu::numerics(self.device)
    }

    fn resources(&self) -> Resources {
        Resources { gpu: self.device != Device::Cpu, ..Resources::default() }
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (avatar, track) = (inputs.get::<Avatar>("avatar")?, inputs.get::<Track>("track")?);
        let modulation = inputs.get::<Modulation>("modulation")?;
        let gpu = open_gpu(self.device)?;
        let render = |label, modulation| {
            let options = RenderOptions { label, modulation, gpu: gpu.as_ref(), ..Default::default() };
            render_clip(&avatar, &track, &options)
        };
        let baseline = render("baseline_rendered", None)?;
        if context.progress(1, 2, None).is_break() {
            return Err(NodeError::cancelled());
        }
        let modulated = render("rendered", Some(&modulation))?;
        let mut metrics = Metrics::new();
        if let Some(recording) = inputs.optional::<Clip>("clip")? {
            let frames: Vec<usize> = (avatar.training_frames..recording.len()).collect();
            for (name, clip) in [("baseline", &baseline), ("modulated", &modulated)] {
                let Score { psnr_db, ssim } = evaluate(clip, &recording, &frames)?;
                metrics = metrics.with(&format!("{name}.psnr_db"), psnr_db).with(&format!("{name}.ssim"), ssim);
            }
        }
        Ok(Outputs::new().put("baseline", baseline).put("modulated", modulated).put("metrics", metrics))
    }
}
