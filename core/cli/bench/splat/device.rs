//! What a scene is rendered and differentiated on: the CPU, or a GPU where this build has one.

use std::sync::Arc;

use heartian_space::Camera;
use heartian_splat::{
    AdapterReport, Device, Frame, FrameGradient, Gaussians, Gpu, GpuRasteriser, RasterOptions, SceneGradients,
    SplatError, backward, render, simd_level,
};
use miette::{IntoDiagnostic, Result};

/// Renders and differentiates.
pub trait Rasteriser {
    /// What it runs on, for the report.
    fn name(&self) -> String;
    /// The picture of a scene.
    fn forward(&mut self, scene: &Gaussians, view: &View) -> Result<Frame>;
    /// The picture, and the gradients of a loss whose gradient with respect to the picture's planes is given.
    fn both(&mut self, scene: &Gaussians, view: &View, on_planes: &[f32]) -> Result<(Frame, SceneGradients)>;
    /// Mean seconds forward, and forward and backward, with scene, picture and gradients staying where they are computed;
    /// nothing where that is no other than the above.
    fn resident(&self, _: u16) -> Result<Option<[f64; 2]>> {
        Ok(None)
    }
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
    Ok(match Gpu::open(device).into_diagnostic()? {
        None => Box::new(Cpu),
        Some(gpu) => Box::new(OnGpu { raster: GpuRasteriser::new(&gpu), gpu }),
    })
}

/// A GPU: scenes go there and pictures and gradients come back, each time.
struct OnGpu {
    gpu: Arc<Gpu>,
    raster: GpuRasteriser,
}

impl Rasteriser for OnGpu {
    fn name(&self) -> String {
        let AdapterReport { name, backend, kind, .. } = self.gpu.report();
        format!("{name}, {backend}, {kind}, transfers included")
    }

    fn forward(&mut self, scene: &Gaussians, view: &View) -> Result<Frame> {
        self.raster.render(scene, &view.camera, &view.options).into_diagnostic()
    }

    fn both(&mut self, scene: &Gaussians, view: &View, on_planes: &[f32]) -> Result<(Frame, SceneGradients)> {
        let frame = self.forward(scene, view)?;
        let gradient = FrameGradient { planes: on_planes, ..FrameGradient::default() };
        Ok((frame, self.raster.backward(&gradient).into_diagnostic()?))
    }

    fn resident(&self, runs: u16) -> Result<Option<[f64; 2]>> {
        let seconds = |backward| self.raster.resident_seconds(u32::from(runs), backward).into_diagnostic();
        Ok(Some([seconds(false)?, seconds(true)?]))
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
