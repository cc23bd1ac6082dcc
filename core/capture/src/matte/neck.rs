//! Where a head ends: the built-in head is fitted to a clip's landmarks, and what is kept of the neck fades out with its
//! mesh.
//!
//! A pixel that shows the mesh has the height of the surface there; one beside it that of the nearest point of the neck,
//! drawn on as an elliptic tube. Heights are those of the rest head, metres ([`HeadModel::neck_fade`]), so the cut turns
//! and nods with the head, steadily, as the tracker's poses do.

use std::ops::ControlFlow;

use glam::{Mat3, Quat, Vec2, Vec3};
use heartian_face::{FaceError, FramePose, HeadModel, Observations, Region, TrackOptions, track};
use heartian_space::Camera;

use super::smoothstep;
use crate::CaptureError;
use crate::mesh::{Fragment, ONE_SAMPLE, ScreenVertex, VisibilityBuffer};

/// Focal length that is taken for a crop around a head, picture widths; a wrong one is made up for by the distance.
const FOCAL_WIDTHS: f64 = 2.2;
/// Key frames of the fit: the cut asks less of the identity than the tracker does.
const KEY_FRAMES: usize = 12;
/// How fast the cut rises beside the neck: steeper than any shoulder falls.
const RISE: f32 = 2.5;
/// In the face mesh: the jaw's corners, up to which the cut rises, and the base of the nose, which no collar reaches.
const JAW_CORNERS: [u32; 2] = [58, 288];
const NOSE_BASE: u32 = 2;

/// The necks of all frames of a clip.
pub(super) struct Necks {
    head: HeadModel,
    camera: Camera,
    poses: Vec<FramePose>,
    tube: Tube,
    /// What is kept fades out between these heights.
    fade: [f32; 2],
    jaw: f32,
    nose: f32,
}

/// One frame's pixels.
pub(super) struct Zones {
    /// What the end of the mesh leaves of each pixel, in [0, 1].
    pub(super) kept: Vec<f32>,
    /// Where clothes may lie over the neck or beside the face.
    pub(super) dressed: Vec<bool>,
}

/// The neck beyond the mesh.
struct Tube {
    /// Half axes, across and along the line of sight.
    half: Vec2,
    /// Depth of its axis.
    depth: f32,
}

/// What a pixel shows of the head.
struct Place {
    height: f32,
    beside: f32,
    dressed: bool,
}

