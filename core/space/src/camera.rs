//! A pinhole camera. Camera frame: OpenCV (x right, y down, z forward); pixel centres at +0.5.

use glam::{Mat3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Pinhole camera with square-independent focal lengths and no distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Focal lengths, pixels.
    pub focal_px: [f32; 2],
    /// Principal point, pixels (the centre of a `w×h` image is `[w/2, h/2]`).
    pub principal_px: [f32; 2],
    /// Rotation part of camera-from-world, columns.
    pub rotation: [[f32; 3]; 3],
    /// Translation part of camera-from-world, metres.
    pub translation: [f32; 3],
}

impl Camera {
    /// The camera of our clips: at the world's origin, looking along −z, y up.
    pub fn at_origin(width: usize, height: usize, focal_px: f32) -> Self {
        Self {
            width,
            height,
            focal_px: [focal_px; 2],
            principal_px: [width as f32 / 2.0, height as f32 / 2.0],
            rotation: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
            translation: [0.0; 3],
        }
    }

    /// Rotation of camera-from-world.
    pub fn camera_from_world_rotation(&self) -> Mat3 {
        Mat3::from_cols_array_2d(&self.rotation)
    }

    /// A world point in the camera frame.
    pub fn camera_from_world_point(&self, point_in_world: Vec3) -> Vec3 {
        self.camera_from_world_rotation() * point_in_world + Vec3::from_array(self.translation)
    }

    /// The camera's centre in the world.
    pub fn centre_in_world(&self) -> Vec3 {
        -(self.camera_from_world_rotation().transpose() * Vec3::from_array(self.translation))
    }

    /// Pixel of a world point; `None` when it is not in front of the camera.
    pub fn project(&self, point_in_world: Vec3) -> Option<Vec2> {
        let p = self.camera_from_world_point(point_in_world);
        let [fx, fy] = self.focal_px;
        let [cx, cy] = self.principal_px;
        (p.z > 1e-6).then(|| Vec2::new(fx * p.x / p.z + cx, fy * p.y / p.z + cy))
    }

    /// Unit direction in the world of the ray through a pixel position.
    pub fn ray_in_world(&self, pixel: Vec2) -> Vec3 {
        let [fx, fy] = self.focal_px;
        let [cx, cy] = self.principal_px;
        let direction_in_camera = Vec3::new((pixel.x - cx) / fx, (pixel.y - cy) / fy, 1.0);
        (self.camera_from_world_rotation().transpose() * direction_in_camera).normalize_or_zero()
    }

    /// The same view at another resolution.
    pub fn scaled_to(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        Self {
            width,
            height,
            focal_px: [self.focal_px[0] * sx, self.focal_px[1] * sy],
            principal_px: [self.principal_px[0] * sx, self.principal_px[1] * sy],
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_passes_through_the_point_it_came_from() {
        let camera = Camera::at_origin(256, 256, 400.0);
        let point = Vec3::new(0.05, 0.11, -1.2);
        let pixel = camera.project(point).map(|pixel| camera.ray_in_world(pixel) * point.length());
        assert!(pixel.is_some_and(|p| p.distance(point) < 1e-5));
        assert!(camera.project(Vec3::Z).is_none());
        assert!(
            camera.project(Vec3::new(0.0, 0.1, -1.0)).is_some_and(|p| p.y < 128.0),
            "y up in the world is up in the image"
        );
    }
}
