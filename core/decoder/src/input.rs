//! What a network wants to be fed, and a batch of it.

use crate::DecoderError;

/// How frames are brought to numbers before a network sees them. Statistics are over the whole clip, or the chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Normalisation {
    /// 0..255 as they are.
    Raw,
    /// `(f₁ − f₀) / (f₁ + f₀ + 10⁻⁷)` over its standard deviation; the last frame is zero.
    DiffNormalized,
    /// `(f − mean) / standard deviation`, one mean and deviation for all channels.
    Standardized,
}

/// What the samples that come out are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// The change of the pulse from frame to frame: cumulate before looking for a heart rate.
    Derivative,
    /// The pulse itself.
    Pulse,
}

/// What a network was trained on (rPPG-Toolbox's configuration; weights from elsewhere may want another normalisation).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputForm {
    /// Samples that come out of a chunk of the usual length.
    pub frames: usize,
    /// Frames to append to a chunk by repeating its last one.
    pub extra_frames: usize,
    /// The number of samples of a chunk must be a multiple of this.
    pub frame_multiple: usize,
    /// Height and width of a frame.
    pub side_px: usize,
    /// Channels in groups of three (RGB): each group the frames under this normalisation, one group after the other.
    pub normalisations: Vec<Normalisation>,
    /// What comes out.
    pub output: Output,
}

impl InputForm {
    /// Channels of a frame, three a normalisation.
    pub fn channels(&self) -> usize {
        3 * self.normalisations.len()
    }

    /// Values of one chunk of `frames` samples, repeated frames included.
    pub fn chunk_len(&self, frames: usize) -> usize {
        self.channels() * (frames + self.extra_frames) * self.side_px * self.side_px
    }
}

/// Chunks of equal length, run together.
#[derive(Clone, Copy, Debug)]
pub struct Batch<'a> {
    /// `chunks × channels × (frames + extra frames) × side × side` values, row-major.
    pub data: &'a [f32],
    /// Chunks.
    pub chunks: usize,
    /// Samples a chunk, without the repeated frames.
    pub frames: usize,
}

impl<'a> Batch<'a> {
    /// One chunk of `frames` samples.
    pub fn one(data: &'a [f32], frames: usize) -> Self {
        Self { data, chunks: 1, frames }
    }

    /// Errs unless the batch has this form and holds finite numbers only.
    pub(crate) fn check(&self, form: &InputForm) -> Result<(), DecoderError> {
        if self.frames == 0 || !self.frames.is_multiple_of(form.frame_multiple) {
            return Err(DecoderError::ChunkLength { frames: self.frames, multiple: form.frame_multiple });
        }
        let expected = form
            .channels()
            .checked_mul(self.chunks)
            .and_then(|n| n.checked_mul(self.frames.checked_add(form.extra_frames)?))
            .and_then(|n| n.checked_mul(form.side_px * form.side_px));
        if expected != Some(self.data.len()) || self.chunks == 0 {
            return Err(DecoderError::BatchSize {
                chunks: self.chunks,
                channels: form.channels(),
                frames: self.frames.saturating_add(form.extra_frames),
                side_px: form.side_px,
                found: self.data.len(),
            });
        }
        match self.data.iter().position(|value| !value.is_finite()) {
            Some(index) => Err(DecoderError::InputNotFinite { index, value: self.data[index] }),
            None => Ok(()),
        }
    }
}
