//! What stands for fits that stay on a device in a program built without it.

use std::sync::Arc;

use heartian_space::Camera;

use super::{Gpu, GpuFitter, GpuPresenter};
use crate::adam::AdamOptions;
use crate::environment::Environment;
use crate::error::SplatError;
use crate::fit::{AdamGroup, FitShape, GpuCall, GpuScene, LightRate, REPORTS, StepReport};

impl GpuFitter {
    /// Steps whose reports are kept.
    pub const REPORTS: usize = REPORTS;

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn reserve(&mut self, _: &FitShape<'_>) -> Result<GpuScene, SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn set_light(&self, _: &Environment, _: [&[f32]; 2]) -> Result<(), SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn light(&self) -> Result<(Environment, [Vec<f32>; 2]), SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn submit(
        &mut self,
        _: usize,
        _: &[&GpuKernels],
        _: &[&GpuKernels],
        _: Option<&LightRate>,
    ) -> Result<(), SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn start_reports(&self) -> Result<GpuReading, SplatError> {
        match *self {}
    }

    /// No step was made.
    pub fn report(_: &[u32], _: usize) -> StepReport {
        StepReport::default()
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn make_room(&mut self, _: usize) -> Result<(), SplatError> {
        match *self {}
    }
}

impl GpuPresenter {
    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn reserve(&mut self, _: usize, _: &Camera, _: &Environment) -> Result<[GpuBuffer; 2], SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn submit_made(&mut self, _: &[&GpuKernels]) -> Result<(), SplatError> {
        match *self {}
    }
}

/// Words on a device; there can be none.
#[derive(Clone, Debug)]
pub enum GpuBuffer {}

impl GpuBuffer {
    /// On a device.
    ///
    /// # Errors
    /// None: there is no such device.
    pub fn new(gpu: &Arc<Gpu>, _: &'static str, _: usize) -> Result<Self, SplatError> {
        match **gpu {}
    }

    /// On a device.
    ///
    /// # Errors
    /// None: there is no such device.
    pub fn constants(gpu: &Arc<Gpu>, _: &[u32]) -> Result<Self, SplatError> {
        match **gpu {}
    }

    /// As the twin's.
    pub fn words(&self) -> usize {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn write(&self, _: usize, _: &[u32]) -> Result<(), SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn write_floats(&self, _: usize, _: &[f32]) -> Result<(), SplatError> {
        match *self {}
    }
}

/// Dispatches; there can be none.
#[derive(Debug)]
pub struct GpuKernels(Arc<Gpu>);

impl GpuKernels {
    /// On a device.
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self(Arc::clone(gpu))
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn add(&mut self, _: &GpuCall<'_>) -> Result<(), SplatError> {
        match *self.0 {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn submit(&self) -> Result<(), SplatError> {
        match *self.0 {}
    }
}

/// Values on their way back; there can be none.
#[derive(Debug)]
pub struct GpuReading(GpuBuffer);

impl GpuReading {
    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn take(self, _: &Gpu) -> Result<Vec<Vec<u32>>, SplatError> {
        match self.0 {}
    }
}

/// Frames on a device; there can be none.
#[derive(Debug)]
pub enum GpuFrames {}

impl GpuFrames {
    /// On a device.
    ///
    /// # Errors
    /// None: there is no such device.
    pub fn new(gpu: &Arc<Gpu>, _: usize, _: usize, _: usize) -> Result<Self, SplatError> {
        match **gpu {}
    }

    /// As the twin's.
    pub fn is_wanted(&self, _: usize) -> bool {
        match *self {}
    }

    /// As the twin's.
    pub fn current(&self) -> &GpuBuffer {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn choose(&mut self, _: usize, _: Option<&[u32]>) -> Result<(), SplatError> {
        match *self {}
    }
}

/// An optimiser on a device; there can be none.
#[derive(Debug)]
pub enum GpuAdam {}

impl GpuAdam {
    /// On a device.
    ///
    /// # Errors
    /// None: there is no such device.
    pub fn new(gpu: &Arc<Gpu>, _: &[AdamGroup], _: AdamOptions) -> Result<Self, SplatError> {
        match **gpu {}
    }

    /// As the twin's.
    pub fn parameters(&self) -> &GpuBuffer {
        match *self {}
    }

    /// As the twin's.
    pub fn gradients(&self) -> &GpuBuffer {
        match *self {}
    }

    /// As the twin's.
    pub fn moments(&self) -> &GpuBuffer {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn set_rates(&self, _: &[(u32, f32)]) -> Result<(), SplatError> {
        match *self {}
    }

    /// As the twin's.
    ///
    /// # Errors
    /// None: there is no such object.
    pub fn record(&self, _: &mut GpuKernels, _: &GpuBuffer) -> Result<(), SplatError> {
        match *self {}
    }
}
