//! What a head is made of: per-vertex maps, and the procedural texture of one surface point.
//!
//! Textures live in rest coordinates (head space, metres, identity baked in), so they move with the skin.

use glam::Vec3;
use heartian_face::{HeadModel, Region, joint};

use super::anatomy::{Anatomy, weight_at};
use super::look::{SkinTone, skin_albedo};
use super::random::{LatticeNoise, Random, Stream};

const HAIR: Vec3 = Vec3::new(0.040, 0.026, 0.018);
const SCLERA: Vec3 = Vec3::new(0.62, 0.57, 0.54);
const TEETH: Vec3 = Vec3::new(0.58, 0.54, 0.45);
const MOUTH_LINING: Vec3 = Vec3::new(0.20, 0.055, 0.050);
/// Rounds of neighbour averaging at the hairline.
const HAIRLINE_BLURS: usize = 3;
/// Iris and pupil as angles from the eye's axis, radians: 6 mm and 2 mm on a 12 mm eyeball.
const IRIS_RADIANS: f32 = 0.49;
const PUPIL_RADIANS: f32 = 0.17;

/// Gloss of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gloss {
    pub(crate) roughness: f32,
    pub(crate) f0: f32,
}

const SKIN_GLOSS: Gloss = Gloss { roughness: 0.45, f0: 0.028 };
const LIP_GLOSS: Gloss = Gloss { roughness: 0.36, f0: 0.030 };
const HAIR_GLOSS: Gloss = Gloss { roughness: 0.55, f0: 0.016 };
const EYE_GLOSS: Gloss = Gloss { roughness: 0.16, f0: 0.035 };
const MOUTH_GLOSS: Gloss = Gloss { roughness: 0.35, f0: 0.030 };

/// What a whole triangle belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Skin, lips, brows, ears, neck and hair, told apart by the vertex maps.
    Skin,
    /// An eyeball: 0 left, 1 right.
    Eye(usize),
    Mouth,
    Teeth,
}

/// What one vertex is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct VertexMaterial {
    /// Diffuse albedo of skin without pulse, hair and brows.
    pub(crate) albedo: Vec3,
    /// Strength of the pulse, 0 where there is no blood under the surface and about 1 at the forehead and cheeks.
    pub(crate) pulse: f32,
    /// When the pulse wave arrives relative to the face's mean, seconds.
    pub(crate) delay_seconds: f32,
    /// 1 = hair-bearing.
    pub(crate) hair: f32,
    /// 1 = red of the lips.
    pub(crate) lips: f32,
    /// What the matte keeps: 1, fading to 0 down the neck.
    pub(crate) matte: f32,
}

/// The materials of one head.
pub(crate) struct Materials {
    pub(crate) vertices: Vec<VertexMaterial>,
    pub(crate) parts: Vec<Part>,
    anatomy: Anatomy,
    eye_centres: [Vec3; 2],
    hair_centre: Vec3,
    noise: LatticeNoise,
    brow_albedo: Vec3,
    iris_albedo: Vec3,
}

/// One surface point, textured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Texel {
    pub(crate) albedo: Vec3,
    pub(crate) gloss: Gloss,
    /// Tilt to add to the normal before normalising, head space.
    pub(crate) tilt: Vec3,
    /// How much of the point is pulsatile facial skin, in [0, 1].
    pub(crate) skin: f32,
}

