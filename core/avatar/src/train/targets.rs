//! What the fit is compared with: a frame over black and its matte, planar, at full or half resolution.

use heartian_space::{Camera, Clip};

/// One frame to be matched.
pub(crate) struct Target {
    /// `3 × H × W`, sRGB-encoded in [0, 1], premultiplied over black.
    pub rgb: Vec<f32>,
    /// `H × W` in [0, 1].
    pub alpha: Vec<f32>,
}

/// The resolution of a stage of the fit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Level {
    /// Source pixels along each side of one pixel, 1 or 2.
    pub factor: usize,
    /// Pixels of a source's row.
    pub source_width: usize,
    /// The camera at this resolution.
    pub camera: Camera,
}

impl Level {
    /// Full or half resolution. An odd last row or column is dropped at half resolution.
    pub fn new(camera: &Camera, factor: usize) -> Self {
        let (width, height, source_width) = (camera.width / factor, camera.height / factor, camera.width);
        let scale = 1.0 / factor as f32;
        let camera = Camera {
            width,
            height,
            focal_px: camera.focal_px.map(|f| f * scale),
            principal_px: camera.principal_px.map(|p| p * scale),
            ..*camera
        };
        Self { factor, source_width, camera }
    }

    /// One frame at this resolution, box-filtered in the encoding it is compared in.
    pub fn target(&self, clip: &Clip, frame: usize) -> Target {
        let (width, height) = (self.camera.width, self.camera.height);
        let (colors, matte) = (clip.frame(frame), clip.frame_alpha(frame));
        let pixels = width * height;
        let mut target = Target { rgb: vec![0.0; 3 * pixels], alpha: vec![0.0; pixels] };
        let share = 1.0 / (self.factor * self.factor) as f32 / 255.0;
        for y in 0..height {
            for x in 0..width {
                let pixel = y * width + x;
                for dy in 0..self.factor {
                    for dx in 0..self.factor {
                        let source = (y * self.factor + dy) * clip.width + x * self.factor + dx;
                        let alpha = f32::from(matte[source]) * share;
                        target.alpha[pixel] += alpha;
                        for channel in 0..3 {
                            let color = f32::from(colors[3 * source + channel]) / 255.0;
                            target.rgb[channel * pixels + pixel] += color * alpha;
                        }
                    }
                }
            }
        }
        target
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_space::{Sequence, SpaceError};

    #[test]
    fn half_resolution_keeps_the_mean_and_the_geometry() -> Result<(), SpaceError> {
        let frames: Vec<u8> = (0..8 * 6 * 3).map(|i| (i * 7 % 256) as u8).collect();
        let sequence = Sequence { frames, alpha: vec![255; 48], times_seconds: vec![0.0] };
        let clip = Clip::new("input", 8, 6, sequence)?;
        let camera = Camera::at_origin(8, 6, 10.0);
        let (full, half) = (Level::new(&camera, 1), Level::new(&camera, 2));
        let mean = |target: Target| target.rgb.iter().sum::<f32>() / target.rgb.len() as f32;
        assert!((mean(full.target(&clip, 0)) - mean(half.target(&clip, 0))).abs() < 1e-6);
        let point = glam::Vec3::new(0.1, 0.2, -1.0);
        let (a, b) = (full.camera.project(point), half.camera.project(point));
        assert!(a.zip(b).is_some_and(|(a, b)| (a * 0.5 - b).length() < 1e-5));
        Ok(())
    }
}
