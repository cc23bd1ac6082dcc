//! What leaves a surface point toward the camera: Lambert diffuse plus a GGX highlight of each light.
//!
//! Linear RGB; irradiance in units of π·radiance. The microfacet terms are Walter et al. 2007 (GGX) with the correlated
//! Smith visibility of Heitz 2014 and Schlick's Fresnel; an area light widens the lobe by its own angular spread.

use glam::Vec3;

use super::light::Lighting;

/// A surface point as the camera sees it.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Diffuse albedo, linear RGB.
    pub albedo: Vec3,
    /// Perceptual roughness, in (0, 1]; the GGX width is its square.
    pub roughness: f32,
    /// Reflectance at normal incidence.
    pub f0: f32,
    /// Unit normal, world.
    pub normal_in_world: Vec3,
    /// Diffuse irradiance with shadows.
    pub irradiance: Vec3,
    /// Visible fraction of each light.
    pub visibility: &'a [f32],
    /// Visible fraction of the ambient light.
    pub openness: f32,
}

/// Radiance toward the viewer (`to_viewer_in_world` is a unit vector).
pub fn shade(lighting: &Lighting, surface: &Surface, to_viewer_in_world: Vec3) -> Vec3 {
    let (normal, view) = (surface.normal_in_world, to_viewer_in_world);
    let n_dot_v = normal.dot(view).clamp(1e-3, 1.0);
    let mut specular = Vec3::ZERO;
    for (light, visibility) in lighting.lights.iter().zip(surface.visibility) {
        let n_dot_l = normal.dot(light.direction_in_world);
        if n_dot_l <= 0.0 || *visibility <= 0.0 {
            continue;
        }
        let half = (light.direction_in_world + view).normalize_or(normal);
        let spread = 0.5 * light.half_angle_radians.sin();
        let alpha = (surface.roughness.powi(4) + spread * spread).sqrt().min(1.0);
        let lobe = ggx(alpha, normal.dot(half).clamp(0.0, 1.0), n_dot_l.min(1.0), n_dot_v);
        let fresnel = schlick(surface.f0, view.dot(half).clamp(0.0, 1.0));
        specular += light.irradiance * (std::f32::consts::PI * lobe * fresnel * n_dot_l * visibility);
    }
    let mirrored = 2.0 * normal.dot(view) * normal - view;
    let ambient =
        lighting.ambient_irradiance(mirrored) * environment_reflectance(surface.f0, surface.roughness, n_dot_v);
    let diffuse = surface.albedo * surface.irradiance * (1.0 - surface.f0);
    diffuse + specular + ambient * surface.openness * surface.openness
}

/// GGX distribution times Smith visibility (the microfacet BRDF without Fresnel), 1/sr.
fn ggx(alpha: f32, n_dot_h: f32, n_dot_l: f32, n_dot_v: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = n_dot_h * n_dot_h * (a2 - 1.0) + 1.0;
    let distribution = a2 / (std::f32::consts::PI * d * d).max(1e-12);
    let from_view = n_dot_l * (n_dot_v * n_dot_v * (1.0 - a2) + a2).sqrt();
    let from_light = n_dot_v * (n_dot_l * n_dot_l * (1.0 - a2) + a2).sqrt();
    distribution * 0.5 / (from_view + from_light).max(1e-6)
}

fn schlick(f0: f32, cosine: f32) -> f32 {
    f0 + (1.0 - f0) * (1.0 - cosine).powi(5)
}

/// Directional albedo of the GGX lobe under uniform light (Karis's fit of 2014 for mobile GPUs).
fn environment_reflectance(f0: f32, roughness: f32, n_dot_v: f32) -> f32 {
    let [r0, r1] = [1.0 - roughness, 0.0425 - 0.0275 * roughness];
    let a004 = (r0 * r0).min((-9.28 * n_dot_v).exp2()) * r0 + r1;
    let scale = -1.04 * a004 + 1.04 - 0.572 * roughness;
    let bias = 1.04 * a004 + 0.022 * roughness - 0.04;
    (f0 * scale + bias).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::AreaLight;

    /// ∫ D(h)·(n·h) dh = 1: the facets' projected area is the surface's.
    #[test]
    fn the_lobe_keeps_its_normalisation_at_every_width() {
        for alpha in [0.05f32, 0.2, 0.6, 1.0] {
            let steps = 20_000;
            let mut sum = 0.0f64;
            for step in 0..steps {
                let cosine = (step as f32 + 0.5) / steps as f32;
                let (l, v) = (0.7f32, 0.7f32);
                let smith = 0.5 / (2.0 * l * (v * v * (1.0 - alpha * alpha) + alpha * alpha).sqrt());
                sum += f64::from(ggx(alpha, cosine, l, v) / smith * cosine) / f64::from(steps);
            }
            assert!((sum * 2.0 * std::f64::consts::PI - 1.0).abs() < 0.01, "{alpha}: {sum}");
        }
    }

    #[test]
    fn no_surface_sends_out_more_than_it_gets() {
        let light = AreaLight { direction_in_world: Vec3::Z, irradiance: Vec3::ONE, half_angle_radians: 0.2 };
        let lighting =
            Lighting { lights: vec![light], ambient: Vec3::ZERO, ambient_up: Vec3::ZERO, ambient_right: Vec3::ZERO };
        let surface = Surface {
            albedo: Vec3::ZERO,
            roughness: 0.45,
            f0: 0.028,
            normal_in_world: Vec3::Z,
            irradiance: Vec3::ONE,
            visibility: &[1.0],
            openness: 1.0,
        };
        let (steps, mut sent) = (2_000, 0.0f64);
        for step in 0..steps {
            let cosine = (step as f32 + 0.5) / steps as f32;
            let view = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
            sent += 2.0 * f64::from(shade(&lighting, &surface, view).x * cosine) / f64::from(steps);
        }
        assert!(sent < 0.04 && sent > 0.015, "about F0 of the light is mirrored: {sent}");
    }
}
