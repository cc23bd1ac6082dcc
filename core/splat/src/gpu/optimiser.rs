//! Adam on a device: parameters, gradients and moments stay there. Twin of [`crate::Adam`].

use std::sync::Arc;

use super::arena::{Store, uniform};
use super::device::Gpu;
use super::params::AdamStep;
use super::program::{Call, Groups, Recording, Source};
use crate::adam::{AdamOptions, corrected_rates};
use crate::error::{SplatError, expect_length};

/// Parameters of one group with their moments, on a device.
#[derive(Debug)]
pub struct GpuAdam {
    gpu: Arc<Gpu>,
    options: AdamOptions,
    /// Values are held here after each step.
    range: [f32; 2],
    count: usize,
    steps: u32,
    constants: wgpu::Buffer,
    parameters: Store,
    gradients: Store,
    moments: Store,
    recording: Recording,
}

impl GpuAdam {
    /// Moments of zero for `parameters`, whose values are held in `range` after each step.
    ///
    /// # Errors
    /// When the device cannot hold them.
    pub fn new(gpu: &Arc<Gpu>, parameters: &[f32], range: [f32; 2], options: AdamOptions) -> Result<Self, SplatError> {
        let mut own = Self {
            gpu: Arc::clone(gpu),
            options,
            range,
            count: parameters.len(),
            steps: 0,
            constants: uniform(gpu, bytemuck::bytes_of(&AdamStep::default())),
            parameters: Store::new("the parameters"),
            gradients: Store::new("the parameters' gradients"),
            moments: Store::new("the parameters' moments"),
            recording: Recording::default(),
        };
        own.parameters.ensure(gpu, own.count)?;
        own.gradients.ensure(gpu, own.count)?;
        own.moments.ensure(gpu, 2 * own.count)?;
        gpu.queue.write_buffer(own.parameters.get()?, 0, bytemuck::cast_slice(parameters));
        let bindings =
            [(0, &own.constants), (1, own.parameters.get()?), (2, own.gradients.get()?), (3, own.moments.get()?)];
        let groups = Groups::Linear(own.count.div_ceil(256) as u32);
        own.recording.add(gpu, 1, &Call { source: Source::Adam, entry: "descend", bindings: &bindings, groups });
        gpu.check()?;
        Ok(own)
    }

    /// One descent step; returns without waiting for the device.
    ///
    /// # Errors
    /// When the lengths differ or the device failed.
    pub fn step(&mut self, gradients: &[f32], learning_rate: f32) -> Result<(), SplatError> {
        expect_length("the gradients", self.count, gradients.len())?;
        self.steps = self.steps.saturating_add(1);
        let [rate, guard] = corrected_rates(&self.options, self.steps, learning_rate);
        let AdamOptions { beta1, beta2, .. } = self.options;
        let [low, high] = self.range;
        let step = AdamStep { beta1, beta2, rate, guard, low, high, count: self.count as u32, spare: 0 };
        let queue = &self.gpu.queue;
        queue.write_buffer(&self.constants, 0, bytemuck::bytes_of(&step));
        queue.write_buffer(self.gradients.get()?, 0, bytemuck::cast_slice(gradients));
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        // No dispatch of this list is sized by the device.
        self.recording.replay(&mut encoder, self.parameters.get()?);
        queue.submit([encoder.finish()]);
        self.gpu.check()
    }

    /// The parameters now; waits for them.
    ///
    /// # Errors
    /// When the device failed.
    pub fn parameters(&self) -> Result<Vec<f32>, SplatError> {
        let parts = self.gpu.read(&[(self.parameters.get()?, 4 * self.count as u64)])?;
        Ok(bytemuck::cast_slice(&parts[0]).to_vec())
    }
}
