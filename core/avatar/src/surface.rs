//! What a camera sees of a triangle mesh: the nearest triangle and its depth at every pixel centre.
//!
//! Used to decide where Gaussians are worth having and from which frames their colour can be read. Back faces are seen
//! too (the inside of a mouth is); triangles that reach behind the camera are left out.

use glam::{Vec2, Vec3};
use heartian_space::Camera;

/// Marks a pixel without surface.
pub const NOTHING: u32 = u32::MAX;

/// One picture of a mesh.
pub struct MeshView {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `H×W` distance along the optical axis, metres; infinite where there is no surface.
    pub depth: Vec<f32>,
    /// `H×W` triangle numbers, or [`NOTHING`].
    pub triangle: Vec<u32>,
    /// `H×W` barycentric coordinates of the first two corners.
    pub barycentric: Vec<[f32; 2]>,
}

impl MeshView {
    /// Rasterises the mesh.
    pub fn new(vertices_in_world: &[[f32; 3]], triangles: &[[u32; 3]], camera: &Camera) -> Self {
        let (width, height) = (camera.width, camera.height);
        let mut view = Self {
            width,
            height,
            depth: vec![f32::INFINITY; width * height],
            triangle: vec![NOTHING; width * height],
            barycentric: vec![[0.0; 2]; width * height],
        };
        let projected: Vec<Option<(Vec2, f32)>> = vertices_in_world
            .iter()
            .map(|vertex| {
                let point = Vec3::from_array(*vertex);
                camera.project(point).map(|pixel| (pixel, camera.camera_from_world_point(point).z))
            })
            .collect();
        for (index, triangle) in triangles.iter().enumerate() {
            if let [Some(a), Some(b), Some(c)] = triangle.map(|vertex| projected[vertex as usize]) {
                view.draw(index as u32, [a, b, c]);
            }
        }
        view
    }

    fn draw(&mut self, index: u32, corners: [(Vec2, f32); 3]) {
        let [(a, za), (b, zb), (c, zc)] = corners;
        let area = (b - a).perp_dot(c - a);
        if !(area.abs() > 1e-9) {
            return;
        }
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        // Pixel centres at +0.5; casts saturate, so a far-away corner is only clipped.
        let range = |low: f32, high: f32, size: usize| {
            let from = (low - 0.5).ceil().max(0.0) as usize;
            let to = ((high - 0.5).floor() + 1.0).clamp(0.0, size as f32) as usize;
            from..to
        };
        for y in range(low.y, high.y, self.height) {
            for x in range(low.x, high.x, self.width) {
                let p = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let wa = (b - p).perp_dot(c - p) / area;
                let wb = (c - p).perp_dot(a - p) / area;
                let wc = 1.0 - wa - wb;
                if wa < 0.0 || wb < 0.0 || wc < 0.0 {
                    continue;
                }
                let z = 1.0 / (wa / za + wb / zb + wc / zc);
                let pixel = y * self.width + x;
                if z < self.depth[pixel] {
                    self.depth[pixel] = z;
                    self.triangle[pixel] = index;
                    self.barycentric[pixel] = [wa * z / za, wb * z / zb];
                }
            }
        }
    }

    /// For each pixel the nearest pixel with surface (city-block growth); `None` when there is no surface at all.
    pub fn nearest_surface(&self) -> Option<Vec<u32>> {
        let mut nearest: Vec<u32> = (0..self.triangle.len() as u32)
            .map(|p| if self.triangle[p as usize] == NOTHING { NOTHING } else { p })
            .collect();
        let mut front: Vec<u32> = nearest.iter().copied().filter(|p| *p != NOTHING).collect();
        if front.is_empty() {
            return None;
        }
        while !front.is_empty() {
            let mut next = Vec::new();
            for pixel in front {
                let source = nearest[pixel as usize];
                let (x, y) = (pixel as usize % self.width, pixel as usize / self.width);
                let neighbours = [
                    (x > 0).then(|| pixel - 1),
                    (x + 1 < self.width).then(|| pixel + 1),
                    (y > 0).then(|| pixel - self.width as u32),
                    (y + 1 < self.height).then(|| pixel + self.width as u32),
                ];
                for neighbour in neighbours.into_iter().flatten() {
                    if nearest[neighbour as usize] == NOTHING {
                        nearest[neighbour as usize] = source;
                        next.push(neighbour);
                    }
                }
            }
            front = next;
        }
        Some(nearest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearer_triangle_hides_the_farther() {
        let camera = Camera::at_origin(16, 16, 16.0);
        let quad = |z: f32, half: f32| [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]];
        let vertices = [quad(-2.0, 0.9), quad(-1.0, 0.1)].concat();
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let view = MeshView::new(&vertices, &triangles, &camera);
        let at = |x: usize, y: usize| (view.triangle[y * 16 + x], view.depth[y * 16 + x]);
        assert!(at(8, 8).0 >= 2 && (at(8, 8).1 - 1.0).abs() < 1e-5);
        assert!(at(3, 8).0 < 2 && (at(3, 8).1 - 2.0).abs() < 1e-5);
        assert_eq!(at(0, 0).0, NOTHING);
        let nearest = view.nearest_surface().unwrap_or_default();
        assert_eq!(nearest[8 * 16 + 8], 8 * 16 + 8);
        assert!(view.triangle[nearest[0] as usize] < 2);
        let behind = MeshView::new(&[[0.0, 0.0, 1.0]; 3], &[[0, 1, 2]], &camera);
        assert!(behind.nearest_surface().is_none());
    }
}
