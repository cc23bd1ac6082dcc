//! The first Gaussians: flat discs on the head's surface, and free ones where the matte shows a person and the mesh does
//! not reach (hair, neck, shoulders), with colours read from the training frames.
//!
//! A disc lies in its triangle's plane, third axis along the outward normal, its size set by the spacing of its
//! neighbours. Skinning weights and displacement bases are interpolated barycentrically. A free Gaussian is put at the
//! depth of the nearest surface in the picture and moves with it. The whole outside of the head is covered, as far as the
//! mattes allow; what no frame saw is the ground (`ground.rs`).

use glam::{DMat4, Mat3, Quat, Vec2, Vec3};
use heartian_face::{Basis, HeadModel, Region, vertex_normals};
use heartian_space::{Camera, Clip};
use heartian_splat::logit;

use crate::canonical::Canonical;
use crate::ground::Ground;
use crate::motion::{FrameState, MotionModel};
use crate::rig::JOINTS;
use crate::sample::{
    SurfacePoint, at_point, cover_outside, is_outside, sample_surface, triangle_region, triangle_shares,
};
use crate::sight::Sight;
use crate::surface::{MeshView, NOTHING};

/// Standard deviation of a disc in units of the spacing to its neighbours: neighbours overlap at 0.7 of their peak.
const SCALE_PER_SPACING: f32 = 0.6;
/// Thickness of a disc relative to its radius.
const FLATNESS: f32 = 0.2;
/// Opacity of a Gaussian on the surface, and of a free one.
const OPACITY: [f32; 2] = [0.8, 0.6];
/// Roughness and reflectance logits at the start (roughness ½ + ½·0.9, reflectance at the low end of its range).
const ROUGHNESS_LOGIT: f32 = 2.2;
const REFLECTANCE_LOGIT: f32 = -3.0;
/// Largest and smallest standard deviation at the start, metres.
const SCALE_RANGE_METRES: [f32; 2] = [2e-4, 1.2e-2];
/// Largest part of the budget that free Gaussians may take.
const FREE_SHARE: f32 = 0.4;

/// What is less solid than this is not covered where no frame looked: it is not of the head, but beyond the cut.
const LEAST_MATTE: f32 = 0.25;
/// Gaussians lie no farther apart than this on the outside of the head, metres.
const COVER_SPACING_METRES: f32 = 6e-3;
/// Doubt of what the mattes show fading out.
const FADING_DOUBT: f32 = 0.6;
/// A doubtful Gaussian is this opaque, and this part wider.
const GROUND_OPACITY: f32 = 0.97;
const GROUND_WIDER: f32 = 0.3;

/// What the first Gaussians are made from.
pub(crate) struct Scaffold<'a> {
    /// The recording.
    pub clip: &'a Clip,
    /// Its camera.
    pub camera: Camera,
    /// The head with the person's identity baked in.
    pub head: &'a HeadModel,
    /// How it moves.
    pub model: &'a MotionModel,
    /// Displacement of each vertex per motion coefficient.
    pub basis: &'a Basis,
    /// Frames looked at, of the training part.
    pub views: &'a [(usize, FrameState)],
}

