//! A track drawn over its clip, for people who want to see what the tracker saw: mesh, landmarks, crop and matte.
//!
//! Observed landmarks are green with a red line to where the fitted head puts them, the mesh is white, fitted irises are
//! magenta rings, the region that the landmark network reads is orange, the matte's edge cyan. A frame that could not be fitted has a red border.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};
use heartian_face::nets::Roi;
use heartian_face::{HeadModel, Iris, Landmark, Observations, Region, Track};
use heartian_space::{Camera, Clip, Rgb8Image, Sequence};
use rayon::prelude::*;

use crate::CaptureError;

const MESH: Ink = Ink { color: [255.0, 255.0, 255.0], strength: 0.22 };
const SEEN: Ink = Ink { color: [60.0, 255.0, 90.0], strength: 0.9 };
const MISS: Ink = Ink { color: [255.0, 40.0, 40.0], strength: 0.9 };
const IRIS: Ink = Ink { color: [255.0, 60.0, 255.0], strength: 0.8 };
const CROP: Ink = Ink { color: [255.0, 160.0, 0.0], strength: 0.8 };
const MATTE: Ink = Ink { color: [0.0, 220.0, 255.0], strength: 0.5 };

/// What is drawn.
#[derive(Clone, Copy)]
pub struct Overlay<'a> {
    /// The clip tracked.
    pub clip: &'a Clip,
    /// Its track, of as many frames.
    pub track: &'a Track,
    /// Landmarks seen; `None` leaves them and the crop out.
    pub observations: Option<&'a Observations>,
    /// Picture pixels for each pixel of the clip, 1 to 8.
    pub scale: usize,
}

impl Overlay<'_> {
    /// The frames of `range` (cut to the clip), labelled `tracked`.
    ///
    /// # Errors
    /// When nothing of the range lies in the clip, or the track is not the clip's.
    pub fn movie(&self, range: std::ops::Range<usize>) -> Result<Clip, CaptureError> {
        let Self { clip, track, scale, .. } = *self;
        let range = range.start.min(clip.len())..range.end.min(clip.len()).min(track.frames.len());
        let head = track.baked_head();
        let edges = edges(&head);
        let camera = track.camera.scaled_to(clip.width * scale, clip.height * scale);
        let pictures: Vec<Vec<u8>> =
            range.clone().into_par_iter().map(|t| self.picture(t, (&head, &edges), &camera).0.data).collect();
        let frames = pictures.concat();
        let alpha = vec![255; frames.len() / 3];
        let sequence = Sequence { frames, alpha, times_seconds: clip.times_seconds[range].to_vec() };
        Ok(Clip::new("tracked", clip.width * scale, clip.height * scale, sequence)?)
    }

    fn picture(&self, t: usize, (head, edges): (&HeadModel, &[[u32; 4]]), camera: &Camera) -> Canvas {
        let mut canvas = Canvas(enlarged(self.clip, t, self.scale));
        let pose = &self.track.frames[t];
        outline(&mut canvas, self.clip, t, self.scale);
        let vertices = head.pose(pose);
        let pixels: Vec<Option<Vec2>> =
            vertices.iter().map(|vertex| camera.project(Vec3::from_array(*vertex))).collect();
        let facing = |[a, b, c]: [u32; 3]| match [a, b, c].map(|k| pixels[k as usize]) {
            // Pixels run downwards, so what faces the camera runs clockwise in them.
            [Some(a), Some(b), Some(c)] => (b - a).perp_dot(c - a) < 0.0,
            _ => false,
        };
        for [a, b, one, other] in edges {
            if [*one, *other].into_iter().any(|k| k != NONE && facing(head.triangles[k as usize]))
                && let (Some(from), Some(to)) = (pixels[*a as usize], pixels[*b as usize])
            {
                canvas.line(from, to, MESH);
            }
        }
        for iris in head.irises(pose).into_iter().flatten() {
            ring(&mut canvas, camera, &iris);
        }
        let seen: Vec<Landmark> = self.observations.map(|o| o.frame(t).collect()).unwrap_or_default();
        let scale = self.scale as f32;
        for landmark in &seen {
            let at = Vec2::from_array(landmark.position_px) * scale;
            if let Ok(k) = head.landmarks.binary_search_by_key(&landmark.index, |anchor| anchor.index)
                && let Some(fit) =
                    camera.project(Vec3::from_array(head.landmark_position(&head.landmarks[k], &vertices)))
            {
                canvas.line(at, fit, MISS);
            }
            canvas.line(at - Vec2::X * 0.5, at + Vec2::X * 0.5, SEEN);
        }
        if !seen.is_empty() {
            let points: Vec<[f32; 3]> = by_index(&seen);
            square(&mut canvas, &Roi::from_landmarks(&points), scale);
        }
        if !pose.fitted {
            canvas.border(3 * self.scale, MISS);
        }
        canvas
    }
}