impl Materials {
    /// Paints a head whose identity is baked in.
    pub(crate) fn new(head: &HeadModel, tone: SkinTone, seed: u64) -> Self {
        let random = Random::new(seed, Stream::Texture);
        let noise = LatticeNoise::new(random);
        let anatomy = Anatomy::new(head);
        let painter = Painter { anatomy: &anatomy, noise, tone, neck: head.neck_fade() };
        let mut vertices: Vec<VertexMaterial> = head
            .vertices
            .iter()
            .zip(&head.regions)
            .map(|(vertex, region)| painter.vertex(Vec3::from_array(*vertex), *region))
            .collect();
        soften(&mut vertices, &head.triangles);
        let scalp: Vec<Vec3> = head
            .vertices
            .iter()
            .zip(&head.regions)
            .filter(|(_, region)| **region == Region::Scalp)
            .map(|(vertex, _)| Vec3::from_array(*vertex))
            .collect();
        let irises = [Vec3::new(0.060, 0.030, 0.014), Vec3::new(0.075, 0.070, 0.035), Vec3::new(0.055, 0.085, 0.110)];
        Self {
            vertices,
            parts: parts(head),
            eye_centres: [joint::EYE_LEFT, joint::EYE_RIGHT].map(|eye| Vec3::from_array(head.joints[eye])),
            hair_centre: scalp.iter().sum::<Vec3>() / (scalp.len().max(1)) as f32,
            noise,
            brow_albedo: HAIR * 1.1,
            iris_albedo: irises[(random.bits(1) % 3) as usize],
            anatomy,
        }
    }

    /// Mean albedo of the facial skin's vertices.
    pub(crate) fn mean_skin_albedo(&self) -> Vec3 {
        let is_face = |vertex: &&VertexMaterial| vertex.pulse > 0.5 && vertex.hair == 0.0 && vertex.lips == 0.0;
        let (sum, count) = self
            .vertices
            .iter()
            .filter(is_face)
            .fold((Vec3::ZERO, 0u32), |(sum, count), vertex| (sum + vertex.albedo, count + 1));
        sum / count.max(1) as f32
    }

    /// Texture of the skin part at a rest position, from interpolated vertex values.
    pub(crate) fn skin(&self, rest: Vec3, vertex: &VertexMaterial) -> Texel {
        let mut texel = Texel { albedo: vertex.albedo, gloss: SKIN_GLOSS, tilt: Vec3::ZERO, skin: 1.0 };
        let lips = smoothstep(0.30, 0.70, vertex.lips);
        texel.gloss = blend(texel.gloss, LIP_GLOSS, lips);
        texel.skin *= 1.0 - lips;
        if vertex.hair < 0.10 {
            self.add_face_hair(rest, &mut texel);
        }
        if vertex.hair > 0.02 {
            self.add_hair(rest, vertex.hair, &mut texel);
        }
        texel
    }

    /// Texture of an eyeball, of the mouth or of the teeth.
    pub(crate) fn other(&self, part: Part, rest: Vec3) -> Texel {
        let (albedo, gloss) = match part {
            Part::Eye(eye) => (self.eye_albedo(rest - self.eye_centres[eye]), EYE_GLOSS),
            Part::Teeth => (TEETH * (0.92 + 0.08 * (rest.x * 850.0).cos()), MOUTH_GLOSS),
            Part::Mouth | Part::Skin => (MOUTH_LINING, MOUTH_GLOSS),
        };
        Texel { albedo, gloss, tilt: Vec3::ZERO, skin: 0.0 }
    }

    fn eye_albedo(&self, from_centre: Vec3) -> Vec3 {
        let angle = from_centre.x.hypot(from_centre.y).atan2(from_centre.z);
        let veins = 0.5 + 0.5 * self.noise.at(from_centre * 700.0);
        let sclera = SCLERA * Vec3::new(1.0, 1.0 - 0.10 * veins * angle, 1.0 - 0.12 * veins * angle);
        let ray = self.noise.at(Vec3::new(from_centre.y.atan2(from_centre.x) * 5.0, angle * 6.0, 3.0));
        let iris = self.iris_albedo * (1.0 + 0.5 * ray) * (1.25 - 0.9 * smoothstep(0.75, 1.0, angle / IRIS_RADIANS));
        let with_iris = sclera.lerp(iris, smoothstep(1.06, 0.94, angle / IRIS_RADIANS));
        with_iris.lerp(Vec3::splat(0.004), smoothstep(1.12, 0.88, angle / PUPIL_RADIANS))
    }

