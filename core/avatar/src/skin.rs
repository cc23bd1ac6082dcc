//! Which Gaussians are facial skin: close to the skin of the head mesh and facing forward (paper, Methods).
//!
//! Canonical space. Differs from the paper in that the distance is to the nearest point of the mesh, not to its nearest
//! vertex, so the threshold does not depend on how finely a head is tessellated; and in that lips, eyes, brows, ears,
//! scalp and neck are left out by the mesh's own labels, and strands of hair over the skin by their darkness.

use std::collections::HashMap;

use glam::Vec3;
use heartian_face::{HeadModel, Region};
use heartian_space::Skin;
use heartian_space::color::luminance;
use rayon::prelude::*;

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::canonical::Canonical;

/// What counts as facial skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkinOptions {
    /// Largest distance to the mesh, metres, in (0, 0.1].
    pub threshold_metres: f32,
    /// Least z component of the outward unit normal in head space: 1 is straight ahead, 0 is sideways.
    pub least_facing: f32,
    /// Least opacity: what is nearly invisible carries no pulse.
    pub least_opacity: f32,
    /// Least luminance of the albedo relative to the median of the selection: excludes hair, brows and nostrils.
    pub least_relative_luminance: f32,
}

impl Default for SkinOptions {
    fn default() -> Self {
        Self { threshold_metres: 0.01, least_facing: 0.35, least_opacity: 0.05, least_relative_luminance: 0.45 }
    }
}

/// Selects the facial skin of an avatar. `head` is the neutral head with the person's identity baked in.
///
/// # Errors
/// When the threshold is out of range, or nothing is selected; the message says at which step.
pub fn select_skin(avatar: &Avatar, head: &HeadModel, options: &SkinOptions) -> Result<Skin, AvatarError> {
    let threshold = options.threshold_metres;
    if !(threshold > 0.0 && threshold <= 0.1) {
        let value = f64::from(threshold);
        return Err(AvatarError::Option { name: "threshold_metres", value, range: "in (0, 0.1]" });
    }
    let canonical = &avatar.canonical;
    let near = NearMesh::new(head, threshold);
    let hits: Vec<Option<Hit>> =
        (0..canonical.len()).into_par_iter().map(|index| near.nearest(canonical.position(index))).collect();
    let close = hits.iter().flatten().count();
    let mut chosen: Vec<(u32, f32)> = hits
        .iter()
        .enumerate()
        .filter_map(|(index, hit)| hit.as_ref().map(|hit| (index, hit)))
        .filter(|(index, hit)| is_facial(canonical, head, *index, hit, options))
        .map(|(index, hit)| (index as u32, hit.distance))
        .collect();
    let facing = chosen.len();
    drop_dark(canonical, options.least_relative_luminance, &mut chosen);
    if chosen.is_empty() {
        return Err(AvatarError::NoSkin { total: canonical.len(), close, facing, threshold_metres: threshold });
    }
    let gaussians: Vec<u32> = chosen.iter().map(|(index, _)| *index).collect();
    let skin = Skin {
        positions: normalised_positions(canonical, &gaussians),
        green_albedo: gaussians.iter().map(|&index| canonical.albedo(index as usize)[1]).collect(),
        distances_metres: chosen.iter().map(|(_, distance)| *distance).collect(),
        gaussians,
        ..Skin::default()
    };
    Ok(skin.checked()?)
}

fn is_facial(canonical: &Canonical, head: &HeadModel, index: usize, hit: &Hit, options: &SkinOptions) -> bool {
    let triangle = head.triangles[hit.triangle as usize];
    let skin = triangle.iter().all(|vertex| head.regions[*vertex as usize] == Region::Skin);
    // The third axis has no sign of its own; the mesh says which way is out.
    let normal = Vec3::from_array(canonical.normal(index));
    let outward = if normal.dot(hit.normal) < 0.0 { -normal } else { normal };
    let facing = outward.z >= options.least_facing && hit.normal.z >= options.least_facing;
    skin && facing && canonical.opacity(index) >= options.least_opacity
}

fn drop_dark(canonical: &Canonical, least_relative: f32, chosen: &mut Vec<(u32, f32)>) {
    let value = |index: u32| luminance(canonical.albedo(index as usize));
    let mut luminances: Vec<f32> = chosen.iter().map(|(index, _)| value(*index)).collect();
    if luminances.is_empty() {
        return;
    }
    let middle = luminances.len() / 2;
    let median = *luminances.select_nth_unstable_by(middle, f32::total_cmp).1;
    chosen.retain(|(index, _)| value(*index) >= least_relative * median);
}

