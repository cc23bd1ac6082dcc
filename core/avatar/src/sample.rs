//! Points on a head: denser where the camera looks longer and where a face needs detail, none where it never looks.
//!
//! A triangle's share is the area it covers in the pictures (mean and maximum over some training frames, so that teeth
//! seen in a few frames get theirs), times a weight of its region. The draw is systematic and the points in a triangle
//! follow a low-discrepancy sequence: no random number is used, and equal inputs give equal points.

use glam::Vec3;
use heartian_face::{HeadModel, Region};

use crate::surface::{MeshView, NOTHING};

/// A point of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Triangle it lies in.
    pub triangle: u32,
    /// Barycentric coordinates there.
    pub barycentric: [f32; 3],
    /// Distance to its neighbours in canonical space, metres: the root of the area that is its own.
    pub spacing_metres: f32,
}

/// How much more densely a region is sampled than its picture area asks for.
fn detail(region: Region) -> f32 {
    match region {
        Region::EyeLeft | Region::EyeRight => 3.0,
        Region::Lips | Region::Brow | Region::Mouth => 1.8,
        Region::Skin => 1.2,
        Region::Ear => 1.0,
        Region::Scalp | Region::Neck => 0.8,
    }
}

/// Region of a triangle: that of two of its corners, else the first corner's.
pub fn triangle_region(head: &HeadModel, triangle: [u32; 3]) -> Region {
    let [a, b, c] = triangle.map(|vertex| head.regions[vertex as usize]);
    if b == c { b } else { a }
}

/// Twice-signed area vector of a triangle: normal direction, length = 2·area.
fn area_vector(head: &HeadModel, triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|vertex| Vec3::from_array(head.vertices[vertex as usize]));
    (b - a).cross(c - a)
}

/// Share of each triangle, not normalised: picture area in pixels times the region's weight.
pub fn triangle_shares(head: &HeadModel, views: &[MeshView]) -> Vec<f32> {
    let mut mean = vec![0.0f32; head.triangles.len()];
    let mut most = mean.clone();
    for view in views {
        let mut seen = vec![0.0f32; head.triangles.len()];
        for &triangle in view.triangle.iter().filter(|t| **t != NOTHING) {
            seen[triangle as usize] += 1.0;
        }
        for (index, pixels) in seen.into_iter().enumerate() {
            mean[index] += pixels / views.len() as f32;
            most[index] = most[index].max(pixels);
        }
    }
    let share = |(index, triangle): (usize, &[u32; 3])| {
        (0.6 * mean[index] + 0.4 * most[index]) * detail(triangle_region(head, *triangle))
    };
    head.triangles.iter().enumerate().map(share).collect()
}

/// Whether a region is of the outside of the head; the others are seen through lids and lips alone.
pub fn is_outside(region: Region) -> bool {
    !matches!(region, Region::EyeLeft | Region::EyeRight | Region::Mouth)
}

/// Lifts shares so that of `count` points no stretch of the outside of the head gets less than one in a square of side
/// `spacing_metres`, as long as that takes no more than half of the points. `keep` says how much of each triangle is wanted.
pub fn cover_outside(head: &HeadModel, shares: &mut [f32], keep: &[f32], (count, spacing_metres): (usize, f32)) {
    let wanted: Vec<f32> = head
        .triangles
        .iter()
        .zip(keep)
        .map(|(triangle, keep)| {
            let outside = is_outside(triangle_region(head, *triangle)) && *keep > 0.0;
            if outside { 0.5 * area_vector(head, *triangle).length() / spacing_metres.powi(2) } else { 0.0 }
        })
        .collect();
    let whole: f32 = wanted.iter().sum();
    let most = 0.5 * count as f32;
    let thinned = if whole > most { most / whole } else { 1.0 };
    // Points that a unit of share is worth; what is lifted takes from all others, so this settles in a few rounds.
    let start = shares.to_vec();
    for _ in 0..8 {
        let total: f32 = shares.iter().sum();
        let per_point = total / count.max(1) as f32;
        if !(per_point > 0.0) {
            return;
        }
        for ((share, start), wanted) in shares.iter_mut().zip(&start).zip(&wanted) {
            *share = start.max(thinned * wanted * per_point);
        }
    }
}

