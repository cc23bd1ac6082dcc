//! How much of the sky each vertex sees: precomputed once a head, so that soft shadows cost a dot product a light.
//!
//! The surface is drawn from directions spread over the sphere; what each vertex does not see is stored in real
//! spherical harmonics up to degree 3 (as in precomputed radiance transfer, Sloan et al. 2002), in the frame of the
//! vertices given. Below a vertex's horizon, where the cosine is zero and the value is free, occlusion is continued by
//! reflection, which keeps the harmonics from ringing; where nothing occludes, visibility is exactly 1.

use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;

use super::raster::{ONE_SAMPLE, ScreenVertex, VisibilityBuffer};

/// Number of real spherical harmonics up to degree 3.
pub const VISIBILITY_TERMS: usize = 16;
/// Views of the surface; neighbouring ones are about 15° apart.
const DIRECTIONS: usize = 192;
/// Size of one view: about 2 mm a pixel on a head.
const VIEW_PX: usize = 176;
/// A vertex is tested this far above its surface and occluded only by what is this much nearer, as a fraction of the
/// surface's radius: 1.5 mm on a head.
const LIFT: f32 = 0.01;

/// Occlusion of every vertex.
#[derive(Clone, Debug, PartialEq)]
pub struct Transfer {
    /// Harmonic coefficients of occlusion (1 − visibility) over directions.
    pub occlusion: Vec<[f32; VISIBILITY_TERMS]>,
    /// Cosine-weighted visible fraction of the upper hemisphere, in [0, 1].
    pub openness: Vec<f32>,
}

impl Transfer {
    /// Draws the surface from all sides and gathers what each vertex sees.
    pub fn new(vertices: &[Vec3], normals: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let low = vertices.iter().copied().fold(Vec3::MAX, Vec3::min);
        let high = vertices.iter().copied().fold(Vec3::MIN, Vec3::max);
        let bounds = Bounds { centre: (low + high) / 2.0, radius: ((high - low).length() / 2.0).max(1e-6) };
        let directions: Vec<Vec3> = (0..DIRECTIONS).map(spiral_direction).collect();
        let seen: Vec<Vec<bool>> =
            directions.par_iter().map(|&direction| bounds.seen_from(direction, vertices, normals, triangles)).collect();
        let (occlusion, openness) = (0..vertices.len())
            .into_par_iter()
            .map(|vertex| gather(normals[vertex], &directions, |view: usize| seen[view][vertex]))
            .unzip();
        Self { occlusion, openness }
    }

    /// Visible fraction of a round light, in [0, 1]; `basis` is [`visibility_basis`] of the light in the vertices' frame.
    pub fn visibility(&self, vertex: usize, basis: &[f32; VISIBILITY_TERMS]) -> f32 {
        let occluded: f32 = self.occlusion[vertex].iter().zip(basis).map(|(a, b)| a * b).sum();
        1.0 - occluded.clamp(0.0, 1.0)
    }
}

/// The harmonics averaged over a disc of `half_angle_radians` about a unit `direction`.
pub fn visibility_basis(direction: Vec3, half_angle_radians: f32) -> [f32; VISIBILITY_TERMS] {
    let c = half_angle_radians.cos();
    let by_degree = [1.0, (1.0 + c) / 2.0, c * (1.0 + c) / 2.0, (5.0 * c * c - 1.0) * (1.0 + c) / 8.0];
    let mut basis = harmonics(direction);
    for (term, value) in basis.iter_mut().enumerate() {
        *value *= by_degree[(term as f32).sqrt() as usize];
    }
    basis
}

struct Bounds {
    centre: Vec3,
    radius: f32,
}

impl Bounds {
    fn seen_from(&self, direction: Vec3, vertices: &[Vec3], normals: &[Vec3], triangles: &[[u32; 3]]) -> Vec<bool> {
        let right = direction.any_orthonormal_vector();
        let view_from_head = Mat3::from_cols(right, direction.cross(right), direction).transpose();
        let scale = (VIEW_PX as f32 / 2.0 - 2.0) / self.radius;
        let to_screen = |point: Vec3| {
            let point_in_view = view_from_head * (point - self.centre);
            let position_px = Vec2::new(point_in_view.x, point_in_view.y) * scale + VIEW_PX as f32 / 2.0;
            ScreenVertex { position_px, nearness: point_in_view.z }
        };
        let mut view = VisibilityBuffer::new(VIEW_PX, VIEW_PX, ONE_SAMPLE);
        view.draw(&vertices.iter().map(|vertex| to_screen(*vertex)).collect::<Vec<_>>(), triangles);
        let lift = LIFT * self.radius;
        vertices
            .iter()
            .zip(normals)
            .map(|(vertex, normal)| {
                if normal.dot(direction) <= 0.0 {
                    return false;
                }
                let at = to_screen(*vertex + *normal * lift);
                let limit = VIEW_PX as f32 - 1.0;
                let [x, y] = at.position_px.to_array().map(|p| p.clamp(0.0, limit) as usize);
                view.nearness(x, y) <= at.nearness + lift
            })
            .collect()
    }
}

