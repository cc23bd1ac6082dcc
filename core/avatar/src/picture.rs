//! One picture of canonical Gaussians in one motion, down to composited feature planes, and the exact way back.
//!
//! Activations: scale = exp, opacity and albedo = logistic, roughness = ½ + ½·logistic, reflectance =
//! 0.02 + 0.13·logistic (skin is 0.028). The normal is the third axis of the world rotation, turned to the camera.

use heartian_space::Camera;
use heartian_splat::{Frame, FrameGradient, Gaussians, Prepared, RasterOptions, SceneGradients, sigmoid};
use rayon::prelude::*;

use crate::AvatarError;
use crate::canonical::Canonical;
use crate::deform::{Deformed, Motion, MotionGradient, deform, deform_backward};

/// Roughness is `ROUGHNESS.0 + ROUGHNESS.1·logistic`.
const ROUGHNESS: (f32, f32) = (0.5, 0.5);
/// Reflectance at normal incidence is `REFLECTANCE.0 + REFLECTANCE.1·logistic`.
const REFLECTANCE: (f32, f32) = (0.02, 0.13);
/// Gaussians handled by one task.
const CHUNK: usize = 1024;

/// Which features are composited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Features {
    /// Albedo alone, 3 channels.
    Albedo,
    /// Albedo 3, normal 3, roughness, reflectance.
    Materials,
}

impl Features {
    /// Number of channels.
    pub fn channels(self) -> usize {
        match self {
            Self::Albedo => 3,
            Self::Materials => 8,
        }
    }
}

/// The Gaussians of one frame as the rasteriser takes them.
pub(crate) struct Scene {
    kind: Features,
    deformed: Deformed,
    scales: Vec<f32>,
    opacities: Vec<f32>,
    features: Vec<f32>,
    /// −1 where the third axis points away from the camera.
    facing: Vec<f32>,
}

/// A composited picture and what its backward pass needs.
pub(crate) struct Picture {
    pub scene: Scene,
    pub prepared: Prepared,
    pub frame: Frame,
}

/// Gradients that come out of one picture besides those of the canonical parameters.
pub(crate) struct PictureGradient {
    pub motion: MotionGradient,
    pub scene: SceneGradients,
}

/// What is added to the albedo of some Gaussians: to green, and in proportion to it to red and blue unless that is empty.
#[derive(Clone, Copy)]
pub(crate) struct AlbedoOffsets<'a> {
    pub gaussians: &'a [u32],
    pub green: &'a [f32],
    pub red_blue: &'a [[f32; 2]],
}

impl Scene {
    /// Deforms and activates.
    pub fn new(canonical: &Canonical, motion: &Motion, camera: &Camera, kind: Features) -> Self {
        let deformed = deform(canonical, motion);
        let count = canonical.len();
        let channels = kind.channels();
        let mut features = vec![0.0; count * channels];
        let mut facing = vec![1.0; count];
        let centre = camera.centre_in_world().to_array();
        features.par_chunks_mut(channels * CHUNK).zip(facing.par_chunks_mut(CHUNK)).enumerate().for_each(
            |(chunk, (features, facing))| {
                for (offset, (feature, facing)) in features.chunks_mut(channels).zip(facing).enumerate() {
                    let index = chunk * CHUNK + offset;
                    feature[..3].copy_from_slice(&canonical.albedo(index));
                    if kind == Features::Materials {
                        let normal = third_axis(row(&deformed.rotations, index));
                        let to_camera = subtract(centre, row(&deformed.positions, index));
                        *facing = if dot(normal, to_camera) < 0.0 { -1.0 } else { 1.0 };
                        feature[3..6].copy_from_slice(&normal.map(|n| n * *facing));
                        feature[6] = ROUGHNESS.0 + ROUGHNESS.1 * sigmoid(canonical.roughness_logits[index]);
                        feature[7] = REFLECTANCE.0 + REFLECTANCE.1 * sigmoid(canonical.reflectance_logits[index]);
                    }
                }
            },
        );
        Self {
            kind,
            deformed,
            scales: canonical.log_scales.iter().map(|s| s.exp()).collect(),
            opacities: canonical.opacity_logits.iter().map(|&o| sigmoid(o)).collect(),
            features,
            facing,
        }
    }

    /// Adds to the albedo; the sum is kept within [0, 1].
    pub fn add_albedo(&mut self, modulation: AlbedoOffsets<'_>) {
        let channels = self.kind.channels();
        let offsets = modulation.gaussians.iter().zip(modulation.green);
        for (&index, offset) in offsets.clone() {
            let green = &mut self.features[index as usize * channels + 1];
            *green = (*green + offset).clamp(0.0, 1.0);
        }
        for ((&index, offset), [red, blue]) in offsets.zip(modulation.red_blue) {
            let albedo = &mut self.features[index as usize * channels..index as usize * channels + 3];
            albedo[0] = (albedo[0] + red * offset).clamp(0.0, 1.0);
            albedo[2] = (albedo[2] + blue * offset).clamp(0.0, 1.0);
        }
    }

