//! The head's scalp drawn out to the hair that the mattes show.
//!
//! A head model is bald: hair stands a centimetre or two off its scalp. Where the scalp is the outline of the head in a
//! frame looked at, the matte tells how far the hair reaches beyond it along the normal (or that it ends before). What
//! lies between those places, the back of the head above all, is a membrane through them that ends at hairline, ears and
//! nape. Metres in head space; only the shape at rest changes, not how it moves.

use glam::{Vec2, Vec3};
use heartian_face::{HeadModel, Region, vertex_normals};

use crate::initialise::Scaffold;
use crate::surface::{MeshView, NOTHING};

/// A vertex is of the outline where the cosine between its normal and the ray is below this.
const EDGE_COSINE: f32 = 0.35;
/// How far within and beyond the scalp the end of the matte is looked for, metres, and in what steps.
const REACH_METRES: [f32; 2] = [-0.012, 0.045];
const STEP_METRES: f32 = 5e-4;
/// Matte at which the person ends.
const HALF: u8 = 127;
/// The outline's pixel at this distance, pixels, must not show the mesh.
const CLEAR_PX: f32 = 3.0;
/// Weight of one frame's outline against one edge of the membrane.
const OUTLINE_WEIGHT: f32 = 2.0;
/// Sweeps of the membrane; a few thousand vertices are settled by then.
const SWEEPS: usize = 400;

/// The head at rest with its scalp where the hair ends.
pub(crate) fn with_hair(scaffold: &Scaffold<'_>) -> HeadModel {
    let head = scaffold.head;
    let mut weights = vec![0.0f32; head.vertices.len()];
    let mut sums = weights.clone();
    for (frame, state) in scaffold.views {
        let posed = scaffold.posed(state);
        let view = MeshView::new(&posed, &head.triangles, &scaffold.camera);
        let normals = vertex_normals(&posed, &head.triangles);
        let outline = Outline { scaffold, view: &view, alpha: scaffold.clip.frame_alpha(*frame) };
        for (vertex, region) in head.regions.iter().enumerate() {
            if *region != Region::Scalp {
                continue;
            }
            let (place, normal) = (Vec3::from_array(posed[vertex]), Vec3::from_array(normals[vertex]));
            if let Some((weight, height)) = outline.height(place, normal) {
                weights[vertex] += weight;
                sums[vertex] += weight * height;
            }
        }
    }
    let heights = membrane(head, &weights, &sums);
    let normals = vertex_normals(&head.vertices, &head.triangles);
    let mut hairy = head.clone();
    for ((vertex, normal), height) in hairy.vertices.iter_mut().zip(normals).zip(heights) {
        for (to, n) in vertex.iter_mut().zip(normal) {
            *to += height * n;
        }
    }
    hairy
}

/// One frame's outline.
struct Outline<'a> {
    scaffold: &'a Scaffold<'a>,
    view: &'a MeshView,
    alpha: &'a [u8],
}

impl Outline<'_> {
    /// How far beyond a vertex the matte reaches along its normal, metres, and what that is worth; nothing where the vertex
    /// is not of the outline or the matte does not end within reach.
    fn height(&self, place: Vec3, normal: Vec3) -> Option<(f32, f32)> {
        let camera = &self.scaffold.camera;
        let ray = (camera.centre_in_world() - place).try_normalize()?;
        let weight = 1.0 - normal.dot(ray).abs() / EDGE_COSINE;
        let pixel = camera.project(place)?;
        let outward = camera.project(place + normal * STEP_METRES)? - pixel;
        let beyond = pixel + outward.try_normalize()? * CLEAR_PX;
        if !(weight > 0.0) || self.view.triangle[self.index(beyond)?] != NOTHING {
            return None;
        }
        let [least, most] = REACH_METRES;
        let steps = ((most - least) / STEP_METRES) as usize;
        let mut heights = (0..steps).map(|step| least + step as f32 * STEP_METRES);
        let solid = |height: f32| -> Option<bool> {
            Some(self.alpha[self.index(pixel + outward * (height / STEP_METRES))?] > HALF)
        };
        if !solid(least)? {
            return None;
        }
        let end = heights.find_map(|height| match solid(height) {
            Some(true) => None,
            Some(false) => Some(Some(height)),
            None => Some(None),
        });
        end.flatten().map(|height| (weight, height))
    }

    fn index(&self, pixel: Vec2) -> Option<usize> {
        let inside = pixel.x >= 0.0
            && pixel.y >= 0.0
            && (pixel.x as usize) < self.view.width
            && (pixel.y as usize) < self.view.height;
        inside.then(|| pixel.y as usize * self.view.width + pixel.x as usize)
    }
}