    /// Brows and lashes.
    fn add_face_hair(&self, rest: Vec3, texel: &mut Texel) {
        for brow in &self.anatomy.brows {
            if let Some(place) = brow.locate(rest) {
                let slant = Vec3::new(rest.x.abs() * 620.0 - rest.y * 480.0, rest.y * 160.0, rest.x.signum() * 9.0);
                let cover = 0.84 * smoothstep(1.30, 0.35, place.across + 0.22 * self.noise.at(slant));
                texel.albedo = texel.albedo.lerp(self.brow_albedo, cover);
                texel.skin *= 1.0 - cover;
            }
        }
        for lash in &self.anatomy.lashes {
            if let Some(place) = lash.locate(rest) {
                let cover = 0.75 * smoothstep(1.3, 0.5, place.across) * smoothstep(0.0, 0.12, 1.0 - place.along);
                texel.albedo = texel.albedo.lerp(self.brow_albedo, cover);
                texel.skin *= 1.0 - cover;
            }
        }
    }

    fn add_hair(&self, rest: Vec3, hair: f32, texel: &mut Texel) {
        let from_centre = rest - self.hair_centre;
        // Strands run from the hairline over the crown: fine around the head, long along it.
        let around = from_centre.x.atan2(from_centre.y.max(0.0) + 0.5 * from_centre.z.abs() + 0.02);
        let along = from_centre.z.atan2(from_centre.y + 0.03);
        let strands = 0.65 * self.noise.at(Vec3::new(around * 26.0, along * 3.0, 1.0))
            + 0.35 * self.noise.at(Vec3::new(around * 55.0, along * 5.0, 7.0));
        let cover = smoothstep(0.32, 0.62, hair + 0.20 * strands);
        let albedo = HAIR * (1.0 + 0.75 * strands);
        texel.albedo = texel.albedo.lerp(albedo, cover);
        texel.gloss = blend(texel.gloss, HAIR_GLOSS, cover);
        texel.tilt += Vec3::new(0.45 * strands * cover, 0.0, 0.0);
        texel.skin *= 1.0 - cover;
    }
}

/// Paints vertices.
struct Painter<'a> {
    anatomy: &'a Anatomy,
    noise: LatticeNoise,
    tone: SkinTone,
    /// Heights between which the matte fades out, lower first.
    neck: [f32; 2],
}

impl Painter<'_> {
    fn vertex(&self, rest: Vec3, region: Region) -> VertexMaterial {
        let lips = f32::from(u8::from(region == Region::Lips));
        VertexMaterial {
            albedo: self.albedo(rest, region),
            pulse: self.pulse_strength(rest, region),
            delay_seconds: self.delay_seconds(rest),
            hair: f32::from(u8::from(region == Region::Scalp)),
            lips,
            matte: smoothstep(self.neck[0], self.neck[1], rest.y),
        }
    }

    /// Blood and pigment by place: redder cheeks, nose, ears, chin and lips, darker around the eyes, mottled.
    fn albedo(&self, rest: Vec3, region: Region) -> Vec3 {
        let at = |places| weight_at(places, rest);
        let blotches = self.noise.fractal(rest * 45.0, 2);
        let flecks = self.noise.fractal(rest * 130.0 + 5.0, 2);
        let mut haemoglobin =
            0.40 + 0.17 * at(&self.anatomy.cheeks) + 0.20 * at(&self.anatomy.nose_tip) + 0.08 * at(&self.anatomy.chin)
                - 0.05 * at(&self.anatomy.forehead)
                + 0.07 * blotches
                + 0.04 * flecks;
        let mut melanin =
            self.tone.melanin() * (1.0 + 0.16 * at(&self.anatomy.orbits) + 0.08 * blotches + 0.05 * flecks);
        match region {
            Region::Lips => {
                haemoglobin += 0.62;
                melanin = 0.75 * melanin + 0.05;
            }
            Region::Ear => haemoglobin += 0.16,
            Region::Neck => haemoglobin -= 0.04,
            _ => {}
        }
        let nostril = at(&self.anatomy.nostrils);
        skin_albedo(melanin, haemoglobin.max(0.1)) * (1.0 - 0.85 * nostril)
    }

    fn pulse_strength(&self, rest: Vec3, region: Region) -> f32 {
        let at = |places| weight_at(places, rest);
        let base = match region {
            Region::Skin | Region::Brow => 0.70,
            Region::Lips | Region::Ear => 0.55,
            Region::Neck => 0.40,
            Region::Scalp => 0.30,
            Region::EyeLeft | Region::EyeRight | Region::Mouth => return 0.0,
        };
        let favoured = 0.32 * at(&self.anatomy.cheeks).max(at(&self.anatomy.forehead));
        base + favoured - 0.12 * at(&self.anatomy.orbits) + 0.08 * self.noise.fractal(rest * 30.0 + 40.0, 2)
    }

    /// The wave climbs the face in about 30 ms, with small detours.
    fn delay_seconds(&self, rest: Vec3) -> f32 {
        (0.16 * rest.y + 0.006 * self.noise.at(rest * 28.0 + 80.0)).clamp(-0.025, 0.025)
    }
}