    /// The rasteriser's view of it.
    pub fn gaussians(&self) -> Gaussians<'_> {
        Gaussians {
            means: self.deformed.positions.as_chunks::<3>().0,
            scales: self.scales.as_chunks::<3>().0,
            rotations: self.deformed.rotations.as_chunks::<4>().0,
            opacities: &self.opacities,
            features: &self.features,
            channels: self.kind.channels(),
        }
    }

    /// Composites it.
    ///
    /// # Errors
    /// When the camera is unusable.
    pub fn picture(self, camera: &Camera) -> Result<Picture, AvatarError> {
        let (prepared, frame) = heartian_splat::render(&self.gaussians(), camera, &RasterOptions::default())?;
        Ok(Picture { scene: self, prepared, frame })
    }
}

impl Picture {
    /// Pulls gradients of the planes and the transmittance back; *adds* to `gradient`.
    ///
    /// # Errors
    /// When a plane has not the frame's size.
    pub fn backward(
        &self,
        canonical: &Canonical,
        motion: &Motion,
        upstream: &FrameGradient<'_>,
        gradient: &mut Canonical,
    ) -> Result<PictureGradient, AvatarError> {
        let scene = heartian_splat::backward(&self.scene.gaussians(), &self.prepared, &self.frame, upstream)?;
        Ok(self.scene.backward(scene, canonical, motion, gradient))
    }
}

impl Scene {
    /// Pulls the rasteriser's gradients back through activations and deformation; *adds* to `gradient`.
    pub fn backward(
        &self,
        scene: SceneGradients,
        canonical: &Canonical,
        motion: &Motion,
        gradient: &mut Canonical,
    ) -> PictureGradient {
        let mut on_deformed = Deformed {
            positions: scene.means.as_flattened().to_vec(),
            rotations: scene.rotations.as_flattened().to_vec(),
        };
        for ((to, g), s) in gradient.log_scales.iter_mut().zip(scene.scales.as_flattened()).zip(&self.scales) {
            *to += g * s;
        }
        for ((to, g), o) in gradient.opacity_logits.iter_mut().zip(&scene.opacities).zip(&self.opacities) {
            *to += g * o * (1.0 - o);
        }
        self.features_backward(&scene.features, &mut on_deformed, gradient);
        let motion = deform_backward(canonical, motion, &on_deformed, gradient);
        PictureGradient { motion, scene }
    }

    fn features_backward(&self, upstream: &[f32], on_deformed: &mut Deformed, gradient: &mut Canonical) {
        let channels = self.kind.channels();
        let rows = upstream.chunks(channels).zip(self.features.chunks(channels));
        for (index, (g, value)) in rows.enumerate() {
            for channel in 0..3 {
                let albedo = value[channel];
                gradient.albedo_logits[3 * index + channel] += g[channel] * albedo * (1.0 - albedo);
            }
            if self.kind == Features::Albedo {
                continue;
            }
            let facing = self.facing[index];
            let on_axis = [g[3] * facing, g[4] * facing, g[5] * facing];
            let on_rotation = third_axis_backward(row(&self.deformed.rotations, index), on_axis);
            for (to, from) in on_deformed.rotations[4 * index..4 * index + 4].iter_mut().zip(on_rotation) {
                *to += from;
            }
            let slope = |value: f32, (low, range): (f32, f32)| {
                let unit = (value - low) / range;
                range * unit * (1.0 - unit)
            };
            gradient.roughness_logits[index] += g[6] * slope(value[6], ROUGHNESS);
            gradient.reflectance_logits[index] += g[7] * slope(value[7], REFLECTANCE);
        }
    }
}