fn gather(normal: Vec3, directions: &[Vec3], is_seen: impl Fn(usize) -> bool) -> ([f32; VISIBILITY_TERMS], f32) {
    let mut occlusion = [0.0f32; VISIBILITY_TERMS];
    let (mut open, mut all) = (0.0f32, 0.0f32);
    for (view, direction) in directions.iter().enumerate() {
        let cosine = normal.dot(*direction);
        if cosine <= 0.0 {
            continue;
        }
        all += cosine;
        if is_seen(view) {
            open += cosine;
            continue;
        }
        let (above, below) = (harmonics(*direction), harmonics(*direction - 2.0 * cosine * normal));
        for term in 0..VISIBILITY_TERMS {
            occlusion[term] += above[term] + below[term];
        }
    }
    let weight = 4.0 * std::f32::consts::PI / directions.len() as f32;
    (occlusion.map(|sum| sum * weight), if all > 0.0 { open / all } else { 0.0 })
}

/// Directions spread evenly over the sphere on a Fibonacci spiral.
fn spiral_direction(index: usize) -> Vec3 {
    const GOLDEN_ANGLE: f32 = 2.399_963_2;
    let y = 1.0 - 2.0 * (index as f32 + 0.5) / DIRECTIONS as f32;
    let (sin, cos) = (index as f32 * GOLDEN_ANGLE).sin_cos();
    let radius = (1.0 - y * y).sqrt();
    Vec3::new(radius * cos, y, radius * sin)
}

/// Orthonormal real spherical harmonics of degrees 0 to 3 at a unit vector.
fn harmonics(direction: Vec3) -> [f32; VISIBILITY_TERMS] {
    let Vec3 { x, y, z } = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_8,
        0.488_602_5 * y,
        0.488_602_5 * z,
        0.488_602_5 * x,
        1.092_548_4 * x * y,
        1.092_548_4 * y * z,
        0.315_391_57 * (3.0 * zz - 1.0),
        1.092_548_4 * x * z,
        0.546_274_2 * (xx - yy),
        0.590_043_6 * y * (3.0 * xx - yy),
        2.890_611_4 * x * y * z,
        0.457_045_8 * y * (5.0 * zz - 1.0),
        0.373_176_33 * z * (5.0 * zz - 3.0),
        0.457_045_8 * x * (5.0 * zz - 1.0),
        1.445_305_7 * z * (xx - yy),
        0.590_043_6 * x * (xx - 3.0 * yy),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_are_orthonormal() {
        let count = 20_000;
        let mut gram = [[0.0f64; VISIBILITY_TERMS]; VISIBILITY_TERMS];
        for index in 0..count {
            let y = 1.0 - 2.0 * (f64::from(index) + 0.5) / f64::from(count);
            let (sin, cos) = (f64::from(index) * 2.399_963_229_728_653).sin_cos();
            let r = (1.0 - y * y).sqrt();
            let values = harmonics(Vec3::new((r * cos) as f32, y as f32, (r * sin) as f32));
            for (row, a) in gram.iter_mut().zip(values) {
                for (cell, b) in row.iter_mut().zip(values) {
                    *cell += f64::from(a * b) * 4.0 * std::f64::consts::PI / f64::from(count);
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, cell) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((cell - expected).abs() < 1e-3, "({i}, {j}): {cell}");
            }
        }
    }

    /// A floor with a wall: a point on the floor near the wall loses the light behind the wall and keeps the rest.
    #[test]
    fn a_wall_shadows_what_lies_behind_it_and_only_that() {
        let mut vertices = Vec::new();
        let mut triangles = Vec::new();
        let mut quad = |origin: Vec3, u: Vec3, v: Vec3| {
            let base = vertices.len() as u32;
            vertices.extend([origin, origin + u, origin + u + v, origin + v]);
            triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        };
        quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0);
        quad(Vec3::new(0.2, 0.0, -1.0), Vec3::Z * 2.0, Vec3::Y);
        vertices.push(Vec3::ZERO);
        vertices.push(Vec3::new(-0.9, 0.0, 0.0));
        let normals = vec![Vec3::Y; vertices.len()];
        let transfer = Transfer::new(&vertices, &normals, &triangles);
        let light = |x: f32| visibility_basis(Vec3::new(x, 0.8, 0.0).normalize(), 0.5);
        let near_wall = vertices.len() - 2;
        assert!(transfer.visibility(near_wall, &light(1.0)) < 0.2);
        assert!(transfer.visibility(near_wall, &light(-1.0)) > 0.9);
        assert!(transfer.openness[near_wall] < transfer.openness[near_wall + 1]);
        assert!(transfer.openness[near_wall + 1] > 0.85);
    }

    #[test]
    fn a_lone_plane_is_fully_open() {
        let vertices = [Vec3::ZERO, Vec3::Z, Vec3::X, Vec3::new(1.0, 0.0, 1.0), Vec3::new(0.3, 0.0, 0.3)];
        let transfer = Transfer::new(&vertices, &[Vec3::Y; 5], &[[0, 1, 3], [0, 3, 2]]);
        assert_eq!(transfer.openness, [1.0; 5]);
        assert_eq!(transfer.visibility(4, &visibility_basis(Vec3::new(0.6, 0.8, 0.0), 0.3)), 1.0);
    }
}
