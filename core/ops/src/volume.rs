//! Stacks of planes: the layout that three-dimensional convolutions read.
//!
//! `frames × channels × height × width`, each plane with a margin of zeros above, below and between its rows, so that a
//! padded window needs no test for the border: a window's tap is one offset for all outputs of a plane. The margin right of a
//! row is the margin left of the next. Margins are zero always: writers touch the pixels of rows only.

use rayon::prelude::*;

use crate::ShapeError;
use crate::map::check;

/// Readable values after the last plane: kernels read whole tiles and drop what lies outside.
pub(crate) const SLACK: usize = 128;

/// Sizes of a [`Volume`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// Frames, the slowest axis.
    pub frames: usize,
    /// Channels of a frame.
    pub channels: usize,
    /// Rows of a plane.
    pub height: usize,
    /// Columns of a plane.
    pub width: usize,
}

impl Extent {
    /// Number of pixels of all planes.
    pub fn values(&self) -> usize {
        self.frames * self.channels * self.height * self.width
    }
}

/// A stack of planes with zero margins.
#[derive(Clone, Debug)]
pub struct Volume {
    extent: Extent,
    margin: usize,
    data: Vec<f32>,
}

impl Volume {
    /// All zero; windows may reach `margin` pixels beyond each edge.
    pub fn zeros(extent: Extent, margin: usize) -> Self {
        let mut volume = Self { extent, margin, data: Vec::new() };
        volume.data = vec![0.0; extent.frames * volume.frame_len() + SLACK];
        volume
    }

    /// Copies a dense array `channels × frames × height × width` (`frames_first`: `frames × channels × …`).
    ///
    /// # Errors
    /// When the array has another length.
    pub fn from_dense(extent: Extent, margin: usize, dense: &[f32], frames_first: bool) -> Result<Self, ShapeError> {
        check("the dense array", extent.values(), dense.len())?;
        let mut volume = Self::zeros(extent, margin);
        let Extent { frames, channels, height, width } = extent;
        volume.par_frames_mut().enumerate().for_each(|(t, mut frame)| {
            for c in 0..channels {
                let plane = if frames_first { t * channels + c } else { c * frames + t };
                for y in 0..height {
                    let from = (plane * height + y) * width;
                    frame.row_mut(c, y).copy_from_slice(&dense[from..from + width]);
                }
            }
        });
        Ok(volume)
    }

    /// Frames of two volumes of one shape in turn, the even ones from the first.
    pub fn interleaved(even: &Self, odd: &Self) -> Self {
        let len = even.frame_len();
        let extent = Extent { frames: even.extent.frames.min(odd.extent.frames) * 2, ..even.extent };
        let mut both = Self::zeros(extent, even.margin);
        if even.extent == odd.extent && even.margin == odd.margin {
            for (t, frame) in both.data.chunks_exact_mut(len.max(1)).take(extent.frames).enumerate() {
                let from = if t % 2 == 0 { even } else { odd };
                frame.copy_from_slice(&from.data[t / 2 * len..(t / 2 + 1) * len]);
            }
        }
        both
    }

    /// Sizes without margins.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Pixels by which windows may leave a plane.
    pub fn margin(&self) -> usize {
        self.margin
    }

    /// Step from row to row.
    pub(crate) fn pitch(&self) -> usize {
        self.extent.width + self.margin
    }

    fn plane_len(&self) -> usize {
        ((self.extent.height + 2 * self.margin) * self.pitch() + 2 * self.margin).next_multiple_of(8)
    }

    fn frame_len(&self) -> usize {
        self.extent.channels * self.plane_len()
    }

    /// Index of a plane's first pixel.
    pub(crate) fn origin(&self, frame: usize, channel: usize) -> usize {
        frame * self.frame_len() + channel * self.plane_len() + self.margin + self.margin * self.pitch()
    }

    /// Everything, margins and slack included.
    pub(crate) fn raw(&self) -> &[f32] {
        &self.data
    }

    /// All planes of a frame with their margins, if there is such a frame.
    pub(crate) fn raw_frame(&self, frame: usize) -> Option<&[f32]> {
        let len = self.frame_len();
        (frame < self.extent.frames).then(|| &self.data[frame * len..(frame + 1) * len])
    }

    /// As [`Self::raw_frame`], to write into; margins must stay zero.
    pub(crate) fn raw_frame_mut(&mut self, frame: usize) -> &mut [f32] {
        let len = self.frame_len();
        &mut self.data[frame * len..(frame + 1) * len]
    }

    /// The pixels of a row.
    pub fn row(&self, frame: usize, channel: usize, y: usize) -> &[f32] {
        let start = self.origin(frame, channel) + y * self.pitch();
        &self.data[start..start + self.extent.width]
    }

    /// The pixels of a row, to write into.
    pub fn row_mut(&mut self, frame: usize, channel: usize, y: usize) -> &mut [f32] {
        let start = self.origin(frame, channel) + y * self.pitch();
        &mut self.data[start..start + self.extent.width]
    }

    /// A frame's planes to write into; frames may be written in parallel.
    pub fn par_frames_mut(&mut self) -> impl IndexedParallelIterator<Item = FrameMut<'_>> {
        let (len, count) = (self.frame_len(), self.extent.frames);
        let shape = FrameShape {
            width: self.extent.width,
            pitch: self.pitch(),
            plane: self.plane_len(),
            first: self.margin * (self.pitch() + 1),
        };
        self.data[..len * count].par_chunks_exact_mut(len.max(1)).map(move |data| FrameMut { shape, data })
    }

    /// The pixels as a dense array, `channels × frames × height × width`.
    pub fn to_dense(&self) -> Vec<f32> {
        let Extent { frames, channels, height, .. } = self.extent;
        let mut dense = Vec::with_capacity(self.extent.values());
        for c in 0..channels {
            for t in 0..frames {
                for y in 0..height {
                    dense.extend_from_slice(self.row(t, c, y));
                }
            }
        }
        dense
    }
}

#[derive(Clone, Copy, Debug)]
struct FrameShape {
    width: usize,
    pitch: usize,
    plane: usize,
    first: usize,
}

/// One frame of a [`Volume`].
#[derive(Debug)]
pub struct FrameMut<'a> {
    shape: FrameShape,
    data: &'a mut [f32],
}

impl FrameMut<'_> {
    /// The pixels of a row.
    pub fn row_mut(&mut self, channel: usize, y: usize) -> &mut [f32] {
        let start = channel * self.shape.plane + self.shape.first + y * self.shape.pitch;
        &mut self.data[start..start + self.shape.width]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dense_array_comes_back_and_margins_stay_zero() -> Result<(), ShapeError> {
        let extent = Extent { frames: 3, channels: 2, height: 4, width: 5 };
        let dense: Vec<f32> = (1..=extent.values()).map(|i| i as f32).collect();
        let volume = Volume::from_dense(extent, 2, &dense, false)?;
        assert_eq!(volume.to_dense(), dense);
        assert_eq!(volume.raw().iter().filter(|v| **v != 0.0).count(), extent.values());
        assert_eq!(volume.row(1, 1, 2)[0], dense[((3 + 1) * 4 + 2) * 5]);
        let by_frame = Volume::from_dense(extent, 0, &dense, true)?;
        assert_eq!(by_frame.row(1, 1, 2)[0], dense[((2 + 1) * 4 + 2) * 5]);
        assert!(Volume::from_dense(extent, 0, &dense[1..], true).is_err());
        Ok(())
    }
}
