//! Adam on a device: groups of parameters, their gradients and moments stay there. Twin of [`crate::Adam`].

use std::sync::Arc;

use super::device::Gpu;
use super::kernel::{GpuBuffer, GpuKernels};
use super::params::{AdamStep, MOST_GROUPS};
use super::program::{Call, Groups, Source};
use crate::adam::{AdamOptions, corrected_rates};
use crate::error::{SplatError, expect_length};
use crate::fit::AdamGroup;

/// Groups of parameters, one after another in one buffer, with their gradients and moments, on a device.
#[derive(Debug)]
pub struct GpuAdam {
    gpu: Arc<Gpu>,
    options: AdamOptions,
    groups: Vec<AdamGroup>,
    constants: GpuBuffer,
    parameters: GpuBuffer,
    gradients: GpuBuffer,
    moments: GpuBuffer,
}

impl GpuAdam {
    /// Parameters, gradients and moments of zero.
    ///
    /// # Errors
    /// When there are more than sixteen groups, or the device cannot hold them.
    pub fn new(gpu: &Arc<Gpu>, groups: &[AdamGroup], options: AdamOptions) -> Result<Self, SplatError> {
        if groups.len() > MOST_GROUPS {
            let what = "the groups of parameters";
            return Err(SplatError::Length { what, expected: MOST_GROUPS, found: groups.len() });
        }
        let count = groups.iter().map(|group| group.count).sum();
        Ok(Self {
            gpu: Arc::clone(gpu),
            options,
            groups: groups.to_vec(),
            constants: GpuBuffer::constants(gpu, bytemuck::cast_slice(&[AdamStep::default()]))?,
            parameters: GpuBuffer::new(gpu, "the parameters", count)?,
            gradients: GpuBuffer::new(gpu, "the parameters' gradients", count)?,
            moments: GpuBuffer::new(gpu, "the parameters' moments", 2 * count)?,
        })
    }

    /// The parameters, group after group.
    pub fn parameters(&self) -> &GpuBuffer {
        &self.parameters
    }

    /// Their gradients, which whoever knows them writes before a step.
    pub fn gradients(&self) -> &GpuBuffer {
        &self.gradients
    }

    /// All first moments, then all second ones.
    pub fn moments(&self) -> &GpuBuffer {
        &self.moments
    }

    /// What the next submission's step is: of each group the number of steps taken, this one included, and the rate. A
    /// group of rate 0 is left alone.
    ///
    /// # Errors
    /// When it is not said of every group.
    pub fn set_rates(&self, rates: &[(u32, f32)]) -> Result<(), SplatError> {
        expect_length("the rates", self.groups.len(), rates.len())?;
        let AdamOptions { beta1, beta2, .. } = self.options;
        let (count, groups) = (self.parameters.words() as u32, self.groups.len() as u32);
        let mut step = AdamStep { beta1, beta2, count, groups, ..AdamStep::default() };
        let mut end = 0;
        for (index, (group, (steps, learning_rate))) in self.groups.iter().zip(rates).enumerate() {
            end += group.count;
            step.ends[index] = end as u32;
            if *learning_rate != 0.0 {
                let [rate, guard] = corrected_rates(&self.options, (*steps).max(1), *learning_rate);
                step.rates[index] = [rate, guard, group.range[0], group.range[1]];
            }
        }
        self.constants.write(0, bytemuck::cast_slice(&[step]))
    }

    /// Adds a step down the gradients to `kernels`; it is not made where the first word of `status` is set.
    ///
    /// # Errors
    /// When the device refused it.
    pub fn record(&self, kernels: &mut GpuKernels, status: &GpuBuffer) -> Result<(), SplatError> {
        let of = |buffer: &'_ GpuBuffer| buffer.buffer.clone();
        let buffers = [&self.constants, &self.parameters, &self.gradients, &self.moments, status].map(of);
        let bindings: Vec<(u32, &wgpu::Buffer)> = (0..).zip(&buffers).collect();
        let groups = Groups::Linear(self.parameters.words().div_ceil(256) as u32);
        let call = Call { source: Source::Adam, entry: "descend", bindings: &bindings, groups };
        kernels.recording.add(&self.gpu, 1, &call);
        self.gpu.check()
    }
}
