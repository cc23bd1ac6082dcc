//! What stands for the GPU twin in a program built without it (`--no-default-features`): there is no device, and who
//! asks for one is told so.

mod resident;

use std::sync::Arc;

use heartian_space::Camera;

use crate::device::{AdapterReport, Device};
use crate::environment::Environment;
use crate::error::SplatError;
use crate::fit::{FitStep, FitTarget};
use crate::gaussians::{Gaussians, SceneGradients};
use crate::project::RasterOptions;
use crate::render::{Frame, FrameGradient};

pub use resident::{GpuAdam, GpuBuffer, GpuFrames, GpuKernels, GpuReading};

/// No adapters.
pub fn adapters() -> Vec<AdapterReport> {
    Vec::new()
}

/// A device; there can be none.
#[derive(Debug)]
pub enum Gpu {}

impl Gpu {
    /// Nothing, as where a machine has no GPU.
    ///
    /// # Errors
    /// When a GPU is asked for.
    pub fn open(device: Device) -> Result<Option<Arc<Self>>, SplatError> {
        match device {
            Device::Auto | Device::Cpu => Ok(None),
            Device::Gpu => Err(SplatError::Device(
                "this program was built without GPU support; build it with `--features gpu`, or run with --device cpu"
                    .to_owned(),
            )),
        }
    }

    /// Nothing: all is computed on the CPU.
    pub fn numerics(_: Device) -> Option<String> {
        None
    }

    /// What this is.
    pub fn report(&self) -> &AdapterReport {
        match *self {}
    }

    /// As the twin's.
    pub fn start_reading(&self, _: &[&GpuBuffer]) -> GpuReading {
        match *self {}
    }
}

/// A rasteriser on a device; there can be none.
#[derive(Debug)]
pub struct GpuRasteriser(Arc<Gpu>);

impl GpuRasteriser {
    /// On a device.
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self(Arc::clone(gpu))
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn render(&mut self, _: &Gaussians, _: &Camera, _: &RasterOptions) -> Result<Frame, SplatError> {
        match *self.0 {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn resident_seconds(&self, _: u32, _: bool) -> Result<f64, SplatError> {
        match *self.0 {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn backward(&mut self, _: &FrameGradient) -> Result<SceneGradients, SplatError> {
        match *self.0 {}
    }
}

/// Frames on a device; there can be none.
#[derive(Debug)]
pub enum GpuPresenter {}

impl GpuPresenter {
    /// Frames that should be in flight before one is collected.
    pub const AHEAD: usize = 2;

    /// On a device.
    ///
    /// # Errors
    /// None: there is no such device.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, SplatError> {
        match **gpu {}
    }

    /// Frames submitted and not collected.
    pub fn in_flight(&self) -> usize {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn submit(&mut self, _: &Gaussians, _: &Camera, _: &Environment) -> Result<(), SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn collect(&mut self) -> Result<Option<Vec<u8>>, SplatError> {
        match *self {}
    }
}

/// Steps of a fit on a device; there can be none.
#[derive(Debug)]
pub enum GpuFitter {}

impl GpuFitter {
    /// On a device.
    ///
    /// # Errors
    /// None: there is no such device.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, SplatError> {
        match **gpu {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn step(
        &mut self,
        _: &Gaussians,
        _: &Camera,
        _: Option<&Environment>,
        _: &FitTarget<'_>,
    ) -> Result<FitStep, SplatError> {
        match *self {}
    }
}
