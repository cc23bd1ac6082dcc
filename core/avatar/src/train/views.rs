//! What a fit looks at before its first step: some frames, and the Gaussians that lie on skin.

use glam::Vec3;
use heartian_face::{HeadModel, Region, Track};

use crate::canonical::Canonical;

/// Frames looked at when the Gaussians are laid out.
const VIEWS: usize = 24;

/// Evenly spread training frames, and those in which the jaw is widest open and the head turned farthest.
pub(super) fn views(track: &Track, training: usize) -> Vec<usize> {
    let mut frames: Vec<usize> = (0..VIEWS.min(training)).map(|i| i * training / VIEWS.min(training)).collect();
    let extreme = |value: &dyn Fn(usize) -> f32| (0..training).max_by(|&a, &b| value(a).total_cmp(&value(b)));
    let pose = |frame: usize| &track.frames[frame];
    frames.extend(extreme(&|frame| pose(frame).jaw[0]));
    frames.extend(extreme(&|frame| pose(frame).rotation[1]));
    frames.extend(extreme(&|frame| -pose(frame).rotation[1]));
    frames.sort_unstable();
    frames.dedup();
    frames
}

/// Gaussians whose nearest vertex of the mesh is skin, closer than a centimetre.
pub(super) fn skin_like(head: &HeadModel, canonical: &Canonical) -> Vec<usize> {
    let vertices: Vec<(Vec3, bool)> = head
        .vertices
        .iter()
        .zip(&head.regions)
        .map(|(vertex, region)| (Vec3::from_array(*vertex), *region == Region::Skin))
        .collect();
    let is_skin = |index: &usize| {
        let here = Vec3::from_array(canonical.position(*index));
        let nearest = vertices.iter().min_by(|a, b| a.0.distance_squared(here).total_cmp(&b.0.distance_squared(here)));
        nearest.is_some_and(|(vertex, skin)| *skin && vertex.distance(here) < 0.01)
    };
    // A thousand or two samples are plenty for nine coefficients.
    (0..canonical.len()).step_by(canonical.len().div_ceil(4000).max(1)).filter(is_skin).collect()
}
