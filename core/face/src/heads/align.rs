//! Landmarks for a head that brings none: the built-in head's are laid on its surface.
//!
//! A similarity from the eyeballs, then rounds of a smooth warp: each landmark asks for its nearest point on the skin, and
//! a Gaussian kernel of shrinking reach spreads what they ask for; a landmark ends on the nearest triangle. Lips and lids
//! keep to their own side of the slit by the jaw's weight and the height. A head's own embedding is better where there
//! is one: this is good to a few millimetres.

use glam::Vec3;

use crate::HeadModel;
use crate::model::{LandmarkAnchor, Region, joint};

/// Reach of the warp in each round, metres.
const REACH: [f32; 5] = [0.060, 0.040, 0.028, 0.020, 0.014];

fn vector(p: [f32; 3]) -> Vec3 {
    Vec3::from_array(p)
}

/// The landmarks on a head whose eye joints, jaw weights and surface are in place.
pub fn landmarks(head: &HeadModel) -> Vec<LandmarkAnchor> {
    let source = HeadModel::procedural();
    let surface = Surface::new(head);
    if surface.triangles.is_empty() {
        return Vec::new();
    }
    let [from, to] =
        [&source, head].map(|model| [joint::EYE_LEFT, joint::EYE_RIGHT].map(|eye| vector(model.joints[eye])));
    let scale = (to[0] - to[1]).length() / (from[0] - from[1]).length();
    let place = |p: [f32; 3]| (to[0] + to[1]) / 2.0 + (vector(p) - (from[0] + from[1]) / 2.0) * scale;
    let mut points: Vec<Vec3> =
        source.landmarks.iter().map(|anchor| place(source.landmark_position(anchor, &source.vertices))).collect();
    let jaw: Vec<f32> = source.landmarks.iter().map(|anchor| jaw_weight(&source, anchor)).collect();
    for reach in REACH {
        let asked: Vec<Vec3> =
            points.iter().zip(&jaw).map(|(point, jaw)| surface.nearest(*point, *jaw).point - *point).collect();
        points = warped(&points, &asked, reach);
    }
    source
        .landmarks
        .iter()
        .zip(points.iter().zip(&jaw))
        .map(|(anchor, (point, jaw))| {
            let found = surface.nearest(*point, *jaw);
            LandmarkAnchor { index: anchor.index, triangle: found.triangle, barycentric: found.barycentric }
        })
        .collect()
}

fn jaw_weight(head: &HeadModel, anchor: &LandmarkAnchor) -> f32 {
    let corners = head.triangles[anchor.triangle as usize];
    (0..3).map(|k| anchor.barycentric[k] * head.weights[corners[k] as usize][joint::JAW]).sum()
}

/// Points moved by the kernel-weighted mean of what they and their neighbours ask for.
fn warped(points: &[Vec3], asked: &[Vec3], reach: f32) -> Vec<Vec3> {
    points
        .iter()
        .map(|point| {
            let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
            for (other, shift) in points.iter().zip(asked) {
                let weight = (-(*other - *point).length_squared() / (2.0 * reach * reach)).exp();
                sum += *shift * weight;
                weights += weight;
            }
            *point + sum / weights.max(1e-6)
        })
        .collect()
}

/// The front of a head's skin.
struct Surface {
    /// Number, corners, and how much the triangle follows the jaw.
    triangles: Vec<(u32, [Vec3; 3], f32)>,
}

struct Hit {
    point: Vec3,
    triangle: u32,
    barycentric: [f32; 3],
}

impl Surface {
    fn new(head: &HeadModel) -> Self {
        let eyes = (head.joints[joint::EYE_LEFT][2] + head.joints[joint::EYE_RIGHT][2]) / 2.0;
        let rigid = |vertex: u32| {
            let row = head.weights[vertex as usize];
            row[joint::EYE_LEFT].max(row[joint::EYE_RIGHT]) > 0.9
                || matches!(head.regions[vertex as usize], Region::EyeLeft | Region::EyeRight | Region::Mouth)
        };
        let triangles = head.triangles.iter().enumerate().filter_map(|(number, corners)| {
            let places = corners.map(|vertex| vector(head.vertices[vertex as usize]));
            let centre = (places[0] + places[1] + places[2]) / 3.0;
            let normal = (places[1] - places[0]).cross(places[2] - places[0]);
            // What faces backward (the inside of lips and lids) or lies behind the ears is no face.
            let outward = normal.dot(centre - Vec3::new(0.0, centre.y, eyes - 0.07)) > 0.0;
            let front = centre.z > eyes - 0.085;
            let jaw = corners.iter().map(|vertex| head.weights[*vertex as usize][joint::JAW]).sum::<f32>() / 3.0;
            let fine = outward && front && normal.length_squared() > 0.0 && !corners.iter().any(|v| rigid(*v));
            fine.then_some((number as u32, places, jaw))
        });
        Self { triangles: triangles.collect() }
    }

    /// The nearest point of the skin; triangles on the other side of the jaw's slit count as farther.
    fn nearest(&self, point: Vec3, jaw: f32) -> Hit {
        let mut best = (f32::INFINITY, Hit { point, triangle: 0, barycentric: [1.0, 0.0, 0.0] });
        for (triangle, corners, own) in &self.triangles {
            let (found, barycentric) = closest(point, corners);
            let apart = 0.012 * ((own - jaw).abs() - 0.35).max(0.0);
            let distance = (found - point).length() + apart;
            if distance < best.0 {
                best = (distance, Hit { point: found, triangle: *triangle, barycentric });
            }
        }
        best.1
    }
}

/// The point of a triangle nearest to `p`, and its barycentric coordinates.
fn closest(p: Vec3, [a, b, c]: &[Vec3; 3]) -> (Vec3, [f32; 3]) {
    let (ab, ac) = (*b - *a, *c - *a);
    let (d00, d01, d11) = (ab.dot(ab), ab.dot(ac), ac.dot(ac));
    let (d20, d21) = ((p - *a).dot(ab), (p - *a).dot(ac));
    let area = d00 * d11 - d01 * d01;
    if area > 0.0 {
        let (v, w) = ((d11 * d20 - d01 * d21) / area, (d00 * d21 - d01 * d20) / area);
        if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
            return (*a + ab * v + ac * w, [1.0 - v - w, v, w]);
        }
    }
    // Outside: the nearest of the three edges.
    let corners = [*a, *b, *c];
    let edge = |from: usize| {
        let to = (from + 1) % 3;
        let along = corners[to] - corners[from];
        let share = ((p - corners[from]).dot(along) / along.length_squared().max(1e-20)).clamp(0.0, 1.0);
        let mut barycentric = [0.0; 3];
        (barycentric[from], barycentric[to]) = (1.0 - share, share);
        (corners[from] + along * share, barycentric)
    };
    let far = |hit: &(Vec3, [f32; 3])| (hit.0 - p).length_squared();
    let (first, second, third) = (edge(0), edge(1), edge(2));
    let nearer = if far(&second) < far(&first) { second } else { first };
    if far(&third) < far(&nearer) { third } else { nearer }
}
