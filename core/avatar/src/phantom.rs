//! Test data: a ball for a head, with a skin front, filmed by the mesh rasteriser (not by the Gaussians).

use glam::Vec3;
use heartian_face::{Basis, FramePose, HeadModel, Region, Track};
use heartian_space::color::{quantise, srgb_from_linear};
use heartian_space::{Camera, Clip, Sequence};

use crate::surface::{MeshView, NOTHING};

const RINGS: usize = 16;
const SECTORS: usize = 24;
const RADIUS_METRES: f32 = 0.1;

/// A ball of skin in front and scalp behind, with one expression mode that moves its lower half down.
pub(crate) fn head() -> HeadModel {
    let mut vertices = Vec::new();
    for ring in 0..=RINGS {
        for sector in 0..SECTORS {
            let (theta, phi) = (
                std::f32::consts::PI * (ring as f32 + 0.01) / (RINGS as f32 + 0.02),
                std::f32::consts::TAU * sector as f32 / SECTORS as f32,
            );
            let unit = [theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos()];
            vertices.push(unit.map(|u| RADIUS_METRES * u));
        }
    }
    let mut triangles = Vec::new();
    for ring in 0..RINGS {
        for sector in 0..SECTORS {
            let at = |r: usize, s: usize| (r * SECTORS + s % SECTORS) as u32;
            let (a, b, c, d) = (at(ring, sector), at(ring, sector + 1), at(ring + 1, sector), at(ring + 1, sector + 1));
            triangles.push([a, c, b]);
            triangles.push([b, c, d]);
        }
    }
    let regions = vertices.iter().map(|v| if v[2] > 0.02 { Region::Skin } else { Region::Scalp }).collect();
    let mode = vertices.iter().flat_map(|v| [0.0, if v[1] < 0.0 { -0.01 } else { 0.0 }, 0.0]).collect();
    let count = vertices.len();
    HeadModel {
        name: "ball".into(),
        regions,
        triangles,
        identity: Basis::default(),
        expression: Basis { count: 1, data: mode },
        eyelids: Basis { count: 2, data: vec![0.0; 2 * 3 * count] },
        joints: vec![[0.0; 3], [0.0, -0.05, 0.0], [0.0, -0.02, 0.02], [0.03, 0.03, 0.05], [-0.03, 0.03, 0.05]],
        joint_identity: Vec::new(),
        parents: [-1, 0, 1, 1, 1],
        weights: vec![[1.0, 0.0, 0.0, 0.0, 0.0]; count],
        landmarks: Vec::new(),
        vertices,
    }
}

/// The ball turning and breathing for `frames` frames of `size × size`, and the poses that were filmed.
pub(crate) fn recording(size: usize, frames: usize) -> (Clip, Track) {
    recording_of(&head(), size, frames)
}

/// The same of another head of the same make.
pub(crate) fn recording_of(head: &HeadModel, size: usize, frames: usize) -> (Clip, Track) {
    let camera = Camera::at_origin(size, size, 3.2 * size as f32);
    let times_seconds: Vec<f64> = (0..frames).map(|t| t as f64 / 25.0).collect();
    let poses: Vec<FramePose> = (0..frames)
        .map(|t| {
            let phase = t as f32 * 0.37;
            FramePose {
                rotation: [0.03 * (1.3 * phase).cos(), 0.12 * phase.sin(), 0.0],
                translation: [0.004 * phase.cos(), 0.002, -1.0],
                expression: vec![0.5 + 0.5 * (0.8 * phase).sin()],
                fitted: true,
                ..FramePose::rest(1)
            }
        })
        .collect();
    let mut sequence = Sequence { frames: Vec::new(), alpha: Vec::new(), times_seconds: times_seconds.clone() };
    for pose in &poses {
        let posed = head.pose(pose);
        let view = MeshView::new(&posed, &head.triangles, &camera);
        for pixel in 0..size * size {
            let color = color(head, &posed, &view, pixel);
            sequence.alpha.push(if color.is_some() { 255 } else { 0 });
            sequence.frames.extend(color.unwrap_or([0.0; 3]).map(|c| quantise(srgb_from_linear(c))));
        }
    }
    let clip = Clip::new("input", size, size, sequence).unwrap_or_else(|error| panic!("{error}"));
    let track = Track {
        head: head.clone(),
        identity: Vec::new(),
        camera,
        frames: poses,
        times_seconds,
        sigma: heartian_face::TrackSigma::default(),
        landmark_rms_px: 0.0,
        interocular_px: size as f32 as f64 / 4.0,
    };
    (clip, track)
}

/// Linear colour of a pixel: checkered skin or dark hair under one lamp; `None` off the ball.
fn color(head: &HeadModel, posed: &[[f32; 3]], view: &MeshView, pixel: usize) -> Option<[f32; 3]> {
    let triangle = view.triangle[pixel];
    if triangle == NOTHING {
        return None;
    }
    let corners = head.triangles[triangle as usize];
    let [u, v] = view.barycentric[pixel];
    let blend = |of: &dyn Fn(usize) -> Vec3| {
        let [a, b, c] = corners.map(|vertex| of(vertex as usize));
        a * u + b * v + c * (1.0 - u - v)
    };
    let rest = blend(&|vertex| Vec3::from_array(head.vertices[vertex]));
    let [a, b, c] = corners.map(|vertex| Vec3::from_array(posed[vertex as usize]));
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let lamp = 0.35 + 0.65 * normal.dot(Vec3::new(0.4, 0.5, 0.77)).max(0.0);
    let checker = ((rest.x * 60.0).floor() + (rest.y * 60.0).floor()).rem_euclid(2.0);
    let albedo = if rest.z > 0.02 { Vec3::new(0.6, 0.4, 0.3) * (0.8 + 0.2 * checker) } else { Vec3::splat(0.08) };
    Some((albedo * lamp).to_array())
}