/// Positions scaled into [−1, 1] along each axis over the selection; 0 along an axis without extent.
fn normalised_positions(canonical: &Canonical, gaussians: &[u32]) -> Vec<[f32; 3]> {
    let positions: Vec<Vec3> =
        gaussians.iter().map(|&index| Vec3::from_array(canonical.position(index as usize))).collect();
    let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let high = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    let (centre, half) = (0.5 * (low + high), 0.5 * (high - low));
    let scaled = |p: Vec3| {
        let p = (p - centre) / half.max(Vec3::splat(1e-9));
        p.clamp(Vec3::NEG_ONE, Vec3::ONE).to_array()
    };
    positions.into_iter().map(scaled).collect()
}

/// The nearest point of the mesh.
struct Hit {
    triangle: u32,
    distance: f32,
    /// Outward unit normal of the triangle.
    normal: Vec3,
}

/// Triangles by the grid cells that they come within the threshold of.
struct NearMesh<'a> {
    head: &'a HeadModel,
    cell_metres: f32,
    threshold: f32,
    cells: HashMap<[i32; 3], Vec<u32>>,
}

impl<'a> NearMesh<'a> {
    fn new(head: &'a HeadModel, threshold: f32) -> Self {
        let mut near = Self { head, cell_metres: threshold.max(0.01), threshold, cells: HashMap::new() };
        for index in 0..head.triangles.len() {
            let [a, b, c] = near.corners(index);
            let low = near.cell((a.min(b).min(c) - threshold).to_array());
            let high = near.cell((a.max(b).max(c) + threshold).to_array());
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        near.cells.entry([x, y, z]).or_default().push(index as u32);
                    }
                }
            }
        }
        near
    }

    fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.head.triangles[triangle].map(|vertex| Vec3::from_array(self.head.vertices[vertex as usize]))
    }

    fn cell(&self, position: [f32; 3]) -> [i32; 3] {
        position.map(|v| (v / self.cell_metres).floor() as i32)
    }

    /// The nearest point within the threshold.
    fn nearest(&self, position: [f32; 3]) -> Option<Hit> {
        let point = Vec3::from_array(position);
        let mut best: Option<(u32, f32)> = None;
        for &triangle in self.cells.get(&self.cell(position))? {
            let distance = closest_on_triangle(point, self.corners(triangle as usize)).distance(point);
            if distance <= self.threshold && best.is_none_or(|(_, least)| distance < least) {
                best = Some((triangle, distance));
            }
        }
        best.map(|(triangle, distance)| {
            let [a, b, c] = self.corners(triangle as usize);
            Hit { triangle, distance, normal: (b - a).cross(c - a).normalize_or_zero() }
        })
    }
}

/// Closest point of a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
fn closest_on_triangle(p: Vec3, [a, b, c]: [Vec3; 3]) -> Vec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3).max(f32::MIN_POSITIVE));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6).max(f32::MIN_POSITIVE));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)).max(f32::MIN_POSITIVE));
    }
    let sum = (va + vb + vc).max(f32::MIN_POSITIVE);
    a + ab * (vb / sum) + ac * (vc / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closest_point_is_no_farther_than_any_sampled_one() {
        let corners = [Vec3::new(0.0, 0.0, 0.0), Vec3::new(1.0, 0.2, 0.1), Vec3::new(0.3, 0.9, -0.2)];
        for i in 0..200 {
            let p = Vec3::new(
                (i * 37 % 41) as f32 / 15.0 - 1.0,
                (i * 17 % 43) as f32 / 15.0 - 1.0,
                (i % 7) as f32 / 4.0 - 0.8,
            );
            let closest = closest_on_triangle(p, corners);
            let mut least = f32::INFINITY;
            for u in 0..=60 {
                for v in 0..=60 - u {
                    let (u, v) = (u as f32 / 60.0, v as f32 / 60.0);
                    let q = corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v;
                    least = least.min(q.distance(p));
                }
            }
            assert!(closest.distance(p) <= least + 1e-5 && closest.distance(p) >= least - 0.03, "{p}");
        }
    }
}
