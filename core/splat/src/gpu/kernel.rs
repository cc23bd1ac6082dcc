//! What other crates bring to a device: buffers of words, kernels in WGSL of their own, lists of dispatches, and values
//! read back some time later. The texts see `common.wgsl`; this crate knows nothing of what they compute.

use std::num::NonZeroU64;
use std::sync::Arc;

use super::arena::{Store, uniform};
use super::device::Gpu;
use super::program::{Call, Groups, Recording, Source};
use crate::error::SplatError;
use crate::fit::GpuCall;

/// Words of four bytes on a device, shared by the kernels that are given it. A clone is the same buffer.
#[derive(Clone, Debug)]
pub struct GpuBuffer {
    gpu: Arc<Gpu>,
    pub(super) buffer: wgpu::Buffer,
    words: usize,
}

impl GpuBuffer {
    /// `words` zeros, which kernels read and write; `what` they are is for messages.
    ///
    /// # Errors
    /// When the device cannot bind as much at once.
    pub fn new(gpu: &Arc<Gpu>, what: &'static str, words: usize) -> Result<Self, SplatError> {
        let mut store = Store::new(what);
        store.ensure(gpu, words)?;
        Self::of(gpu, &store, words)
    }

    /// Constants of kernels (`var<uniform>`), of which there are few.
    ///
    /// # Errors
    /// When the device failed.
    pub fn constants(gpu: &Arc<Gpu>, values: &[u32]) -> Result<Self, SplatError> {
        let buffer = uniform(gpu, bytemuck::cast_slice(values));
        gpu.check()?;
        Ok(Self { gpu: Arc::clone(gpu), buffer, words: values.len() })
    }

    /// What a store holds now; another buffer once that has grown.
    pub(super) fn of(gpu: &Arc<Gpu>, store: &Store, words: usize) -> Result<Self, SplatError> {
        Ok(Self { gpu: Arc::clone(gpu), buffer: store.get()?.clone(), words })
    }

    /// Number of words.
    pub fn words(&self) -> usize {
        self.words
    }

    /// Sets words from number `at` on, before whatever is submitted next.
    ///
    /// # Errors
    /// When they lie outside the buffer.
    pub fn write(&self, at: usize, words: &[u32]) -> Result<(), SplatError> {
        if at + words.len() > self.words {
            let (found, expected) = (at + words.len(), self.words);
            return Err(SplatError::Length { what: "the words of a buffer", expected, found });
        }
        self.gpu.queue.write_buffer(&self.buffer, 4 * at as u64, bytemuck::cast_slice(words));
        Ok(())
    }

    /// The same for floats.
    ///
    /// # Errors
    /// As [`GpuBuffer::write`].
    pub fn write_floats(&self, at: usize, values: &[f32]) -> Result<(), SplatError> {
        self.write(at, bytemuck::cast_slice(values))
    }
}

/// Dispatches that are made one after another, recorded once and replayed every step.
#[derive(Debug)]
pub struct GpuKernels {
    gpu: Arc<Gpu>,
    pub(super) recording: Recording,
}

impl GpuKernels {
    /// None yet.
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { gpu: Arc::clone(gpu), recording: Recording::default() }
    }

    /// Adds a dispatch.
    ///
    /// # Errors
    /// When the device refused it.
    pub fn add(&mut self, call: &GpuCall<'_>) -> Result<(), SplatError> {
        let bindings: Vec<(u32, &wgpu::Buffer)> = call.bindings.iter().map(|(at, b)| (*at, &b.buffer)).collect();
        let groups = Groups::Linear(call.workgroups as u32);
        let call = Call { source: Source::Other(call.text), entry: call.entry, bindings: &bindings, groups };
        self.recording.add(&self.gpu, 1, &call);
        self.gpu.check()
    }

    /// Makes them once, without waiting.
    ///
    /// # Errors
    /// When the device failed.
    pub fn submit(&self) -> Result<(), SplatError> {
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.recording.replay(&mut encoder, None);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.check()
    }
}

/// Values on their way back from a device.
#[derive(Debug)]
pub struct GpuReading {
    submission: wgpu::SubmissionIndex,
    staged: Vec<Option<wgpu::Buffer>>,
}

impl GpuReading {
    /// The buffers' words; waits for them and for nothing that was submitted later.
    ///
    /// # Errors
    /// When the device failed.
    pub fn take(self, gpu: &Gpu) -> Result<Vec<Vec<u32>>, SplatError> {
        gpu.wait_for(self.submission)?;
        let words = |staging: &Option<wgpu::Buffer>| {
            let Some(staging) = staging else { return Ok(Vec::new()) };
            let range = staging.get_mapped_range(..);
            let range = range.map_err(|e| gpu.error(format!("nothing can be read back: {e}")))?;
            Ok(bytemuck::pod_collect_to_vec(&range))
        };
        self.staged.iter().map(words).collect()
    }
}

impl Gpu {
    /// Starts to bring buffers back as what was submitted so far leaves them; does not wait.
    pub fn start_reading(&self, buffers: &[&GpuBuffer]) -> GpuReading {
        let parts: Vec<(&wgpu::Buffer, u64)> = buffers.iter().map(|b| (&b.buffer, 4 * b.words as u64)).collect();
        self.stage(&parts)
    }

    /// The first so many bytes of buffers that the device computed, in words; waits for them.
    ///
    /// # Errors
    /// When the device failed.
    pub(super) fn read(&self, parts: &[(&wgpu::Buffer, u64)]) -> Result<Vec<Vec<u32>>, SplatError> {
        self.stage(parts).take(self)
    }

    pub(super) fn stage(&self, parts: &[(&wgpu::Buffer, u64)]) -> GpuReading {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let staged: Vec<Option<wgpu::Buffer>> = parts
            .iter()
            .map(|(buffer, bytes)| {
                let size = NonZeroU64::new(*bytes)?;
                let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("read back"),
                    size: size.get(),
                    usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                });
                encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, size.get());
                Some(staging)
            })
            .collect();
        let submission = self.queue.submit([encoder.finish()]);
        for staging in staged.iter().flatten() {
            // What goes wrong here shows when the range is asked for.
            staging.map_async(wgpu::MapMode::Read, .., |_| ());
        }
        GpuReading { submission, staged }
    }
}
