//! What a scene is rendered and differentiated on: the CPU, or a GPU where this build has one.

use heartian_space::Camera;
use heartian_splat::{
    Device, Frame, FrameGradient, Gaussians, RasterOptions, SceneGradients, SplatError, backward, render, simd_level,
};
use miette::{IntoDiagnostic, Result, miette};

/// Renders and differentiates.
pub trait Rasteriser {
    /// What it runs on, for the report.
    fn name(&self) -> String;
    /// The picture of a scene.
    fn forward(&mut self, scene: &Gaussians, view: &View) -> Result<Frame>;
    /// The picture, and the gradients of a loss whose gradient with respect to the picture's planes is given.
    fn both(&mut self, scene: &Gaussians, view: &View, on_planes: &[f32]) -> Result<(Frame, SceneGradients)>;
}

/// From where and how.
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// How the rasteriser treats the scene.
    pub options: RasterOptions,
}

/// The rasteriser of a device.
///
/// # Errors
/// When there is none.
pub fn rasteriser(device: Device) -> Result<Box<dyn Rasteriser>> {
    match device {
        Device::Auto | Device::Cpu => Ok(Box::new(Cpu)),
        Device::Gpu => Err(miette!(
            help = "leave --device away, or say --device cpu",
            "this build measures no GPU: it has none to rasterise on"
        )),
    }
}

/// The lanes and threads of this machine.
struct Cpu;

impl Rasteriser for Cpu {
    fn name(&self) -> String {
        format!("CPU, {:?}, {} threads", simd_level(), rayon::current_num_threads())
    }

    fn forward(&mut self, scene: &Gaussians, view: &View) -> Result<Frame> {
        render(scene, &view.camera, &view.options).map(|(_, frame)| frame).into_diagnostic()
    }

    fn both(&mut self, scene: &Gaussians, view: &View, on_planes: &[f32]) -> Result<(Frame, SceneGradients)> {
        let both = || -> Result<_, SplatError> {
            let (prepared, frame) = render(scene, &view.camera, &view.options)?;
            let gradient = FrameGradient { planes: on_planes, ..FrameGradient::default() };
            let gradients = backward(scene, &prepared, &frame, &gradient)?;
            Ok((frame, gradients))
        };
        both().into_diagnostic()
    }
}