/// Positions by landmark number; a landmark not seen takes the place of the first, which leaves their box as it is.
fn by_index(seen: &[Landmark]) -> Vec<[f32; 3]> {
    let first = seen[0].position_px;
    let mut points = vec![[first[0], first[1], 0.0]; 468];
    for landmark in seen {
        if let Some(point) = points.get_mut(landmark.index as usize) {
            *point = [landmark.position_px[0], landmark.position_px[1], 0.0];
        }
    }
    points
}

const NONE: u32 = u32::MAX;

/// Every edge once, but for the eyeballs', which would hide the irises: its ends and the one or two triangles beside it.
fn edges(head: &HeadModel) -> Vec<[u32; 4]> {
    let mut list: Vec<[u32; 3]> = Vec::with_capacity(3 * head.triangles.len());
    let eye = |triangle: &[u32; 3]| matches!(head.regions[triangle[0] as usize], Region::EyeLeft | Region::EyeRight);
    for (number, triangle) in head.triangles.iter().enumerate().filter(|(_, triangle)| !eye(triangle)) {
        for k in 0..3 {
            let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
            list.push([a.min(b), a.max(b), number as u32]);
        }
    }
    list.sort_unstable();
    let mut edges: Vec<[u32; 4]> = Vec::with_capacity(list.len() / 2);
    for [a, b, triangle] in list {
        match edges.last_mut() {
            Some(edge) if edge[..2] == [a, b] => edge[3] = triangle,
            _ => edges.push([a, b, triangle, NONE]),
        }
    }
    edges
}

fn enlarged(clip: &Clip, t: usize, scale: usize) -> Rgb8Image {
    let (width, height) = (clip.width * scale, clip.height * scale);
    let pixels = clip.frame(t).as_chunks::<3>().0;
    let data =
        (0..width * height).flat_map(|i| pixels[(i / width / scale) * clip.width + (i % width) / scale]).collect();
    Rgb8Image { width, height, data }
}

/// The rim between the person and what is not.
fn outline(canvas: &mut Canvas, clip: &Clip, t: usize, scale: usize) {
    let alpha = clip.frame_alpha(t);
    let inside = |x: usize, y: usize| alpha[y * clip.width + x] >= 128;
    for y in 1..clip.height {
        for x in 1..clip.width {
            let corner = Vec2::new(x as f32, y as f32) * scale as f32;
            if inside(x, y) != inside(x - 1, y) {
                canvas.line(corner, corner + Vec2::Y * scale as f32, MATTE);
            }
            if inside(x, y) != inside(x, y - 1) {
                canvas.line(corner, corner + Vec2::X * scale as f32, MATTE);
            }
        }
    }
}

/// The rim of an iris as if it faced the camera.
fn ring(canvas: &mut Canvas, camera: &Camera, iris: &Iris) {
    let centre = Vec3::from_array(iris.centre);
    let rim = |k: usize| camera.project(centre + iris.radius * Vec2::from_angle(TAU * k as f32 / 24.0).extend(0.0));
    for k in 0..24 {
        if let (Some(from), Some(to)) = (rim(k), rim(k + 1)) {
            canvas.line(from, to, IRIS);
        }
    }
}

fn square(canvas: &mut Canvas, roi: &Roi, scale: f32) {
    let right = Vec2::from_angle(roi.rotation) * (0.5 * roi.side_px * scale);
    let (down, centre) = (right.perp(), Vec2::from_array(roi.centre_px) * scale);
    let corners = [centre - right - down, centre + right - down, centre + right + down, centre - right + down];
    for k in 0..4 {
        canvas.line(corners[k], corners[(k + 1) % 4], CROP);
    }
}

/// A colour and how much of it covers what lies below.
#[derive(Clone, Copy)]
struct Ink {
    color: [f32; 3],
    strength: f32,
}

struct Canvas(Rgb8Image);

