//! What colour each Gaussian had in the recording: the median over frames in which it is in sight.
//!
//! Linear light, over the frames looked at. A Gaussian is in sight where it projects inside a solid part of the matte
//! and the mesh does not hide it. One that is never in sight takes the colour of the nearest that is.

use glam::{Vec2, Vec3};
use heartian_space::color::linear_from_srgb;
use rayon::prelude::*;

use crate::canonical::Canonical;
use crate::deform::deform;
use crate::initialise::Scaffold;
use crate::surface::MeshView;

/// How far behind the mesh's depth a Gaussian may lie and still be in sight, metres.
const HIDDEN_BEHIND_METRES: f32 = 6e-3;
/// Least matte of a pixel that colours are read from; below it the background shines through.
const SOLID_ALPHA: u8 = 250;

/// Median linear RGB of each Gaussian.
pub(crate) fn observed_colors(
    scaffold: &Scaffold<'_>,
    mesh_views: &[MeshView],
    canonical: &Canonical,
) -> Vec<[f32; 3]> {
    let deformed: Vec<Vec<f32>> =
        scaffold.views.iter().map(|(_, state)| deform(canonical, &scaffold.model.motion(state)).positions).collect();
    let linear: Vec<f32> = (0..=255u8).map(|code| linear_from_srgb(f32::from(code) / 255.0)).collect();
    let seen: Vec<Option<[f32; 3]>> = (0..canonical.len())
        .into_par_iter()
        .map(|index| {
            let mut channels: [Vec<f32>; 3] = Default::default();
            for (((frame, _), view), world) in scaffold.views.iter().zip(mesh_views).zip(&deformed) {
                let point = Vec3::from_slice(&world[3 * index..3 * index + 3]);
                if let Some(color) = color_at(scaffold, *frame, view, point, &linear) {
                    channels.iter_mut().zip(color).for_each(|(channel, value)| channel.push(value));
                }
            }
            (!channels[0].is_empty()).then(|| channels.map(median))
        })
        .collect();
    fill_unseen(canonical, &seen)
}

fn color_at(scaffold: &Scaffold<'_>, frame: usize, view: &MeshView, point: Vec3, linear: &[f32]) -> Option<[f32; 3]> {
    let Vec2 { x, y } = scaffold.camera.project(point)?;
    if !(x >= 0.5 && y >= 0.5 && x < view.width as f32 - 0.5 && y < view.height as f32 - 0.5) {
        return None;
    }
    let centre = y as usize * view.width + x as usize;
    if scaffold.camera.camera_from_world_point(point).z > view.depth[centre] + HIDDEN_BEHIND_METRES {
        return None;
    }
    let (left, top) = ((x - 0.5) as usize, (y - 0.5) as usize);
    let (fx, fy) = (x - 0.5 - left as f32, y - 0.5 - top as f32);
    let (colors, alpha) = (scaffold.clip.frame(frame), scaffold.clip.frame_alpha(frame));
    let mut out = [0.0; 3];
    for (dx, dy, weight) in
        [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
    {
        let pixel = (top + dy).min(view.height - 1) * view.width + (left + dx).min(view.width - 1);
        if alpha[pixel] < SOLID_ALPHA {
            return None;
        }
        for (to, code) in out.iter_mut().zip(&colors[3 * pixel..3 * pixel + 3]) {
            *to += weight * linear[usize::from(*code)];
        }
    }
    Some(out)
}

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Colours for all: an unseen Gaussian takes that of the nearest seen one, mid-grey when none is.
fn fill_unseen(canonical: &Canonical, seen: &[Option<[f32; 3]>]) -> Vec<[f32; 3]> {
    let known: Vec<(Vec3, [f32; 3])> = seen
        .iter()
        .enumerate()
        .filter_map(|(index, color)| color.map(|color| (Vec3::from_array(canonical.position(index)), color)))
        // The nearest of a few thousand is near enough for what no frame shows.
        .step_by(seen.len().div_ceil(4000).max(1))
        .collect();
    seen.par_iter()
        .enumerate()
        .map(|(index, color)| {
            color.unwrap_or_else(|| {
                let here = Vec3::from_array(canonical.position(index));
                let nearest =
                    known.iter().min_by(|a, b| a.0.distance_squared(here).total_cmp(&b.0.distance_squared(here)));
                nearest.map_or([0.2; 3], |(_, color)| *color)
            })
        })
        .collect()
}
