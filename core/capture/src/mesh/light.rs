//! Lights that do not change from frame to frame: a few round area lights and an ambient gradient.
//!
//! Irradiances are linear RGB in units of π·radiance, so that a white Lambert surface under irradiance 1 has radiance 1.

use glam::Vec3;

/// A distant round light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AreaLight {
    /// Unit direction from the scene to the light's centre, world.
    pub direction_in_world: Vec3,
    /// Irradiance on a surface that faces it.
    pub irradiance: Vec3,
    /// Half the angle under which it is seen, radians, in (0, π/2).
    pub half_angle_radians: f32,
}

impl AreaLight {
    /// Fraction of the irradiance that reaches a surface with this normal: the cosine, rounded off where the horizon
    /// cuts the light's disc.
    pub fn cosine(&self, normal_in_world: Vec3) -> f32 {
        let (cosine, radius) = (normal_in_world.dot(self.direction_in_world), self.half_angle_radians.sin());
        if cosine >= radius {
            cosine
        } else if cosine <= -radius {
            0.0
        } else {
            (cosine + radius) * (cosine + radius) / (4.0 * radius)
        }
    }
}

/// All light that falls on the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Lighting {
    /// The area lights.
    pub lights: Vec<AreaLight>,
    /// Ambient irradiance of a surface that faces sideways.
    pub ambient: Vec3,
    /// What turning from sideways to up adds to it (and turning down takes away); at most `ambient`.
    pub ambient_up: Vec3,
    /// What turning from the camera's left to its right adds; with `ambient_up` at most `ambient`.
    pub ambient_right: Vec3,
}

impl Lighting {
    /// Ambient irradiance on a surface with this normal, never negative.
    pub fn ambient_irradiance(&self, normal_in_world: Vec3) -> Vec3 {
        (self.ambient + normal_in_world.y * self.ambient_up + normal_in_world.x * self.ambient_right).max(Vec3::ZERO)
    }

    /// Irradiance without any shadow.
    pub fn irradiance(&self, normal_in_world: Vec3) -> Vec3 {
        let direct = self.lights.iter().map(|light| light.irradiance * light.cosine(normal_in_world));
        self.ambient_irradiance(normal_in_world) + direct.sum::<Vec3>()
    }

    /// The same light, all of it brighter by `gain`.
    pub fn scaled(mut self, gain: f32) -> Self {
        for light in &mut self.lights {
            light.irradiance *= gain;
        }
        for part in [&mut self.ambient, &mut self.ambient_up, &mut self.ambient_right] {
            *part *= gain;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_light_fades_smoothly_through_the_horizon() {
        let light = AreaLight { direction_in_world: Vec3::Y, irradiance: Vec3::ONE, half_angle_radians: 0.5 };
        let at = |degrees: f32| light.cosine(Vec3::new(degrees.to_radians().sin(), degrees.to_radians().cos(), 0.0));
        assert_eq!(at(0.0), 1.0);
        assert_eq!(at(125.0), 0.0);
        let steps: Vec<f32> = (0..=180).map(|degrees| at(degrees as f32)).collect();
        assert!(steps.windows(2).all(|pair| pair[1] <= pair[0] && pair[0] - pair[1] < 0.02));
        assert!(at(90.0) > 0.1, "half of the disc still shines at grazing incidence");
    }
}