impl Canvas {
    /// A soft line about one pixel wide; positions with pixel centres at +0.5. Nothing is drawn for what is not finite.
    fn line(&mut self, from: Vec2, to: Vec2, ink: Ink) {
        let (width, height) = (self.0.width as f32, self.0.height as f32);
        let beyond = |p: Vec2| !p.is_finite() || p.abs().max_element() > 4.0 * width.max(height);
        if beyond(from) || beyond(to) {
            return;
        }
        let steps = ((to - from).abs().max_element().ceil() as usize).max(1);
        for k in 0..=steps {
            self.dot(from.lerp(to, k as f32 / steps as f32), ink);
        }
    }

    /// Spreads one pixel of ink over the four pixels around a position.
    fn dot(&mut self, at: Vec2, ink: Ink) {
        let corner = at - 0.5;
        let (base, share) = (corner.floor(), corner - corner.floor());
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (x, y) = (base.x + dx, base.y + dy);
            if x < 0.0 || y < 0.0 || x >= self.0.width as f32 || y >= self.0.height as f32 {
                continue;
            }
            let cover = (1.0 - (dx - share.x).abs()) * (1.0 - (dy - share.y).abs());
            self.blend(x as usize, y as usize, Ink { strength: ink.strength * cover, ..ink });
        }
    }

    fn blend(&mut self, x: usize, y: usize, ink: Ink) {
        let below = self.0.pixel(x, y);
        let mixed = std::array::from_fn(|c| {
            (f32::from(below[c]) + ink.strength * (ink.color[c] - f32::from(below[c])) + 0.5) as u8
        });
        self.0.set_pixel(x, y, mixed);
    }

    fn border(&mut self, thick: usize, ink: Ink) {
        let (width, height) = (self.0.width, self.0.height);
        for y in 0..height {
            for x in (0..width).filter(|x| (*x).min(width - 1 - x).min(y).min(height - 1 - y) < thick) {
                self.blend(x, y, ink);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use heartian_face::FramePose;

    use super::*;

    fn scene() -> Result<(Clip, Track), CaptureError> {
        let times_seconds = vec![0.0, 0.1, 0.2];
        let sequence = Sequence { frames: vec![40; 3 * 64 * 64 * 3], alpha: vec![255; 3 * 64 * 64], times_seconds };
        let clip = Clip::new("input", 64, 64, sequence)?;
        let pose = FramePose { translation: [0.0, 0.0, -0.6], fitted: true, ..FramePose::rest(0) };
        let frames = vec![pose.clone(), FramePose { fitted: false, ..pose.clone() }, pose];
        let track = Track {
            head: HeadModel::procedural(),
            identity: Vec::new(),
            camera: Camera::at_origin(64, 64, 100.0),
            times_seconds: clip.times_seconds.clone(),
            sigma: heartian_face::TrackSigma::default(),
            frames,
            landmark_rms_px: 0.0,
            interocular_px: 0.0,
        };
        Ok((clip, track))
    }

    #[test]
    fn the_mesh_lies_on_the_head_and_a_lost_frame_is_framed_in_red() -> Result<(), CaptureError> {
        let (clip, track) = scene()?;
        let overlay = Overlay { clip: &clip, track: &track, observations: None, scale: 2 };
        let movie = overlay.movie(0..2)?;
        assert_eq!((movie.width, movie.len(), movie.label.as_str()), (128, 2, "tracked"));
        let bright = |frame: usize, x: usize, y: usize| movie.frame(frame)[3 * (y * 128 + x) + 1] > 44;
        let inked = (40..88).flat_map(|y| (48..80).map(move |x| (x, y))).filter(|(x, y)| bright(0, *x, *y)).count();
        assert!(inked > 800, "{inked} pixels of the head carry the mesh");
        assert!(!bright(0, 2, 2), "the corner is background");
        assert!(movie.frame(1)[0] > 150, "a lost frame has a red border");
        assert!(overlay.movie(7..9).is_err(), "nothing to draw");
        Ok(())
    }

    #[test]
    fn lines_far_outside_or_without_a_place_draw_nothing() {
        let mut canvas = Canvas(Rgb8Image::filled(8, 8, [0; 3]));
        canvas.line(Vec2::splat(f32::NAN), Vec2::ZERO, MESH);
        canvas.line(Vec2::splat(1e30), Vec2::splat(-1e30), MESH);
        assert_eq!(canvas.0, Rgb8Image::filled(8, 8, [0; 3]));
        canvas.line(Vec2::new(-4.0, 4.5), Vec2::new(20.0, 4.5), SEEN);
        assert!((0..8).all(|x| canvas.0.pixel(x, 4)[1] > 150));
    }
}