/// Blurs the borders of hair and lips over about two triangles, so that texture, not the mesh, decides where they run.
fn soften(vertices: &mut [VertexMaterial], triangles: &[[u32; 3]]) {
    for _ in 0..HAIRLINE_BLURS {
        let mut sums: Vec<(f32, f32)> = vertices.iter().map(|vertex| (2.0 * vertex.hair, 2.0)).collect();
        for triangle in triangles {
            for corner in 0..3 {
                let sum = &mut sums[triangle[corner] as usize];
                sum.0 += vertices[triangle[(corner + 1) % 3] as usize].hair;
                sum.1 += 1.0;
            }
        }
        for (vertex, (sum, count)) in vertices.iter_mut().zip(sums) {
            vertex.hair = sum / count;
        }
    }
}

/// The part of each triangle. Teeth are the pieces of mouth that hang on no other region.
fn parts(head: &HeadModel) -> Vec<Part> {
    let pieces = pieces(head.vertices.len(), &head.triangles);
    let mut lone_mouth = vec![true; head.vertices.len()];
    for (vertex, region) in head.regions.iter().enumerate() {
        if *region != Region::Mouth {
            lone_mouth[pieces[vertex]] = false;
        }
    }
    head.triangles
        .iter()
        .map(|triangle| {
            let corners = triangle.map(|vertex| head.regions[vertex as usize]);
            match corners[0] {
                Region::EyeLeft => Part::Eye(0),
                Region::EyeRight => Part::Eye(1),
                _ if corners.contains(&Region::Mouth) => {
                    if lone_mouth[pieces[triangle[0] as usize]] {
                        Part::Teeth
                    } else {
                        Part::Mouth
                    }
                }
                _ => Part::Skin,
            }
        })
        .collect()
}

/// For each vertex, the lowest vertex it is connected to.
fn pieces(count: usize, triangles: &[[u32; 3]]) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..count).collect();
    fn root(parent: &mut [usize], mut vertex: usize) -> usize {
        while parent[vertex] != vertex {
            parent[vertex] = parent[parent[vertex]];
            vertex = parent[vertex];
        }
        vertex
    }
    for triangle in triangles {
        for corner in 1..3 {
            let (a, b) = (root(&mut parent, triangle[0] as usize), root(&mut parent, triangle[corner] as usize));
            parent[a.max(b)] = a.min(b);
        }
    }
    (0..count).map(|vertex| root(&mut parent, vertex)).collect()
}

fn blend(from: Gloss, to: Gloss, weight: f32) -> Gloss {
    Gloss {
        roughness: from.roughness + weight * (to.roughness - from.roughness),
        f0: from.f0 + weight * (to.f0 - from.f0),
    }
}

/// 0 at `from`, 1 at `to`, smooth between; `from` may be the larger.
pub(crate) fn smoothstep(from: f32, to: f32, value: f32) -> f32 {
    let t = ((value - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