/// Draws about `count` points, in order of their triangles. Empty when no triangle has a share.
pub fn sample_surface(head: &HeadModel, shares: &[f32], count: usize) -> Vec<SurfacePoint> {
    let total: f64 = shares.iter().map(|share| f64::from(*share)).sum();
    if !(total > 0.0) {
        return Vec::new();
    }
    let mut points = Vec::with_capacity(count + 1);
    let mut reached = 0.5;
    for (index, (triangle, share)) in head.triangles.iter().zip(shares).enumerate() {
        let before = reached;
        reached += f64::from(*share) * count as f64 / total;
        let here = reached.floor() as usize - f64::floor(before) as usize;
        if here == 0 {
            continue;
        }
        let area = 0.5 * area_vector(head, *triangle).length();
        let density = f64::from(*share) * count as f64 / total / f64::from(area).max(1e-12);
        let spacing_metres = (1.0 / density.max(1e-12)).sqrt() as f32;
        for _ in 0..here {
            let barycentric = folded_barycentric(points.len());
            points.push(SurfacePoint { triangle: index as u32, barycentric, spacing_metres });
        }
    }
    points
}

/// The `n`-th point of Roberts' R2 sequence, folded from the unit square into a triangle.
fn folded_barycentric(n: usize) -> [f32; 3] {
    // 1/ρ and 1/ρ² of the plastic number ρ.
    let (u, v) = ((0.754_877_666_246_693 * n as f64).fract(), (0.569_840_290_998_053 * n as f64).fract());
    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
    [(1.0 - u - v) as f32, u as f32, v as f32]
}

/// A per-vertex quantity at a surface point.
pub fn at_point<const N: usize>(head: &HeadModel, point: &SurfacePoint, value: impl Fn(usize) -> [f32; N]) -> [f32; N] {
    let mut out = [0.0; N];
    for (vertex, weight) in head.triangles[point.triangle as usize].iter().zip(point.barycentric) {
        for (to, from) in out.iter_mut().zip(value(*vertex as usize)) {
            *to += weight * from;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_face::Basis;

    fn plate() -> HeadModel {
        HeadModel {
            name: "plate".into(),
            vertices: vec![[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            regions: vec![Region::Skin; 4],
            identity: Basis::default(),
            expression: Basis::default(),
            eyelids: Basis::default(),
            joints: vec![[0.0; 3]; 5],
            joint_identity: Vec::new(),
            parents: [-1, 0, 1, 1, 1],
            weights: vec![[1.0, 0.0, 0.0, 0.0, 0.0]; 4],
            landmarks: Vec::new(),
        }
    }

    #[test]
    fn points_follow_the_shares_and_stay_inside() {
        let head = plate();
        let points = sample_surface(&head, &[3.0, 1.0], 400);
        let first = points.iter().filter(|p| p.triangle == 0).count();
        assert!(points.len().abs_diff(400) <= 1 && first.abs_diff(300) <= 1, "{} {first}", points.len());
        for point in &points {
            assert!(point.barycentric.iter().all(|b| (0.0..=1.0).contains(b)));
            let [x, y, _] = at_point(&head, point, |vertex| head.vertices[vertex]);
            assert!((0.0..=0.1001).contains(&x) && (0.0..=0.1001).contains(&y));
        }
        // 300 points on half of a square decimetre.
        assert!((points[0].spacing_metres - (0.005f32 / 300.0).sqrt()).abs() < 1e-4);
        assert!(sample_surface(&head, &[0.0, 0.0], 10).is_empty());
    }
}
