//! Buffers that grow, and are never larger than the device can bind.

use super::device::Gpu;
use crate::error::SplatError;

/// A storage buffer that is made anew when it is too small.
#[derive(Debug)]
pub(crate) struct Store {
    what: &'static str,
    usage: wgpu::BufferUsages,
    buffer: Option<wgpu::Buffer>,
}

impl Store {
    /// Nothing yet; `what` it will hold is for messages.
    pub fn new(what: &'static str) -> Self {
        use wgpu::BufferUsages as U;
        Self { what, usage: U::STORAGE | U::COPY_SRC | U::COPY_DST, buffer: None }
    }

    /// A buffer that dispatches are read from, too.
    pub fn indirect(what: &'static str) -> Self {
        let plain = Self::new(what);
        Self { usage: plain.usage | wgpu::BufferUsages::INDIRECT, ..plain }
    }

    /// Makes room for `words` of four bytes; gives whether the buffer is another than before. What it held is lost then.
    ///
    /// # Errors
    /// When the device cannot bind as much at once.
    pub fn ensure(&mut self, gpu: &Gpu, words: usize) -> Result<bool, SplatError> {
        let bytes = (words as u64).saturating_mul(4).max(256);
        if self.buffer.as_ref().is_some_and(|buffer| buffer.size() >= bytes) {
            return Ok(false);
        }
        let most = gpu.limits.max_storage_buffer_binding_size.min(gpu.limits.max_buffer_size);
        if bytes > most {
            let (mib, limit) = (bytes >> 20, most >> 20);
            return Err(gpu.error(format!(
                "{} would take {mib} MiB, and this device binds at most {limit} MiB at once; take fewer or smaller \
                 Gaussians, a smaller picture, or --device cpu",
                self.what
            )));
        }
        let size = bytes.next_multiple_of(256).min(most);
        let descriptor =
            wgpu::BufferDescriptor { label: Some(self.what), size, usage: self.usage, mapped_at_creation: false };
        self.buffer = Some(gpu.device.create_buffer(&descriptor));
        gpu.check()?;
        Ok(true)
    }

    /// The buffer.
    ///
    /// # Errors
    /// When there is no room yet.
    pub fn get(&self) -> Result<&wgpu::Buffer, SplatError> {
        self.buffer.as_ref().ok_or_else(|| SplatError::Device(format!("{} has no buffer yet; render first", self.what)))
    }
}

/// A small buffer of constants.
pub(crate) fn uniform(gpu: &Gpu, bytes: &[u8]) -> wgpu::Buffer {
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("constants"),
        size: bytes.len() as u64,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    gpu.queue.write_buffer(&buffer, 0, bytes);
    buffer
}
