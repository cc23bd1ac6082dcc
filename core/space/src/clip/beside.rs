//! Clips of one length beside each other in one picture, for eyes to compare.

use super::{Clip, Sequence};
use crate::SpaceError;

impl Clip {
    /// The clips from left to right, each over black; pictures lower than the highest stand at the top. Times are those of
    /// the first clip; the matte is full.
    ///
    /// # Errors
    /// When there is no clip, or they differ in their number of frames.
    pub fn beside(label: &str, clips: &[&Clip]) -> Result<Self, SpaceError> {
        let Some(first) = clips.first() else { return Err(SpaceError::Empty("the clips to show beside each other")) };
        if let Some(other) = clips.iter().find(|clip| clip.len() != first.len()) {
            let what = "the frames of a clip beside another";
            return Err(SpaceError::Length { what, expected: first.len(), found: other.len() });
        }
        let width: usize = clips.iter().map(|clip| clip.width).sum();
        let height = clips.iter().map(|clip| clip.height).max().unwrap_or(0);
        let mut frames = vec![0u8; first.len() * width * height * 3];
        for (index, picture) in frames.chunks_exact_mut(width * height * 3).enumerate() {
            let mut left = 0;
            for clip in clips {
                let image = clip.image_over_black(index);
                for (row, pixels) in image.data.chunks_exact(3 * clip.width).enumerate() {
                    picture[3 * (row * width + left)..][..pixels.len()].copy_from_slice(pixels);
                }
                left += clip.width;
            }
        }
        let alpha = vec![255; first.len() * width * height];
        Self::new(label, width, height, Sequence { frames, alpha, times_seconds: first.times_seconds.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(width: usize, height: usize, frames: usize, value: u8, alpha: u8) -> Result<Clip, SpaceError> {
        let sequence = Sequence {
            frames: vec![value; frames * width * height * 3],
            alpha: vec![alpha; frames * width * height],
            times_seconds: (0..frames).map(|t| t as f64).collect(),
        };
        Clip::new("flat", width, height, sequence)
    }

    #[test]
    fn every_clip_has_its_place_and_is_over_black() -> Result<(), SpaceError> {
        let (a, b) = (flat(2, 3, 2, 200, 255)?, flat(1, 2, 2, 100, 128)?);
        let both = Clip::beside("both", &[&a, &b])?;
        assert_eq!((both.width, both.height, both.len()), (3, 3, 2));
        let green = |x: usize, y: usize| both.frame(1)[3 * (y * 3 + x) + 1];
        assert_eq!([green(0, 0), green(1, 2), green(2, 0), green(2, 1), green(2, 2)], [200, 200, 50, 50, 0]);
        assert!(Clip::beside("none", &[]).is_err());
        assert!(Clip::beside("odd", &[&a, &flat(2, 3, 1, 0, 0)?]).is_err());
        Ok(())
    }
}
