//! One head, one light, one camera: everything of a synthetic recording that does not change, and how a frame is drawn.
//!
//! A frame is a pure function of the scene, its number, its pose and the pulse, so frames can be drawn in any order.

use glam::{Quat, Vec2, Vec3};
use heartian_face::{FramePose, HeadModel, vertex_normals};
use heartian_space::Camera;

use super::look::HAEMOGLOBIN;
use super::material::{Materials, Part, VertexMaterial};
use super::random::{Random, Stream};
use super::sensor::Sensor;
use crate::mesh::{
    EIGHT_SAMPLES, Fragment, Lighting, ScreenVertex, Surface, Transfer, VisibilityBuffer, shade, visibility_basis,
};

/// The most area lights a scene has.
const LIGHTS: usize = 3;
/// Standard deviation of the matte's error on a half-covered pixel of the outline.
const MATTE_NOISE: f32 = 0.03;
/// A landmark hidden by a surface this much nearer is occluded, metres.
const OCCLUSION_METRES: f32 = 0.008;

/// The buffer a thread draws into.
pub(crate) type Canvas = VisibilityBuffer<8>;

/// Blood at one moment.
pub(crate) struct Blood<'a> {
    /// Relative change of green albedo where strength and pulse are 1.
    pub(crate) strength: f32,
    /// The pulse that reaches a place `delay` seconds later than the face's mean.
    pub(crate) pulse_at_delay: &'a (dyn Fn(f32) -> f32 + Sync),
}

/// One drawn frame.
pub(crate) struct Frame {
    /// `H×W×3`, sRGB.
    pub(crate) colors: Vec<u8>,
    /// `H×W`.
    pub(crate) alpha: Vec<u8>,
    /// `⌈H·W/8⌉` bytes, lowest bit first: pixels that are mostly pulsatile skin.
    pub(crate) skin: Vec<u8>,
    /// The model's landmarks in its own order: position in pixels, and confidence in [0, 1] (0 when hidden).
    pub(crate) landmarks: Vec<(Vec2, f32)>,
}

/// What stays the same over a recording.
pub(crate) struct Scene {
    /// The head with its identity baked in.
    pub(crate) head: HeadModel,
    pub(crate) camera: Camera,
    lighting: Lighting,
    pub(crate) materials: Materials,
    transfer: Transfer,
    /// Linear light behind the head.
    background: Vec<Vec3>,
    sensor: Sensor,
    seed: u64,
}

/// What varies over a triangle, interpolated with perspective.
#[derive(Clone, Copy)]
struct Varying([f32; Varying::SIZE]);

impl Varying {
    const REST: usize = 0;
    const NORMAL: usize = 3;
    const IRRADIANCE: usize = 6;
    const ALBEDO: usize = 9;
    const VISIBILITY: usize = 12;
    const OPENNESS: usize = 12 + LIGHTS;
    const PULSE: usize = 13 + LIGHTS;
    const HAIR: usize = 14 + LIGHTS;
    const LIPS: usize = 15 + LIGHTS;
    const MATTE: usize = 16 + LIGHTS;
    const SIZE: usize = 17 + LIGHTS;

    fn put(&mut self, at: usize, value: Vec3) {
        self.0[at..at + 3].copy_from_slice(&value.to_array());
    }

    fn get(&self, at: usize) -> Vec3 {
        Vec3::new(self.0[at], self.0[at + 1], self.0[at + 2])
    }
}

impl Scene {
    /// Prepares a scene of a head whose identity is baked in. Shadows are those of a mouth a little open, so that what
    /// lies behind the lips is dark but not black.
    pub(crate) fn new(head: HeadModel, materials: Materials, lighting: Lighting, camera: Camera, seed: u64) -> Self {
        let opened = FramePose { jaw: [0.12, 0.0, 0.0], ..FramePose::rest(head.expression.count) };
        let vertices = head.pose(&opened);
        let normals = to_vectors(&vertex_normals(&vertices, &head.triangles));
        let transfer = Transfer::new(&to_vectors(&vertices), &normals, &head.triangles);
        let background = background(&camera, &lighting);
        Self { head, camera, lighting, materials, transfer, background, sensor: Sensor::new(), seed }
    }

    /// A canvas of this scene's size.
    pub(crate) fn canvas(&self) -> Canvas {
        VisibilityBuffer::new(self.camera.width, self.camera.height, EIGHT_SAMPLES)
    }

    /// Draws frame `number`.
    pub(crate) fn draw(&self, canvas: &mut Canvas, number: u64, pose: &FramePose, blood: &Blood) -> Frame {
        let world = self.head.pose(pose);
        let normals = to_vectors(&vertex_normals(&world, &self.head.triangles));
        let screen: Vec<ScreenVertex> = world.iter().map(|point| self.to_screen(Vec3::from_array(*point))).collect();
        canvas.clear();
        canvas.draw(&screen, &self.head.triangles);
        let rotation = Quat::from_scaled_axis(Vec3::from_array(pose.rotation));
        let varyings = self.varyings(&normals, rotation, blood);
        let view = View { scene: self, screen: &screen, varyings: &varyings, world_from_head: rotation };
        let landmarks = self.landmarks(canvas, &world, &normals);
        self.develop(canvas, number, &view, landmarks)
    }

