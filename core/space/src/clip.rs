//! A clip: frames, matte and true frame times, as it travels between nodes.
//!
//! Always holds: `frames.len() = T·H·W·3`, `alpha.len() = T·H·W`, times are finite and strictly increasing, T ≥ 1.

mod beside;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::{Rgb8Image, SpaceError};

/// Frames with their matte and times. Colours are straight (not premultiplied by alpha).
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// What the clip is in a report: `input`, `baseline_rendered`, `rendered`, `relit`, …
    pub label: String,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// `T×H×W×3`, sRGB-encoded.
    pub frames: Vec<u8>,
    /// `T×H×W`, 255 = the person.
    pub alpha: Vec<u8>,
    /// `T` frame times, seconds, strictly increasing.
    pub times_seconds: Vec<f64>,
}

/// The arrays of a clip before they are checked.
pub struct Sequence {
    /// `T×H×W×3`.
    pub frames: Vec<u8>,
    /// `T×H×W`.
    pub alpha: Vec<u8>,
    /// `T`.
    pub times_seconds: Vec<f64>,
}

impl Clip {
    /// Checks and wraps the arrays.
    ///
    /// # Errors
    /// When there is no frame, a length contradicts the size, or times do not increase.
    pub fn new(label: &str, width: usize, height: usize, sequence: Sequence) -> Result<Self, SpaceError> {
        let Sequence { frames, alpha, times_seconds } = sequence;
        let count = times_seconds.len();
        if count == 0 || width == 0 || height == 0 {
            return Err(SpaceError::Empty("the clip"));
        }
        let pixels = count.saturating_mul(width).saturating_mul(height);
        for (what, expected, found) in
            [("the clip's frames", pixels.saturating_mul(3), frames.len()), ("the clip's alpha", pixels, alpha.len())]
        {
            if expected != found {
                return Err(SpaceError::Length { what, expected, found });
            }
        }
        crate::series::check_times("the clip", &times_seconds)?;
        Ok(Self { label: label.to_owned(), width, height, frames, alpha, times_seconds })
    }

    /// Number of frames, ≥ 1.
    pub fn len(&self) -> usize {
        self.times_seconds.len()
    }

    /// Never true of a checked clip; here because every `len` has one.
    pub fn is_empty(&self) -> bool {
        self.times_seconds.is_empty()
    }

    /// One frame's colours, `H×W×3`.
    pub fn frame(&self, index: usize) -> &[u8] {
        let size = self.width * self.height * 3;
        &self.frames[index * size..(index + 1) * size]
    }

    /// One frame's matte, `H×W`.
    pub fn frame_alpha(&self, index: usize) -> &[u8] {
        let size = self.width * self.height;
        &self.alpha[index * size..(index + 1) * size]
    }

    /// One frame as an image of its own, composited over black as the trainer sees it.
    pub fn image_over_black(&self, index: usize) -> Rgb8Image {
        let colors = self.frame(index).as_chunks::<3>().0;
        let data = colors
            .iter()
            .zip(self.frame_alpha(index))
            .flat_map(|(color, alpha)| color.map(|c| ((u32::from(c) * u32::from(*alpha) + 127) / 255) as u8))
            .collect();
        Rgb8Image { width: self.width, height: self.height, data }
    }

    /// Mean frame rate over the clip, hertz; 0 for a single frame.
    pub fn frame_rate_hertz(&self) -> f64 {
        let (first, last) = (self.times_seconds[0], self.times_seconds[self.len() - 1]);
        if last > first { (self.len() - 1) as f64 / (last - first) } else { 0.0 }
    }
}

impl Artifact for Clip {
    const TYPE: ArtifactType = ArtifactType { name: "clip", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let (t, h, w) = (self.len(), self.height, self.width);
        Bundle::new()
            .tensor("frames", &[t, h, w, 3], &self.frames)?
            .tensor("alpha", &[t, h, w], &self.alpha)?
            .tensor("times_seconds", &[t], &self.times_seconds)?
            .meta("label", &self.label)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let (shape, frames) = reader.tensor::<u8>("frames")?;
        let [_, height, width, 3] = shape[..] else {
            return Err(ArtifactError::Shape { name: "frames".into(), expected: "[T, H, W, 3]".into(), found: shape });
        };
        let sequence =
            Sequence { frames, alpha: reader.tensor("alpha")?.1, times_seconds: reader.tensor("times_seconds")?.1 };
        let label: String = reader.meta("label")?;
        Self::new(&label, width, height, sequence).map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}
