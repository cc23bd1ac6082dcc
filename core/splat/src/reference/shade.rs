//! Deferred shading of one pixel in f64: the specification of `shade.rs`. Its gradients are central differences.

use super::harmonics::basis_f64;
use crate::brdf::tables;
use crate::environment::{COSINE_BANDS, Environment};
use crate::harmonics::BAND_OF;
use crate::shade::{ALPHA_SHADED, COSINE_MIN, GRAZING_GAIN, LIGHT_SOFTNESS};

/// What a pixel is shaded from: eight premultiplied channels, then alpha, then the unit direction to the camera.
#[derive(Clone, Copy, Debug)]
pub struct Material {
    /// Albedo 3, normal 3, roughness, reflectance as composited.
    pub channels: [f64; 8],
    /// One minus transmittance.
    pub alpha: f64,
    /// Unit, world.
    pub view: [f64; 3],
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A bilinear look-up in the BRDF table, in f64.
fn brdf(cosine: f64, roughness: f64) -> [f64; 2] {
    let size = crate::brdf::SIZE;
    let place = |v: f64| {
        let t = v * size as f64 - 0.5;
        let cell = (t.max(0.0) as usize).min(size - 2);
        (cell, t - cell as f64)
    };
    let ((x, fx), (y, fy)) = (place(cosine), place(roughness));
    [0, 1].map(|k| {
        let texel = |dx: usize, dy: usize| f64::from(tables().brdf[(y + dy) * size + x + dx][k]);
        (1.0 - fy) * ((1.0 - fx) * texel(0, 0) + fx * texel(1, 0)) + fy * ((1.0 - fx) * texel(0, 1) + fx * texel(1, 1))
    })
}

/// Share of a band that the lobe passes, linear between the table's nodes, in f64.
fn lobe(band: usize, roughness: f64) -> f64 {
    let last = crate::brdf::NODES - 1;
    let t = roughness * last as f64;
    let cell = (t as usize).min(last - 1);
    let (a, b) = (f64::from(tables().lobe[cell][band]), f64::from(tables().lobe[cell + 1][band]));
    a + (t - cell as f64) * (b - a)
}

/// Linear RGB, premultiplied over black.
pub fn shade(material: &Material, environment: &Environment) -> [f64; 3] {
    let Material { channels: m, alpha, view } = *material;
    if alpha < f64::from(ALPHA_SHADED) {
        return [0.0; 3];
    }
    let length = (dot([m[3], m[4], m[5]], [m[3], m[4], m[5]]) + f64::from(crate::shade::NORMAL_SOFTNESS)).sqrt();
    let n = [m[3] / length, m[4] / length, m[5] / length];
    let facing = dot(n, view);
    let mirrored = [0, 1, 2].map(|k| 2.0 * facing * n[k] - view[k]);
    let roughness = (m[6] / alpha).clamp(0.0, 1.0);
    let f0 = (m[7] / alpha).clamp(0.0, 1.0);
    let [scale, bias] = brdf(facing.clamp(f64::from(COSINE_MIN), 1.0), roughness);
    let k = f0 * scale + (f64::from(GRAZING_GAIN) * f0).min(1.0) * bias;
    let (at_n, at_rho) = (basis_f64(n), basis_f64(mirrored));
    let positive = |x: f64| 0.5 * (x + (x * x + f64::from(LIGHT_SOFTNESS).powi(2)).sqrt());
    [0, 1, 2].map(|c| {
        let (mut diffuse, mut specular) = (0.0, 0.0);
        for i in 0..at_n.len() {
            let radiance = f64::from(environment.radiance[i][c]);
            diffuse += f64::from(COSINE_BANDS[BAND_OF[i]]) * radiance * at_n[i];
            specular += lobe(BAND_OF[i], roughness) * radiance * at_rho[i];
        }
        m[c] * positive(diffuse) * (1.0 - k) + alpha * positive(specular) * k
    })
}