    fn to_screen(&self, point_in_world: Vec3) -> ScreenVertex {
        let depth = self.camera.camera_from_world_point(point_in_world).z;
        match self.camera.project(point_in_world) {
            Some(position_px) => ScreenVertex { position_px, nearness: 1.0 / depth },
            None => ScreenVertex { position_px: Vec2::ZERO, nearness: f32::NAN },
        }
    }

    /// Lights every vertex and lets blood into its skin.
    fn varyings(&self, normals: &[Vec3], world_from_head: Quat, blood: &Blood) -> Vec<Varying> {
        let head_from_world = world_from_head.conjugate();
        let lights = &self.lighting.lights;
        let bases: Vec<_> = lights
            .iter()
            .map(|light| visibility_basis(head_from_world * light.direction_in_world, light.half_angle_radians))
            .collect();
        self.materials
            .vertices
            .iter()
            .enumerate()
            .map(|(vertex, material)| {
                let mut varying = Varying([0.0; Varying::SIZE]);
                let (normal, openness) = (normals[vertex], self.transfer.openness[vertex]);
                let mut irradiance = self.lighting.ambient_irradiance(normal) * openness;
                for (number, (light, basis)) in lights.iter().zip(&bases).take(LIGHTS).enumerate() {
                    let visible = self.transfer.visibility(vertex, basis);
                    irradiance += light.irradiance * (light.cosine(normal) * visible);
                    varying.0[Varying::VISIBILITY + number] = visible;
                }
                varying.put(Varying::REST, Vec3::from_array(self.head.vertices[vertex]));
                varying.put(Varying::NORMAL, normal);
                varying.put(Varying::IRRADIANCE, irradiance);
                varying.put(Varying::ALBEDO, pulsed_albedo(material, blood));
                varying.0[Varying::OPENNESS] = openness;
                varying.0[Varying::PULSE] = material.pulse;
                varying.0[Varying::HAIR] = material.hair;
                varying.0[Varying::LIPS] = material.lips;
                varying.0[Varying::MATTE] = material.matte;
                varying
            })
            .collect()
    }

    /// Shades what the canvas sees and exposes the sensor.
    fn develop(&self, canvas: &Canvas, number: u64, view: &View, landmarks: Vec<(Vec2, f32)>) -> Frame {
        let (width, height) = (self.camera.width, self.camera.height);
        let pixels = width * height;
        let noise = Random::new(self.seed, Stream::Sensor).substream(number);
        let matte_noise = Random::new(self.seed, Stream::Matte).substream(number);
        let mut frame =
            Frame { colors: vec![0; 3 * pixels], alpha: vec![0; pixels], skin: vec![0; pixels.div_ceil(8)], landmarks };
        for pixel in 0..pixels {
            let (mut light, mut covered, mut matte, mut skin) = (Vec3::ZERO, 0.0f32, 0.0f32, 0.0f32);
            for fragment in canvas.fragments(pixel % width, pixel / width) {
                let seen = view.shade(&fragment);
                light += seen.radiance * fragment.coverage;
                covered += fragment.coverage;
                matte += seen.matte * fragment.coverage;
                skin += seen.skin * fragment.coverage;
            }
            light += self.background[pixel] * (1.0 - covered);
            for channel in 0..3 {
                let counter = (3 * pixel + channel) as u64;
                frame.colors[3 * pixel + channel] = self.sensor.expose(light[channel], noise, counter);
            }
            if matte > 0.0 {
                let spread = MATTE_NOISE * (4.0 * covered * (1.0 - covered).max(0.0)).sqrt();
                let noisy = matte + spread * matte_noise.fast_normal(pixel as u64);
                frame.alpha[pixel] = (255.0 * noisy + 0.5).clamp(0.0, 255.0) as u8;
            }
            if skin > 0.5 {
                frame.skin[pixel / 8] |= 1 << (pixel % 8);
            }
        }
        frame
    }

    /// Where the landmarks are, and how well they show: less where the skin turns away, 0 where something hides it.
    fn landmarks(&self, canvas: &Canvas, world: &[[f32; 3]], normals: &[Vec3]) -> Vec<(Vec2, f32)> {
        self.head
            .landmarks
            .iter()
            .map(|anchor| {
                let point = Vec3::from_array(self.head.landmark_position(anchor, world));
                let corners = self.head.triangles[anchor.triangle as usize];
                let normal: Vec3 = (0..3).map(|c| normals[corners[c] as usize] * anchor.barycentric[c]).sum();
                let to_viewer = (self.camera.centre_in_world() - point).normalize_or(Vec3::Z);
                let facing = normal.normalize_or_zero().dot(to_viewer);
                let screen = self.to_screen(point);
                let shown = ((facing + 0.1) / 0.4).clamp(0.0, 1.0);
                let hidden = self.is_hidden(canvas, &screen);
                (screen.position_px, if hidden { 0.0 } else { shown })
            })
            .collect()
    }

