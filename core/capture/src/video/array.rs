//! Videos that a file keeps as one array with time as its fastest axis: turned over into frames through a temporary file.
//!
//! MATLAB stores `T×H×W×3` by columns, so all times of one pixel come first and no frame is whole before the last value.
//! A block of pixels is held, transposed and written where each frame's bytes belong; memory stays at the block's size.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};

use heartian_space::Rgb8Image;

use super::bitmap::is_sane;
use super::{FrameSource, TimedFrame, VideoError};
use crate::dataset::DataSetError;

/// Bytes of a block of pixels.
const BLOCK_BYTES: usize = 1 << 26;
/// Frames transposed side by side.
const SIDE_BY_SIDE: usize = 64;
/// Most frames, and most bytes of all frames, that a file may claim.
const MOST_FRAMES: usize = 1 << 20;
const MOST_BYTES: usize = 1 << 36;

/// How values become 8-bit codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    /// 0–1, as both data sets keep it.
    Unit,
    /// 0–255.
    Bytes,
}

/// An array on its way into frames.
pub(crate) struct Columns {
    frames: usize,
    height: usize,
    width: usize,
    scale: Scale,
    /// Pixel values (one channel of one pixel) of a block.
    block: usize,
    /// `pixel×frames`, those that have come.
    waiting: Vec<u8>,
    /// Pixel values already written.
    written: usize,
    file: File,
}

impl Columns {
    /// For an array of that many frames, rows and columns, by three channels.
    ///
    /// # Errors
    /// When the size is absurd or there is no room for temporary files.
    pub fn new([frames, height, width]: [usize; 3], scale: Scale) -> Result<Self, DataSetError> {
        let bytes = frames.checked_mul(3).filter(|_| is_sane(width, height)).map(|n| n.saturating_mul(width * height));
        if frames == 0 || frames > MOST_FRAMES || bytes.is_none_or(|bytes| bytes > MOST_BYTES) {
            return Err(DataSetError::Absurd { frames, width, height });
        }
        let file = tempfile::tempfile().map_err(DataSetError::Temporary)?;
        let block = (BLOCK_BYTES / frames).clamp(1, width * height * 3);
        Ok(Self { frames, height, width, scale, block, waiting: Vec::new(), written: 0, file })
    }

    /// Takes the next values in the file's order.
    ///
    /// # Errors
    /// When one is no brightness, there are too many, or the temporary file cannot be written.
    pub fn push(&mut self, values: &[f64]) -> Result<(), DataSetError> {
        let room = (self.width * self.height * 3 - self.written) * self.frames - self.waiting.len();
        if values.len() > room {
            return Err(DataSetError::Count { more: true });
        }
        let (factor, most) = match self.scale {
            Scale::Unit => (255.0, 1.0),
            Scale::Bytes => (1.0, 255.0),
        };
        for value in values {
            // Half a code of slack: resized pictures overshoot by rounding.
            if !(-0.002 * most..=1.002 * most).contains(value) {
                let (index, most) = (self.written * self.frames + self.waiting.len(), most as u32);
                return Err(DataSetError::Brightness { frame: index % self.frames, value: *value, most });
            }
            self.waiting.push((value * factor).round_ties_even().clamp(0.0, 255.0) as u8);
            if self.waiting.len() == self.block * self.frames {
                self.flush()?;
            }
        }
        Ok(())
    }

    /// Writes the waiting pixels into their frames.
    fn flush(&mut self) -> Result<(), DataSetError> {
        let (pixels, frame_bytes) = (self.waiting.len() / self.frames, self.width * self.height * 3);
        let mut rows = vec![0; pixels * SIDE_BY_SIDE.min(self.frames)];
        for first in (0..self.frames).step_by(SIDE_BY_SIDE) {
            let count = SIDE_BY_SIDE.min(self.frames - first);
            for (pixel, times) in self.waiting.chunks_exact(self.frames).enumerate() {
                for (row, value) in times[first..first + count].iter().enumerate() {
                    rows[row * pixels + pixel] = *value;
                }
            }
            for (row, bytes) in rows.chunks_exact(pixels.max(1)).take(count).enumerate() {
                let at = (first + row) * frame_bytes + self.written;
                self.file
                    .seek(SeekFrom::Start(at as u64))
                    .and_then(|_| self.file.write_all(bytes))
                    .map_err(DataSetError::Temporary)?;
            }
        }
        self.written += pixels;
        self.waiting.clear();
        Ok(())
    }

