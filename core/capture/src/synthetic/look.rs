//! The choices a synthetic recording offers: light and skin tone.
//!
//! Skin colour follows two absorbers over a scattering base, Beer–Lambert in each channel: melanin by tone, haemoglobin
//! by place and, a little, by the pulse. Albedo and light are linear RGB.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::mesh::{AreaLight, Lighting};

/// The light of a synthetic recording; it does not change while the camera runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Light {
    /// A large soft key, a weaker fill, a faint rim from behind.
    #[default]
    Studio,
    /// A tall window at the camera's left, a dim room.
    Window,
    /// A warm lamp above.
    Warm,
    /// A cool screen-like light, low and frontal.
    Cool,
    /// Grey daylight from the whole sky.
    Overcast,
}

impl Light {
    /// All lights, in the order of their declaration.
    pub const ALL: [Light; 5] = [Light::Studio, Light::Window, Light::Warm, Light::Cool, Light::Overcast];

    /// The lights and the ambient gradient, of irradiance about 1 on a surface that faces the camera.
    pub(crate) fn lighting(self) -> Lighting {
        let area = |direction: [f32; 3], irradiance: [f32; 3], half_angle_radians: f32| AreaLight {
            direction_in_world: Vec3::from_array(direction).normalize(),
            irradiance: Vec3::from_array(irradiance),
            half_angle_radians,
        };
        let (lights, [ambient, ambient_up, ambient_right]) = match self {
            Light::Studio => (
                vec![
                    area([0.50, 0.34, 0.80], [0.90, 0.88, 0.85], 0.40),
                    area([-0.75, 0.10, 0.65], [0.24, 0.25, 0.27], 0.65),
                    area([-0.45, 0.60, -0.65], [0.30, 0.30, 0.31], 0.35),
                ],
                [[0.15, 0.15, 0.16], [0.05, 0.05, 0.05], [0.0, 0.0, 0.0]],
            ),
            Light::Window => (
                vec![
                    area([-0.80, 0.30, 0.60], [1.05, 1.12, 1.20], 0.55),
                    area([0.9, 0.1, 0.4], [0.10, 0.09, 0.08], 0.9),
                ],
                [[0.24, 0.24, 0.24], [0.04, 0.04, 0.05], [-0.08, -0.08, -0.08]],
            ),
            Light::Warm => (
                vec![
                    area([0.30, 0.70, 0.70], [1.18, 0.92, 0.62], 0.30),
                    area([-0.6, 0.2, 0.7], [0.24, 0.18, 0.12], 0.7),
                ],
                [[0.26, 0.21, 0.16], [0.03, 0.03, 0.02], [0.0, 0.0, 0.0]],
            ),
            Light::Cool => (
                vec![
                    area([-0.15, -0.10, 0.98], [0.52, 0.66, 0.86], 0.40),
                    area([0.6, 0.6, 0.5], [0.20, 0.24, 0.30], 0.8),
                ],
                [[0.17, 0.21, 0.26], [0.03, 0.04, 0.05], [0.0, 0.0, 0.0]],
            ),
            Light::Overcast => (
                vec![area([0.05, 0.90, 0.45], [0.55, 0.57, 0.60], 1.10)],
                [[0.62, 0.64, 0.66], [0.30, 0.31, 0.33], [0.0, 0.0, 0.0]],
            ),
        };
        Lighting {
            lights,
            ambient: Vec3::from_array(ambient),
            ambient_up: Vec3::from_array(ambient_up),
            ambient_right: Vec3::from_array(ambient_right),
        }
    }
}

/// Skin tones from light to dark, by melanin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum SkinTone {
    /// About Fitzpatrick I–II.
    #[default]
    Light,
    /// About Fitzpatrick III.
    Medium,
    /// About Fitzpatrick IV.
    Tan,
    /// About Fitzpatrick V.
    Brown,
    /// About Fitzpatrick VI.
    Dark,
}

/// What is left of white light in bloodless, unpigmented skin.
const SCATTERING_BASE: Vec3 = Vec3::new(0.82, 0.68, 0.47);
/// Absorption of one unit of melanin.
const MELANIN: Vec3 = Vec3::new(0.84, 1.05, 1.25);
/// Absorption of one unit of haemoglobin; its ratios 0.30 : 1 : 0.55 are those of the pulse in a camera's R, G and B.
pub(crate) const HAEMOGLOBIN: Vec3 = Vec3::new(0.30, 1.0, 0.55);

impl SkinTone {
    /// All tones, light to dark.
    pub const ALL: [SkinTone; 5] = [SkinTone::Light, SkinTone::Medium, SkinTone::Tan, SkinTone::Brown, SkinTone::Dark];

    pub(crate) fn melanin(self) -> f32 {
        match self {
            SkinTone::Light => 0.20,
            SkinTone::Medium => 0.50,
            SkinTone::Tan => 0.90,
            SkinTone::Brown => 1.40,
            SkinTone::Dark => 1.95,
        }
    }

    /// How much the camera opens for this tone, 1 for the lightest: partly, as automatic exposure does.
    pub(crate) fn exposure(self) -> f32 {
        (0.28 * (self.melanin() - SkinTone::Light.melanin()) * MELANIN.y).exp()
    }
}

/// Diffuse albedo of skin with this much of each absorber.
pub(crate) fn skin_albedo(melanin: f32, haemoglobin: f32) -> Vec3 {
    let absorption = MELANIN * melanin + HAEMOGLOBIN * haemoglobin;
    SCATTERING_BASE * Vec3::new((-absorption.x).exp(), (-absorption.y).exp(), (-absorption.z).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_space::color::luminance;

    #[test]
    fn tones_darken_and_blood_reddens() {
        let albedos = SkinTone::ALL.map(|tone| skin_albedo(tone.melanin(), 0.4));
        assert!(albedos.windows(2).all(|pair| luminance(pair[1].to_array()) < 0.8 * luminance(pair[0].to_array())));
        assert!(albedos.iter().all(|a| a.x > a.y && a.y > a.z));
        let flushed = skin_albedo(0.2, 0.7) / skin_albedo(0.2, 0.4);
        assert!(flushed.x > flushed.z && flushed.z > flushed.y);
    }

    #[test]
    fn every_light_exposes_a_frontal_surface_alike() {
        for light in Light::ALL {
            let irradiance = luminance(light.lighting().irradiance(Vec3::Z).to_array());
            assert!((0.75..1.25).contains(&irradiance), "{light:?}: {irradiance}");
        }
    }
}