impl Necks {
    /// Fits the head; `None` where no frame shows a face that a head explains. `go_on` is asked now and then.
    pub(super) fn fit(
        landmarks: &Observations,
        go_on: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Option<Self>, CaptureError> {
        let options = TrackOptions {
            focal_px: Some(FOCAL_WIDTHS * landmarks.width.max(landmarks.height) as f64),
            key_frames: KEY_FRAMES,
            personal_offset: false,
            rounds: 0,
            refine_focal: false,
            sigma: false,
            ..TrackOptions::default()
        };
        let track = match track(&HeadModel::procedural(), landmarks, &options, &mut |_| go_on()) {
            Ok(track) => track,
            Err(FaceError::Cancelled) => return Err(CaptureError::Cancelled),
            Err(FaceError::NoFace { .. } | FaceError::TooFewLandmarks { .. } | FaceError::Diverged { .. }) => {
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        };
        Ok(Some(Self::new(track.baked_head(), track.camera, track.frames)))
    }

    fn new(head: HeadModel, camera: Camera, poses: Vec<FramePose>) -> Self {
        let fade = head.neck_fade();
        let height = |index: u32| {
            let anchor = head.landmarks.iter().find(|anchor| anchor.index == index)?;
            Some(head.landmark_position(anchor, &head.vertices)[1])
        };
        let corners = JAW_CORNERS.map(|index| height(index).unwrap_or(f32::MAX));
        let nose = height(NOSE_BASE).unwrap_or(0.0);
        let jaw = corners[0].min(corners[1]).min(nose).max(fade[1]);
        Self { tube: Tube::of(&head, fade), head, camera, poses, fade, jaw, nose }
    }

    /// The zones of a frame of `size × size` pixels.
    pub(super) fn zones(&self, frame: usize, size: usize) -> Zones {
        let camera = self.camera.scaled_to(size, size);
        let mut zones = Zones { kept: vec![1.0; size * size], dressed: vec![false; size * size] };
        let Some(pose) = self.poses.get(frame) else { return zones };
        let screen: Vec<ScreenVertex> = self
            .head
            .pose(pose)
            .into_iter()
            .map(Vec3::from_array)
            .map(|point| match camera.project(point) {
                Some(position_px) => {
                    ScreenVertex { position_px, nearness: 1.0 / camera.camera_from_world_point(point).z }
                }
                None => ScreenVertex { position_px: Vec2::ZERO, nearness: f32::NAN },
            })
            .collect();
        let mut canvas = VisibilityBuffer::new(size, size, ONE_SAMPLE);
        canvas.draw(&screen, &self.head.triangles);
        let head_from_world = Mat3::from_quat(Quat::from_scaled_axis(Vec3::from_array(pose.rotation)).conjugate());
        let eye = head_from_world * (camera.centre_in_world() - Vec3::from_array(pose.translation));
        for pixel in 0..size * size {
            let (x, y) = (pixel % size, pixel / size);
            let place = match canvas.fragments(x, y).next() {
                Some(fragment) => self.on_mesh(&fragment, &screen),
                None => {
                    let ray = camera.ray_in_world(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                    self.beside_mesh(eye, head_from_world * ray)
                }
            };
            let rise = (RISE * place.beside).min(self.jaw - self.fade[1]);
            zones.kept[pixel] = smoothstep(self.fade[0] + rise, self.fade[1] + rise, place.height);
            zones.dressed[pixel] = place.dressed;
        }
        zones
    }

    fn on_mesh(&self, fragment: &Fragment, screen: &[ScreenVertex]) -> Place {
        let corners = self.head.triangles[fragment.triangle as usize].map(|vertex| vertex as usize);
        let [a, b, c] = corners.map(|vertex| screen[vertex].position_px - fragment.position_px);
        let areas = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
        let whole: f32 = areas.iter().sum();
        let heights = corners.map(|vertex| self.head.vertices[vertex][1]);
        let height = if whole.abs() > 1e-9 {
            areas.iter().zip(heights).map(|(area, height)| area * height).sum::<f32>() / whole
        } else {
            heights[0]
        };
        let neck = corners.iter().any(|vertex| self.head.regions[*vertex] == Region::Neck);
        Place { height, beside: 0.0, dressed: neck && height < self.jaw }
    }

    /// The nearest point of the neck's tube to a line of sight, in head space.
    fn beside_mesh(&self, eye: Vec3, ray: Vec3) -> Place {
        let across = |v: Vec3| Vec2::new(v.x, v.z) / self.tube.half;
        let (from, along) = (across(eye - Vec3::Z * self.tube.depth), across(ray));
        let (a, b, c) = (along.length_squared(), from.dot(along), from.length_squared() - 1.0);
        if a < 1e-9 {
            return Place { height: f32::MAX, beside: 0.0, dressed: false };
        }
        let inside = b * b - a * c;
        let reach = if inside > 0.0 { (-b - inside.sqrt()) / a } else { -b / a };
        let beyond = (from + along * reach).length() - 1.0;
        let height = eye.y + ray.y * reach;
        let beside = beyond.max(0.0) * (self.tube.half.x * self.tube.half.y).sqrt();
        Place { height, beside, dressed: height < self.nose }
    }
}

impl Tube {
    /// The ellipse around the vertices between two heights.
    fn of(head: &HeadModel, [low, high]: [f32; 2]) -> Self {
        let ring = head.vertices.iter().filter(|vertex| (low..=high).contains(&vertex[1]));
        let empty = (0.0f32, f32::MAX, f32::MIN);
        let (width, back, front) =
            ring.fold(empty, |(width, back, front), [x, _, z]| (width.max(x.abs()), back.min(*z), front.max(*z)));
        // Half a head's width where a head has nothing there.
        let half = |value: f32| if value.is_finite() && value > 1e-3 { value } else { 0.05 };
        let depth = 0.5 * (front + back);
        Self {
            half: Vec2::new(half(width), half(0.5 * (front - back))),
            depth: if depth.is_finite() { depth } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::synthetic::{SyntheticOptions, generate};

    #[test]
    fn the_neck_fades_as_the_true_one_does() {
        let options = SyntheticOptions { seconds: 1.5, frames_per_second: 4.0, ..SyntheticOptions::default() };
        let truth = generate(&options, &mut |_| ControlFlow::Continue(())).unwrap();
        let necks = Necks::fit(&truth.observations, &mut || ControlFlow::Continue(())).unwrap().unwrap();
        let size = truth.clip.width;
        let (mut both, mut either, mut uncut) = (0.0f64, 0.0f64, 0.0f64);
        for frame in 0..truth.clip.len() {
            let kept = necks.zones(frame, size).kept;
            for (alpha, kept) in truth.clip.frame_alpha(frame).iter().zip(&kept).filter(|(alpha, _)| **alpha > 0) {
                let alpha = f64::from(*alpha) / 255.0;
                let found = f64::from(*kept).min(1.0);
                both += alpha.min(found);
                either += alpha.max(found);
                uncut += 1.0;
            }
        }
        println!("neck iou {:.4}, without a cut {:.4}", both / either, both / uncut);
        assert!(both / either > 0.97, "{}", both / either);
    }

    #[test]
    fn shoulders_go_and_hair_stays() {
        let camera = Camera::at_origin(200, 200, 400.0);
        let pose = FramePose { translation: [0.0, 0.03, -0.7], ..FramePose::rest(0) };
        let necks = Necks::new(HeadModel::procedural(), camera, vec![pose]);
        let zones = necks.zones(0, 200);
        let at = |x: f32, y: f32| {
            let pixel = camera.project(Vec3::new(x, y + 0.03, -0.7)).unwrap();
            pixel.y as usize * 200 + pixel.x as usize
        };
        let (hair, throat, shoulder, below) = (at(0.09, 0.06), at(0.0, -0.12), at(0.11, -0.09), at(0.0, -0.165));
        assert_eq!([hair, throat, shoulder, below].map(|pixel| zones.kept[pixel]), [1.0, 1.0, 0.0, 0.0]);
        assert_eq!([hair, throat, shoulder].map(|pixel| zones.dressed[pixel]), [false, true, true]);
        assert!(necks.zones(7, 8).kept.iter().all(|kept| *kept == 1.0), "a frame that was not fitted is not cut");
    }
}
