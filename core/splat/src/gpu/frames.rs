//! A recording's frames on a device: as many as a budget allows stay there, the others are sent again each time.
//!
//! What a frame's words mean is the caller's. Frames lie in shelves, since a device binds and allocates only so much at
//! once; a step copies its frame to one place, from where kernels read it.

use std::sync::Arc;

use super::device::Gpu;
use super::kernel::GpuBuffer;
use crate::error::{SplatError, expect_length};

/// Most bytes of a shelf; a frame larger than this has one of its own.
const SHELF_BYTES: usize = 128 << 20;

/// Frames of equal size on a device.
#[derive(Debug)]
pub struct GpuFrames {
    gpu: Arc<Gpu>,
    words: usize,
    /// Frames of a shelf.
    each: usize,
    shelves: Vec<GpuBuffer>,
    /// Of the frames that have a place: whether they are there.
    present: Vec<bool>,
    current: GpuBuffer,
}

impl GpuFrames {
    /// Room for the first frames of `count` of so many words each, as many as `budget_bytes` hold.
    ///
    /// # Errors
    /// When the device cannot hold a frame.
    pub fn new(gpu: &Arc<Gpu>, count: usize, words: usize, budget_bytes: usize) -> Result<Self, SplatError> {
        let bytes = 4 * words.max(1);
        Ok(Self {
            gpu: Arc::clone(gpu),
            words,
            each: (SHELF_BYTES / bytes).max(1),
            shelves: Vec::new(),
            present: vec![false; count.min(budget_bytes / bytes)],
            current: GpuBuffer::new(gpu, "the recording's frame", words)?,
        })
    }

    /// Whether a frame must be given to [`GpuFrames::choose`].
    pub fn is_wanted(&self, frame: usize) -> bool {
        self.present.get(frame) != Some(&true)
    }

    /// Where the frame of the next submission is, for kernels.
    pub fn current(&self) -> &GpuBuffer {
        &self.current
    }

    /// Brings a frame to [`GpuFrames::current`], before whatever is submitted next; `words` are its own where
    /// [`GpuFrames::is_wanted`] says so.
    ///
    /// # Errors
    /// When they are not a frame's, or the device cannot hold it.
    pub fn choose(&mut self, frame: usize, words: Option<&[u32]>) -> Result<(), SplatError> {
        let given = if self.is_wanted(frame) { words.map_or(0, <[u32]>::len) } else { self.words };
        expect_length("the words of a frame", self.words, given)?;
        let (Some(present), shelf) = (self.present.get(frame).copied(), frame / self.each) else {
            return self.current.write(0, words.unwrap_or_default());
        };
        while self.shelves.len() <= shelf {
            let first = self.shelves.len() * self.each;
            let frames = self.each.min(self.present.len() - first);
            self.shelves.push(GpuBuffer::new(&self.gpu, "the recording's frames", frames * self.words)?);
        }
        let at = frame % self.each * self.words;
        if !present {
            self.shelves[shelf].write(at, words.unwrap_or_default())?;
            self.present[frame] = true;
        }
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (from, to, bytes) = (&self.shelves[shelf].buffer, &self.current.buffer, 4 * self.words as u64);
        encoder.copy_buffer_to_buffer(from, 4 * at as u64, to, 0, bytes);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.check()
    }
}