impl Scaffold<'_> {
    /// The posed mesh of a frame in the world.
    pub fn posed(&self, state: &FrameState) -> Vec<[f32; 3]> {
        let mut rest = self.head.vertices.clone();
        self.basis.add_to(&state.coefficients, &mut rest);
        self.head.skinned(&rest, &self.model.rig.transforms(&state.pose).map(|joint| joint.as_mat4()))
    }

    /// What each of the frames looked at shows of the mesh.
    pub fn mesh_views(&self) -> Vec<MeshView> {
        let view =
            |(_, state): &(usize, FrameState)| MeshView::new(&self.posed(state), &self.head.triangles, &self.camera);
        self.views.iter().map(view).collect()
    }

    /// Lays out about `budget` Gaussians, and what they stand on but for its rest; colours are mid-grey until they are read.
    pub fn lay_out(&self, mesh_views: &[MeshView], budget: usize) -> (Canonical, Ground) {
        let covered = mean(mesh_views.iter().map(|view| view.triangle.iter().filter(|t| **t != NOTHING).count()));
        let uncovered = mean(self.views.iter().zip(mesh_views).map(|((frame, _), view)| {
            let alpha = self.clip.frame_alpha(*frame);
            alpha.iter().zip(&view.triangle).filter(|(alpha, t)| **alpha > 127 && **t == NOTHING).count()
        }));
        let free_share = (uncovered / (covered + uncovered).max(1.0)).min(FREE_SHARE);
        let free_budget = (budget as f32 * free_share) as usize;
        let normals = vertex_normals(&self.head.vertices, &self.head.triangles);
        let mut canonical = Canonical::zeros(0, self.basis.count);
        let mut ground = Ground { rest: Canonical::default(), doubt: Vec::new(), kind: Vec::new() };
        let Sight { doubt, matte, inset_metres } = Sight::new(self, mesh_views);
        let points = budget - free_budget;
        let mut shares = triangle_shares(self.head, mesh_views);
        let keep: Vec<f32> = self
            .head
            .triangles
            .iter()
            .map(|t| t.iter().map(|&v| matte[v as usize]).fold(0.0, f32::max) - LEAST_MATTE)
            .collect();
        cover_outside(self.head, &mut shares, &keep, (points, COVER_SPACING_METRES));
        for point in sample_surface(self.head, &shares, points) {
            let mut anchor = Anchor::on(self, &point);
            let region = triangle_region(self.head, self.head.triangles[point.triangle as usize]);
            let normal = Vec3::from_array(at_point(self.head, &point, |vertex| normals[vertex]));
            let [doubt, matte, inset] =
                at_point(self.head, &point, |vertex| [doubt[vertex], matte[vertex], inset_metres[vertex]]);
            let doubt = if is_outside(region) { doubt.max(FADING_DOUBT * (1.0 - matte)) } else { 0.0 };
            let inset = inset * doubt * normal.normalize_or_zero();
            anchor.position = (Vec3::from_array(anchor.position) - inset).to_array();
            let opacity = OPACITY[0] + doubt * (GROUND_OPACITY * matte - OPACITY[0]);
            push(&mut canonical, &anchor, normal, point.spacing_metres * (1.0 + GROUND_WIDER * doubt), opacity);
            ground.doubt.push(doubt);
            ground.kind.push(u8::from(region == Region::Scalp));
        }
        self.lay_out_free(mesh_views, free_budget, &mut canonical);
        ground.doubt.resize(canonical.len(), 0.0);
        ground.kind.resize(canonical.len(), 0);
        (canonical, ground)
    }

    /// Free Gaussians, a grid of pixels at a time, frame after frame, where no earlier one lands.
    fn lay_out_free(&self, mesh_views: &[MeshView], budget: usize, canonical: &mut Canonical) {
        let end = canonical.len() + budget;
        let (width, height) = (self.camera.width, self.camera.height);
        let mut taken: Vec<Vec<bool>> = mesh_views.iter().map(|_| vec![false; width * height]).collect();
        let rounds = mesh_views.len().min(4);
        for round in 0..rounds {
            let chosen = round * mesh_views.len() / rounds;
            let (view, (frame, _)) = (&mesh_views[chosen], &self.views[chosen]);
            let Some(nearest) = view.nearest_surface() else { continue };
            let alpha = self.clip.frame_alpha(*frame);
            let open: Vec<usize> = (0..width * height)
                .filter(|&p| alpha[p] > 127 && view.triangle[p] == NOTHING && !taken[chosen][p])
                .collect();
            let left = end.saturating_sub(canonical.len());
            if open.is_empty() || left == 0 {
                continue;
            }
            let step = (open.len() as f32 / left as f32).sqrt().ceil().max(1.0) as usize;
            for pixel in open.into_iter().filter(|p| (p % width) % step == 0 && (p / width) % step == 0) {
                self.push_free(view, chosen, (pixel, nearest[pixel] as usize, step), canonical);
                self.mark_taken(canonical, step, &mut taken);
            }
        }
    }

    fn push_free(
        &self,
        view: &MeshView,
        chosen: usize,
        (pixel, source, step): (usize, usize, usize),
        canonical: &mut Canonical,
    ) {
        let [u, v] = view.barycentric[source];
        let point =
            SurfacePoint { triangle: view.triangle[source], barycentric: [u, v, 1.0 - u - v], spacing_metres: 0.0 };
        let mut anchor = Anchor::on(self, &point);
        let state = &self.views[chosen].1;
        let depth = view.depth[source];
        let centre = Vec2::new((pixel % view.width) as f32 + 0.5, (pixel / view.width) as f32 + 0.5);
        let ray = self.camera.ray_in_world(centre);
        let along = self.camera.camera_from_world_rotation() * ray;
        let world = self.camera.centre_in_world() + ray * (depth / along.z.max(1e-3));
        let world_from_canonical = anchor.blended(&self.model.rig.transforms(&state.pose)).as_mat4();
        let canonical_from_world = world_from_canonical.inverse();
        let mut position = canonical_from_world.transform_point3(world);
        for (basis, c) in anchor.bases.as_chunks::<3>().0.iter().zip(&state.coefficients) {
            position -= *c * Vec3::from_array(*basis);
        }
        anchor.position = position.to_array();
        let normal = canonical_from_world.transform_vector3(-ray);
        let spacing = step as f32 * depth / self.camera.focal_px[0];
        push(canonical, &anchor, normal, spacing, OPACITY[1]);
    }

    /// Marks, in every view, the pixels around where the last Gaussian lands.
    fn mark_taken(&self, canonical: &Canonical, step: usize, taken: &mut [Vec<bool>]) {
        let last = canonical.gather(&[canonical.len() as u32 - 1]);
        for ((_, state), taken) in self.views.iter().zip(taken) {
            let world = crate::deform::deform(&last, &self.model.motion(state)).positions;
            let Some(pixel) = self.camera.project(Vec3::new(world[0], world[1], world[2])) else { continue };
            let (width, height) = (self.camera.width as i64, self.camera.height as i64);
            let reach = step as i64;
            let (px, py) = (pixel.x as i64, pixel.y as i64);
            for y in py.saturating_sub(reach).max(0)..py.saturating_add(reach + 1).min(height) {
                for x in px.saturating_sub(reach).max(0)..px.saturating_add(reach + 1).min(width) {
                    taken[(y * width + x) as usize] = true;
                }
            }
        }
    }
}