    fn is_hidden(&self, canvas: &Canvas, screen: &ScreenVertex) -> bool {
        let [x, y] = screen.position_px.to_array();
        let inside = x >= 0.0 && y >= 0.0 && x < self.camera.width as f32 && y < self.camera.height as f32;
        if !inside || !screen.nearness.is_finite() {
            return true;
        }
        let nearest = canvas.nearness(x as usize, y as usize);
        nearest > 0.0 && 1.0 / screen.nearness - 1.0 / nearest > OCCLUSION_METRES
    }
}

/// One frame's geometry, ready to shade.
struct View<'a> {
    scene: &'a Scene,
    screen: &'a [ScreenVertex],
    varyings: &'a [Varying],
    world_from_head: Quat,
}

struct Seen {
    radiance: Vec3,
    matte: f32,
    skin: f32,
}

impl View<'_> {
    fn shade(&self, fragment: &Fragment) -> Seen {
        let scene = self.scene;
        let varying = self.interpolate(fragment);
        let rest = varying.get(Varying::REST);
        let part = scene.materials.parts[fragment.triangle as usize];
        let vertex = VertexMaterial {
            albedo: varying.get(Varying::ALBEDO),
            pulse: varying.0[Varying::PULSE],
            delay_seconds: 0.0,
            hair: varying.0[Varying::HAIR],
            lips: varying.0[Varying::LIPS],
            matte: varying.0[Varying::MATTE],
        };
        let texel =
            if part == Part::Skin { scene.materials.skin(rest, &vertex) } else { scene.materials.other(part, rest) };
        let to_viewer = -scene.camera.ray_in_world(fragment.position_px);
        let normal = (varying.get(Varying::NORMAL) + self.world_from_head * texel.tilt).normalize_or(to_viewer);
        let surface = Surface {
            albedo: texel.albedo,
            roughness: texel.gloss.roughness,
            f0: texel.gloss.f0,
            normal_in_world: normal,
            irradiance: varying.get(Varying::IRRADIANCE),
            visibility: &varying.0[Varying::VISIBILITY..Varying::VISIBILITY + scene.lighting.lights.len().min(LIGHTS)],
            openness: varying.0[Varying::OPENNESS],
        };
        Seen {
            radiance: shade(&scene.lighting, &surface, to_viewer),
            matte: vertex.matte,
            skin: texel.skin * (vertex.pulse * 10.0 - 1.0).clamp(0.0, 1.0),
        }
    }

    /// Perspective-correct interpolation at the fragment's position.
    fn interpolate(&self, fragment: &Fragment) -> Varying {
        let corners = self.scene.head.triangles[fragment.triangle as usize].map(|vertex| vertex as usize);
        let [a, b, c] = corners.map(|vertex| self.screen[vertex]);
        let cross = |u: Vec2, v: Vec2| u.perp_dot(v);
        let p = fragment.position_px;
        let areas = [
            cross(b.position_px - p, c.position_px - p),
            cross(c.position_px - p, a.position_px - p),
            cross(a.position_px - p, b.position_px - p),
        ];
        let total: f32 = areas.iter().sum();
        let sign = total.signum();
        let weights: [f32; 3] =
            std::array::from_fn(|i| (areas[i] * sign).max(0.0) * [a.nearness, b.nearness, c.nearness][i]);
        let sum: f32 = weights.iter().sum();
        let weights = if sum > 0.0 { weights.map(|w| w / sum) } else { [1.0 / 3.0; 3] };
        let mut varying = Varying([0.0; Varying::SIZE]);
        for (corner, weight) in corners.into_iter().zip(weights) {
            for (sum, value) in varying.0.iter_mut().zip(&self.varyings[corner].0) {
                *sum += weight * value;
            }
        }
        varying
    }
}

fn pulsed_albedo(material: &VertexMaterial, blood: &Blood) -> Vec3 {
    if material.pulse == 0.0 || blood.strength == 0.0 {
        return material.albedo;
    }
    let change = blood.strength * material.pulse * (blood.pulse_at_delay)(material.delay_seconds);
    material.albedo * (Vec3::ONE - HAEMOGLOBIN * change)
}

/// A wall out of focus: a soft gradient in the light's own colour.
fn background(camera: &Camera, lighting: &Lighting) -> Vec<Vec3> {
    let tint = lighting.irradiance(Vec3::Z);
    let wall = Vec3::new(0.20, 0.23, 0.25) * tint;
    let (width, height) = (camera.width as f32, camera.height as f32);
    (0..camera.height)
        .flat_map(|y| (0..camera.width).map(move |x| (x as f32 / width - 0.5, y as f32 / height - 0.5)))
        .map(|(x, y)| wall * (1.15 - 0.35 * y + 0.20 * x - 0.45 * (x * x + y * y)))
        .collect()
}

fn to_vectors(points: &[[f32; 3]]) -> Vec<Vec3> {
    points.iter().map(|point| Vec3::from_array(*point)).collect()
}
