//! A fit that stays on the device: the caller's kernels make the scene, this crate's give its gradients, the caller's go
//! on from there; nothing is waited for.
//!
//! Every step writes a short report into its slot. When a step's entries have no room, it and all steps behind it change
//! nothing (`status` is set, and every kernel that changes something looks at it): whoever reads the reports later calls
//! [`GpuFitter::make_room`] and submits them again, so that what comes of a fit does not depend on when that was seen.

use super::fit::{GpuFitter, REPORT_WORDS};
use super::kernel::{GpuBuffer, GpuKernels, GpuReading};
use crate::environment::Environment;
use crate::error::SplatError;
use crate::fit::{FitShape, GpuScene, LightRate, REPORTS, StepReport};
use crate::project::RasterOptions;
use crate::render::check_camera;
use crate::shade::DEFERRED_CHANNELS;

impl GpuFitter {
    /// Steps whose reports are kept.
    pub const REPORTS: usize = REPORTS;

    /// Makes room for a scene that stays; gives the buffers that it is made in, which hold nothing of use yet. They are
    /// others after every call.
    ///
    /// # Errors
    /// When the camera is unusable, or the device cannot hold the scene.
    pub fn reserve(&mut self, shape: &FitShape<'_>) -> Result<GpuScene, SplatError> {
        let (camera, pixels) = (shape.camera, shape.camera.width * shape.camera.height);
        check_camera(camera)?;
        let features = if shape.is_lit { DEFERRED_CHANNELS } else { 3 };
        let changed = self.raster.reserve([shape.count, features], camera, &RasterOptions::default(), shape.room)?;
        self.ready(camera, features, changed)?;
        self.set_weights(pixels, shape.weights, shape.mask_weight);
        let of = |store, words| GpuBuffer::of(&self.gpu, store, words);
        let [geometry, features, on_geometry, on_features] = self.raster.scene().map(|(store, n)| of(store, n));
        Ok(GpuScene {
            geometry: geometry?,
            features: features?,
            on_geometry: on_geometry?,
            on_features: on_features?,
            wanted: of(&self.buffers.wanted, 4 * pixels)?,
            status: of(&self.buffers.status, 1)?,
        })
    }

    /// Sets the light and its moments (first and second, 75 each).
    ///
    /// # Errors
    /// When lengths do not fit.
    pub fn set_light(&self, environment: &Environment, moments: [&[f32]; 2]) -> Result<(), SplatError> {
        self.lighting.set(&self.gpu, environment)?;
        self.lighting.set_moments(&self.gpu, moments)
    }

    /// The light and its moments; waits for them.
    ///
    /// # Errors
    /// When the device failed.
    pub fn light(&self) -> Result<(Environment, [Vec<f32>; 2]), SplatError> {
        self.lighting.fetch(&self.gpu)
    }

    /// One step: the kernels of `before` make the scene and its target, those of `after` use its gradients; the light
    /// moves by `light`. Returns without waiting; the report comes into `slot`.
    ///
    /// # Errors
    /// When nothing was reserved, or the device failed.
    pub fn submit(
        &mut self,
        slot: usize,
        before: &[&GpuKernels],
        after: &[&GpuKernels],
        light: Option<&LightRate>,
    ) -> Result<(), SplatError> {
        let queue = &self.gpu.queue;
        queue.write_buffer(&self.weights, 12, bytemuck::bytes_of(&((slot % Self::REPORTS) as u32)));
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        before.iter().for_each(|kernels| kernels.recording.replay(&mut encoder, None));
        self.encode(&mut encoder)?;
        if let Some(rate) = light {
            self.lighting.set_rate(&self.gpu, rate);
            self.light_step.replay(&mut encoder, None);
        }
        after.iter().for_each(|kernels| kernels.recording.replay(&mut encoder, None));
        queue.submit([encoder.finish()]);
        self.gpu.check()
    }

    /// Starts to bring back the reports of all steps submitted so far.
    ///
    /// # Errors
    /// When nothing was reserved.
    pub fn start_reports(&self) -> Result<GpuReading, SplatError> {
        let words = REPORT_WORDS * Self::REPORTS;
        Ok(self.gpu.start_reading(&[&GpuBuffer::of(&self.gpu, &self.buffers.reports, words)?]))
    }

    /// The report in a slot of what [`GpuFitter::start_reports`] brought back.
    pub fn report(words: &[u32], slot: usize) -> StepReport {
        let at = REPORT_WORDS * (slot % Self::REPORTS);
        let [_, squared, _, _, wanted, stopped, ..] = words.get(at..at + REPORT_WORDS).unwrap_or(&[0; REPORT_WORDS])
        else {
            return StepReport::default();
        };
        StepReport {
            squared_error: f64::from(f32::from_bits(*squared)) / 3.0,
            entries: *wanted as usize,
            is_stopped: *stopped != 0,
        }
    }

    /// After a stop: lets updates happen again, with room for `entries`. The scene's buffers must be reserved anew.
    ///
    /// # Errors
    /// When nothing was reserved.
    pub fn make_room(&mut self, entries: usize) -> Result<(), SplatError> {
        self.raster.make_room(entries);
        self.gpu.queue.write_buffer(self.buffers.status.get()?, 0, bytemuck::bytes_of(&0u32));
        Ok(())
    }
}