/// Heights of all vertices: 0 off the scalp, near what the outlines say where they say something, harmonic between.
fn membrane(head: &HeadModel, weights: &[f32], sums: &[f32]) -> Vec<f32> {
    let mut near: Vec<Vec<u32>> = vec![Vec::new(); head.vertices.len()];
    for [a, b, c] in &head.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            near[*from as usize].push(*to);
        }
    }
    let mut heights = vec![0.0f32; head.vertices.len()];
    if weights.iter().all(|weight| *weight == 0.0) {
        return heights;
    }
    for _ in 0..SWEEPS {
        for vertex in (0..heights.len()).filter(|vertex| head.regions[*vertex] == Region::Scalp) {
            let around: f32 = near[vertex].iter().map(|&other| heights[other as usize]).sum();
            let whole = near[vertex].len() as f32 + OUTLINE_WEIGHT * weights[vertex];
            heights[vertex] = (around + OUTLINE_WEIGHT * sums[vertex]) / whole.max(1e-6);
        }
    }
    heights
}

#[cfg(test)]
mod tests {
    use heartian_space::Clip;

    use super::*;
    use crate::AvatarError;
    use crate::motion::MotionModel;
    use crate::phantom;

    /// The ball filmed with hair of 8 mm on its scalp; fitted with the bald one.
    #[test]
    fn the_scalp_rises_to_the_hair_and_the_face_stays() -> Result<(), AvatarError> {
        let bald = phantom::head();
        let mut hairy = bald.clone();
        for (vertex, region) in hairy.vertices.iter_mut().zip(&bald.regions) {
            if *region == Region::Scalp {
                vertex.iter_mut().for_each(|v| *v *= 1.08);
            }
        }
        let (clip, track) = phantom::recording_of(&hairy, 96, 10);
        let frames: Vec<usize> = (0..10).collect();
        let fitted = MotionModel::fit(&track, &bald, &frames, 4)?;
        let views: Vec<_> = frames.iter().map(|&t| (t, fitted.model.state(&track.frames[t]))).collect();
        let (model, basis) = (&fitted.model, &fitted.basis);
        let scaffold = Scaffold { clip: &clip, camera: track.camera, head: &bald, model, basis, views: &views };
        let found = with_hair(&scaffold);
        let length = |v: &[f32; 3]| Vec3::from_array(*v).length();
        for ((before, after), region) in bald.vertices.iter().zip(&found.vertices).zip(&bald.regions) {
            if *region != Region::Scalp {
                assert_eq!(before, after);
            } else if before[2] < -0.06 && before[2] > -0.09 {
                // No frame shows it: it lies on the membrane between what outlines say.
                let rise = length(after) - length(before);
                assert!((0.003..0.012).contains(&rise), "{before:?}: {rise}");
            }
        }
        let beyond = found.vertices.iter().map(length).fold(0.0, f32::max);
        assert!((0.106..0.112).contains(&beyond), "{beyond}");
        let black = Clip { alpha: vec![0; clip.alpha.len()], ..clip.clone() };
        assert_eq!(with_hair(&Scaffold { clip: &black, ..scaffold }).vertices, bald.vertices);
        Ok(())
    }
}
