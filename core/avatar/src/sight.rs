//! What the frames looked at say of every vertex of the mesh: how little of it they saw, whether the mattes allow it, and
//! how far below the surface they do.

use glam::Vec3;
use heartian_face::vertex_normals;
use rayon::prelude::*;

use crate::initialise::Scaffold;
use crate::surface::MeshView;

/// Doubt is 1 where four frames in five saw a vertex at less than the first cosine or not at all, 0 from the second on.
const DOUBTFUL_COSINES: [f32; 2] = [0.2, 0.5];
/// The share of frames that may see less, and of frames whose matte may contradict.
const ODD_FRAMES: f32 = 0.2;
/// How far behind the nearest surface a vertex still counts as seen, metres.
const HIDDEN_BEHIND_METRES: f32 = 6e-3;
/// Depths below the surface that are tried until the mattes allow one: how many, and how far apart, metres.
const INSETS: usize = 9;
const INSET_METRES: f32 = 1e-3;
/// What is added to the depth found, metres.
const INSET_MARGIN_METRES: f32 = 1e-3;
/// Matte at which a place is allowed without going deeper.
const SOLID: f32 = 0.9;

/// One number a vertex each.
pub(crate) struct Sight {
    /// 0 where the frames faced the vertex, 1 where they did not see it.
    pub doubt: Vec<f32>,
    /// How solid the mattes are there, in [0, 1].
    pub matte: Vec<f32>,
    /// How far below the surface that is, metres.
    pub inset_metres: Vec<f32>,
}

impl Sight {
    /// Of the frames looked at.
    pub fn new(scaffold: &Scaffold<'_>, mesh_views: &[MeshView]) -> Self {
        let head = scaffold.head;
        let posed: Vec<_> = scaffold
            .views
            .par_iter()
            .map(|(_, state)| {
                let posed = scaffold.posed(state);
                let normals = vertex_normals(&posed, &head.triangles);
                (posed, normals)
            })
            .collect();
        let of = |vertex: usize| {
            let places: Vec<(Vec3, Vec3)> = posed
                .iter()
                .map(|(places, normals)| (Vec3::from_array(places[vertex]), Vec3::from_array(normals[vertex])))
                .collect();
            let cosines = places.iter().zip(mesh_views).filter_map(|(place, view)| facing(scaffold, view, *place));
            let [none, sure] = DOUBTFUL_COSINES;
            let doubt = ((sure - quantile(cosines.collect(), 1.0 - ODD_FRAMES)) / (sure - none)).clamp(0.0, 1.0);
            let (matte, inset) = allowed(scaffold, &places);
            (doubt, matte, inset)
        };
        let of_all: Vec<(f32, f32, f32)> = (0..head.vertices.len()).into_par_iter().map(of).collect();
        Self {
            doubt: of_all.iter().map(|(doubt, ..)| *doubt).collect(),
            matte: of_all.iter().map(|(_, matte, _)| *matte).collect(),
            inset_metres: of_all.iter().map(|(.., inset)| *inset).collect(),
        }
    }
}

/// Cosine at which a frame sees a place, 0 where it is hidden or averted; nothing outside the picture.
fn facing(scaffold: &Scaffold<'_>, view: &MeshView, (place, normal): (Vec3, Vec3)) -> Option<f32> {
    let pixel = pixel_of(scaffold, place)?;
    let ray = (scaffold.camera.centre_in_world() - place).try_normalize()?;
    let depth = scaffold.camera.camera_from_world_point(place).z;
    let shown = depth < view.depth[pixel] + HIDDEN_BEHIND_METRES;
    Some(if shown { normal.dot(ray).max(0.0) } else { 0.0 })
}

/// The least depth below the surface that nearly all mattes allow, and how solid they are there; the most solid one if
/// none does.
fn allowed(scaffold: &Scaffold<'_>, places: &[(Vec3, Vec3)]) -> (f32, f32) {
    let mut best = (0.0, 0.0);
    for step in 0..INSETS {
        let inset = step as f32 * INSET_METRES;
        let solid = places.iter().zip(scaffold.views).filter_map(|((place, normal), (frame, _))| {
            let pixel = pixel_of(scaffold, *place - inset * *normal)?;
            Some(f32::from(scaffold.clip.frame_alpha(*frame)[pixel]) / 255.0)
        });
        let matte = quantile(solid.collect(), ODD_FRAMES);
        if matte > best.0 {
            best = (matte, inset + INSET_MARGIN_METRES);
        }
        if matte >= SOLID {
            break;
        }
    }
    best
}

fn pixel_of(scaffold: &Scaffold<'_>, place: Vec3) -> Option<usize> {
    let camera = &scaffold.camera;
    let pixel = camera.project(place)?;
    let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < camera.width as f32 && pixel.y < camera.height as f32;
    inside.then(|| pixel.y as usize * camera.width + pixel.x as usize)
}

/// The value below which a share of the values lies; 0 of none.
fn quantile(mut values: Vec<f32>, share: f32) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    let place = (share * values.len() as f32) as usize;
    values.get(place.min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use heartian_space::Clip;

    use super::*;
    use crate::AvatarError;
    use crate::motion::MotionModel;
    use crate::phantom;

    #[test]
    fn the_front_is_sure_the_back_is_doubtful_and_the_matte_has_its_say() -> Result<(), AvatarError> {
        let (mut clip, track) = phantom::recording(64, 10);
        // The lowest third of every matte is cut off.
        clip.alpha.chunks_exact_mut(64 * 64).for_each(|alpha| alpha[42 * 64..].fill(0));
        let head = phantom::head();
        let frames: Vec<usize> = (0..10).collect();
        let fitted = MotionModel::fit(&track, &head, &frames, 4)?;
        let views: Vec<_> = frames.iter().map(|&t| (t, fitted.model.state(&track.frames[t]))).collect();
        let (model, basis) = (&fitted.model, &fitted.basis);
        let scaffold = Scaffold { clip: &clip, camera: track.camera, head: &head, model, basis, views: &views };
        let sight = Sight::new(&scaffold, &scaffold.mesh_views());
        let of = |wanted: [f32; 3]| {
            let wanted = Vec3::from_array(wanted);
            let distance = |v: &[f32; 3]| Vec3::from_array(*v).distance(wanted);
            let nearest = (0..head.vertices.len())
                .min_by(|a, b| distance(&head.vertices[*a]).total_cmp(&distance(&head.vertices[*b])));
            let vertex = nearest.unwrap_or_default();
            (sight.doubt[vertex], sight.matte[vertex], sight.inset_metres[vertex])
        };
        let (front, back, side, low) =
            (of([0.0, 0.0, 0.1]), of([0.0, 0.0, -0.1]), of([0.1, 0.0, 0.0]), of([0.0, -0.1, 0.0]));
        assert!(front.0 == 0.0 && front.1 > 0.99, "{front:?}");
        assert!(back.0 == 1.0 && back.1 > 0.99, "{back:?}");
        assert!(side.0 > 0.5 && side.1 > 0.9 && side.2 > 0.0, "{side:?}");
        assert_eq!(low.1, 0.0, "no depth along the normal helps within reach");
        let black = Clip { alpha: vec![0; clip.alpha.len()], ..clip.clone() };
        let none = Sight::new(&Scaffold { clip: &black, ..scaffold }, &[]);
        assert!(none.matte.iter().all(|matte| *matte == 0.0));
        Ok(())
    }
}