/// Where on the mesh a Gaussian hangs and what it inherits from there.
struct Anchor {
    position: [f32; 3],
    weights: [f32; JOINTS],
    bases: Vec<f32>,
}

impl Anchor {
    fn on(scaffold: &Scaffold<'_>, point: &SurfacePoint) -> Self {
        let head = scaffold.head;
        let bases = (0..scaffold.basis.count)
            .flat_map(|mode| at_point(head, point, |vertex| scaffold.basis.mode(mode)[vertex]))
            .collect();
        Self {
            position: at_point(head, point, |vertex| head.vertices[vertex]),
            weights: at_point(head, point, |vertex| head.weights[vertex]),
            bases,
        }
    }

    fn blended(&self, joints: &[DMat4; JOINTS]) -> DMat4 {
        let mut blended = DMat4::ZERO;
        for (joint, weight) in joints.iter().zip(self.weights) {
            blended += *joint * f64::from(weight);
        }
        blended
    }
}

/// Appends a flat Gaussian with its third axis along `normal`.
fn push(canonical: &mut Canonical, anchor: &Anchor, normal: Vec3, spacing_metres: f32, opacity: f32) {
    let normal = normal.try_normalize().unwrap_or(Vec3::Z);
    let (tangent, bitangent) = normal.any_orthonormal_pair();
    let rotation = Quat::from_mat3(&Mat3::from_cols(tangent, bitangent, normal)).normalize();
    let [least, most] = SCALE_RANGE_METRES;
    let radius = (SCALE_PER_SPACING * spacing_metres).clamp(least, most);
    canonical.positions.extend(anchor.position);
    canonical.log_scales.extend([radius, radius, FLATNESS * radius].map(f32::ln));
    canonical.rotations.extend([rotation.w, rotation.x, rotation.y, rotation.z]);
    canonical.opacity_logits.push(logit(opacity));
    canonical.albedo_logits.extend([0.0; 3]);
    canonical.roughness_logits.push(ROUGHNESS_LOGIT);
    canonical.reflectance_logits.push(REFLECTANCE_LOGIT);
    canonical.bases.extend(&anchor.bases);
    canonical.weights.extend(anchor.weights);
}

fn mean(counts: impl Iterator<Item = usize>) -> f32 {
    let (sum, count) = counts.fold((0, 0), |(sum, count), value| (sum + value, count + 1));
    sum as f32 / count.max(1) as f32
}