    /// The frames, at an even rate.
    ///
    /// # Errors
    /// When values are missing or the temporary file cannot be written.
    pub fn finish(mut self, hertz: f64) -> Result<ArrayVideo, DataSetError> {
        if self.written * self.frames + self.waiting.len() != self.width * self.height * 3 * self.frames {
            return Err(DataSetError::Count { more: false });
        }
        self.flush()?;
        let Self { frames, height, width, file, .. } = self;
        Ok(ArrayVideo { frames, height, width, file, hertz, next: 0 })
    }
}

/// An array's frames.
pub(crate) struct ArrayVideo {
    frames: usize,
    height: usize,
    width: usize,
    file: File,
    hertz: f64,
    next: usize,
}

impl FrameSource for ArrayVideo {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        if self.next == self.frames {
            return Ok(None);
        }
        let (w, h) = (self.width, self.height);
        let mut bytes = vec![0; w * h * 3];
        self.file
            .seek(SeekFrom::Start((self.next * bytes.len()) as u64))
            .and_then(|_| self.file.read_exact(&mut bytes))
            .map_err(DataSetError::Temporary)?;
        let mut data = Vec::with_capacity(bytes.len());
        for y in 0..h {
            data.extend((0..w).flat_map(|x| [0, 1, 2].map(|channel| bytes[(channel * w + x) * h + y])));
        }
        let seconds = self.next as f64 / self.hertz;
        self.next += 1;
        Ok(Some(TimedFrame { seconds, image: Rgb8Image { width: w, height: h, data } }))
    }

    fn frame_count(&self) -> Option<usize> {
        Some(self.frames)
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// Columns of any chunking become the frames they hold, also when the block is a few pixels.
    #[test]
    fn columns_become_frames() {
        let [frames, height, width] = [70usize, 3, 5];
        let code = |t: usize, y: usize, x: usize, c: usize| (t * 3 + y * 50 + x * 7 + c * 90) % 256;
        let mut values = Vec::new();
        for c in 0..3 {
            for x in 0..width {
                for y in 0..height {
                    values.extend((0..frames).map(|t| code(t, y, x, c) as f64 / 255.0));
                }
            }
        }
        for (block, chunk) in [(4, 11), (45, 1000), (1, 70)] {
            let mut columns = Columns::new([frames, height, width], Scale::Unit).unwrap();
            columns.block = block;
            values.chunks(chunk).for_each(|values| columns.push(values).unwrap());
            assert!(columns.push(&[0.0]).is_err());
            let mut video = columns.finish(30.0).unwrap();
            for t in 0..frames {
                let frame = video.next_frame().unwrap().unwrap();
                assert!((frame.seconds - t as f64 / 30.0).abs() < 1e-12);
                for y in 0..height {
                    for x in 0..width {
                        assert_eq!(frame.image.pixel(x, y).map(usize::from), [0, 1, 2].map(|c| code(t, y, x, c)));
                    }
                }
            }
            assert!(video.next_frame().unwrap().is_none());
        }
    }

    #[test]
    fn what_is_no_brightness_and_what_is_no_size_is_refused() {
        let mut columns = Columns::new([2, 1, 1], Scale::Unit).unwrap();
        assert!(matches!(columns.push(&[0.5, f64::NAN]), Err(DataSetError::Brightness { frame: 1, .. })));
        assert!(matches!(columns.push(&[7.0]), Err(DataSetError::Brightness { .. })));
        assert!(matches!(columns.finish(30.0), Err(DataSetError::Count { more: false })));
        for size in [[0, 1, 1], [1, 0, 1], [1, 1 << 40, 1], [1 << 40, 8, 8], [usize::MAX, 9, 9]] {
            assert!(matches!(Columns::new(size, Scale::Bytes), Err(DataSetError::Absurd { .. })));
        }
    }
}