/// Third column of a unit quaternion's rotation.
fn third_axis([w, x, y, z]: [f32; 4]) -> [f32; 3] {
    [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
}

/// Transpose of the Jacobian of [`third_axis`].
fn third_axis_backward([w, x, y, z]: [f32; 4], [gx, gy, gz]: [f32; 3]) -> [f32; 4] {
    [
        2.0 * (y * gx - x * gy),
        2.0 * (z * gx - w * gy) - 4.0 * x * gz,
        2.0 * (w * gx + z * gy) - 4.0 * y * gz,
        2.0 * (x * gx + y * gy),
    ]
}

fn row<const N: usize>(values: &[f32], index: usize) -> [f32; N] {
    std::array::from_fn(|i| values[N * index + i])
}

fn subtract(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canonical::Group;
    use crate::rig::{POSE_SIZE, Rig};

    fn noise(seed: u32) -> impl FnMut() -> f32 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 23) as f32 - 1.0
        }
    }

    const COUNT: usize = 12;

    fn blob() -> (Canonical, Motion, Camera) {
        let mut next = noise(3);
        let mut canonical = Canonical::zeros(COUNT, 2);
        canonical.positions.iter_mut().for_each(|v| *v = 0.06 * next());
        // Far enough apart in depth that no step of a finite difference changes their order.
        canonical.positions.iter_mut().skip(2).step_by(3).enumerate().for_each(|(i, z)| *z = 0.02 * i as f32);
        canonical.log_scales.iter_mut().for_each(|v| *v = -4.3 + 0.5 * next());
        canonical.rotations.iter_mut().for_each(|v| *v = next());
        canonical.opacity_logits.iter_mut().for_each(|v| *v = 1.5 + next());
        canonical.albedo_logits.iter_mut().for_each(|v| *v = next());
        canonical.roughness_logits.iter_mut().for_each(|v| *v = next());
        canonical.reflectance_logits.iter_mut().for_each(|v| *v = next());
        canonical.bases.iter_mut().for_each(|v| *v = 0.01 * next());
        canonical.weights.iter_mut().for_each(|v| *v = 0.6 + 0.5 * next());
        let rig = Rig { joints: [[0.0, 0.01, 0.0]; 5] };
        let mut pose: [f64; POSE_SIZE] = std::array::from_fn(|_| 0.2 * f64::from(next()));
        pose[5] = -0.8;
        let motion = Motion { joints: rig.transforms(&pose), coefficients: vec![0.7, -0.4] };
        (canonical, motion, Camera::at_origin(40, 36, 70.0))
    }

    #[test]
    fn every_group_of_parameters_moves_the_picture_as_its_gradient_says() -> Result<(), AvatarError> {
        let (canonical, motion, camera) = blob();
        // The jump of alpha at 1/255 is no part of any gradient. With smooth weights it makes
        // ln(255·opacity)/(255·opacity) of a slope, 3 % here; with noise it would drown it.
        let weights: Vec<f32> = (0..8 * 40 * 36)
            .map(|i| {
                let (x, y, channel) = (i % 40, i / 40 % 36, i / 1440);
                (0.11 * x as f32 + 0.07 * y as f32 + 1.3 * channel as f32).sin()
            })
            .collect();
        let loss = |canonical: &Canonical| -> Result<f64, AvatarError> {
            let picture = Scene::new(canonical, &motion, &camera, Features::Materials).picture(&camera)?;
            Ok(picture.frame.planes.iter().zip(&weights).map(|(p, w)| f64::from(*p) * f64::from(*w)).sum())
        };
        let picture = Scene::new(&canonical, &motion, &camera, Features::Materials).picture(&camera)?;
        let mut gradient = Canonical::zeros(COUNT, 2);
        let upstream = FrameGradient { planes: &weights, ..FrameGradient::default() };
        picture.backward(&canonical, &motion, &upstream, &mut gradient)?;
        let steps = [2e-5f32, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 2e-5, 1e-3];
        for (group, step) in steps.into_iter().enumerate() {
            let mut direction: Vec<f32> = gradient.groups()[group].to_vec();
            let most = direction.iter().fold(0.0f32, |a, b| a.max(b.abs()));
            direction.iter_mut().for_each(|d| *d *= step / most);
            let moved = |sign: f32| {
                let mut canonical = canonical.clone();
                canonical.groups_mut()[group].iter_mut().zip(&direction).for_each(|(v, d)| *v += sign * d);
                loss(&canonical)
            };
            let found = (moved(1.0)? - moved(-1.0)?) / 2.0;
            let expected: f64 =
                gradient.groups()[group].iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
            assert!((found / expected - 1.0).abs() < 0.05, "group {group}: {found} against {expected}");
        }
        assert_eq!(Group::Weights as usize, steps.len() - 1);
        Ok(())
    }

    #[test]
    fn offsets_touch_what_they_name_and_stay_in_range() {
        let (canonical, motion, camera) = blob();
        let plain = Scene::new(&canonical, &motion, &camera, Features::Materials);
        let modulated = |red_blue: &[[f32; 2]]| {
            let mut scene = Scene::new(&canonical, &motion, &camera, Features::Materials);
            scene.add_albedo(AlbedoOffsets { gaussians: &[4, 9], green: &[0.01, 5.0], red_blue });
            let changed: Vec<usize> =
                (0..plain.features.len()).filter(|i| plain.features[*i] != scene.features[*i]).collect();
            (scene, changed)
        };
        let (scene, changed) = modulated(&[]);
        assert_eq!(changed, [4 * 8 + 1, 9 * 8 + 1]);
        assert_eq!(scene.features[9 * 8 + 1], 1.0);
        let (scene, changed) = modulated(&[[0.5, 0.25], [0.0, -1.0]]);
        assert_eq!(changed, [4 * 8, 4 * 8 + 1, 4 * 8 + 2, 9 * 8 + 1, 9 * 8 + 2]);
        assert!((scene.features[4 * 8] - plain.features[4 * 8] - 0.005).abs() < 1e-6);
        assert_eq!(scene.features[9 * 8 + 2], 0.0);
    }
}
