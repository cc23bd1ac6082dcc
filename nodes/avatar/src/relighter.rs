//! Relighter: the avatar under a light it was never recorded in.

use std::path::Path;

use heartian_avatar::{Avatar, RenderOptions, render_clip};
use heartian_face::Track;
use heartian_graph::{
    Context, Inputs, Node, NodeError, Outputs, ParamError, Port, Resources, SourceFile, params, register,
};
use heartian_space::color::luminance;
use heartian_space::{Clip, Modulation};
use heartian_splat::{Device, Environment, Gpu, light_from_file};

use crate::hosted::open_gpu;

/// Lights that need no file, with their linear colour before it is scaled to unit luminance.
const EVEN_LIGHTS: [(&str, [f32; 3]); 3] =
    [("white", [1.0; 3]), ("warm", [1.0, 0.71, 0.42]), ("cool", [0.80, 0.90, 1.0])];

params! {
    /// Renders the avatar on a track under another light.
    pub struct Relighter {
        /// `white`, `warm` (about 3000 K) or `cool` (about 9000 K), each from everywhere and of equal luminance; or a
        /// latitude–longitude map, `.hdr` or `.exr`.
        light: String = "white".to_owned();
        /// Luminance of a white surface under the light, relative to full white.
        exposure: f32 = 1.0, range(0.001, 1000.0);
        /// Turn of the light about the vertical.
        turn_degrees: f64 = 0.0, unit("°"), range(-360.0, 360.0);
        /// What to render on: the CPU, a GPU, or `Auto` for a GPU where there is a real one.
        device: Device = Device::Cpu, choices(&["Auto", "Cpu", "Gpu"]), unkeyed();
    }
}
register!(Relighter);

impl Node for Relighter {
    const KIND: &'static str = "Relighter";
    const REVISION: u32 = 3;
    const INPUTS: &'static [Port] = &[
        Port::one::<Avatar>("avatar", "What to render."),
        Port::one::<Track>("track", "How it moves."),
        Port::one::<Modulation>("modulation", "Offsets of green albedo, frame by frame.").optional(),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one::<Clip>("modulated", "The relit clip, labelled `relit`.")];

    fn sources(&self) -> Vec<SourceFile> {
        let remedy = "give white, warm, cool, or an .hdr or .exr map";
        let file = self.is_file().then(|| SourceFile::new("light", &self.light).remedy(remedy));
        file.into_iter().collect()
    }

    fn validate(&self) -> Vec<ParamError> {
        let known = EVEN_LIGHTS.iter().any(|(name, _)| *name == self.light) || self.is_file();
        let message = format!("`{}` is no light; give white, warm, cool, or an .hdr or .exr map", self.light);
        (!known).then(|| ParamError::new("light", message)).into_iter().collect()
    }

    fn numerics(&self) -> Option<String> {
        Gpu::numerics(self.device)
    }

    fn resources(&self) -> Resources {
        Resources { gpu: self.device != Device::Cpu, ..Resources::default() }
    }

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let (avatar, track) = (inputs.get::<Avatar>("avatar")?, inputs.get::<Track>("track")?);
        let modulation = inputs.optional::<Modulation>("modulation")?;
        let environment = self.environment()?.with_mean_luminance(self.exposure).turned(self.turn_degrees.to_radians());
        let gpu = open_gpu(self.device)?;
        let options = RenderOptions {
            label: "relit",
            gpu: gpu.as_ref(),
            environment: Some(&environment),
            modulation: modulation.as_deref(),
            ..RenderOptions::default()
        };
        Ok(Outputs::new().put("modulated", render_clip(&avatar, &track, &options)?))
    }
}

impl Relighter {
    fn is_file(&self) -> bool {
        let extension = Path::new(&self.light).extension().and_then(|extension| extension.to_str());
        extension.is_some_and(|extension| ["hdr", "exr"].contains(&extension.to_ascii_lowercase().as_str()))
    }

    fn environment(&self) -> Result<Environment, NodeError> {
        match EVEN_LIGHTS.iter().find(|(name, _)| *name == self.light) {
            Some((_, color)) => Ok(Environment::uniform(color.map(|channel| channel / luminance(*color)))),
            None => light_from_file(Path::new(&self.light))
                .and_then(|image| Environment::from_equirectangular(&image))
                .map_err(|error| NodeError::from(error).parameter("light")),
        }
    }
}
