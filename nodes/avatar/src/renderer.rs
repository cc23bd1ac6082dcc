//! Renderer: the avatar on its track, with and without the heartbeat.

use heartian_avatar::{Avatar, RenderOptions, Score, evaluate, render_clip};
use heartian_face::Track;
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_space::{Clip, Metrics, Modulation};

params! {
    /// Renders the avatar on a track under the recording's light: the unmodulated baseline and, with a modulation, the
    /// avatar that carries the pulse; scores both against the recording's held-out frames.
    pub struct Renderer {
    }
}
register!(Renderer);

impl Node for Renderer {
    const KIND: &'static str = "Renderer";
    const REVISION: u32 = 2;
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

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (avatar, track) = (inputs.get::<Avatar>("avatar")?, inputs.get::<Track>("track")?);
        let modulation = inputs.get::<Modulation>("modulation")?;
        let render = |label, modulation| {
            render_clip(&avatar, &track, &RenderOptions { label, modulation, ..Default::default() })
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
