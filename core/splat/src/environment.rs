//! Light from far away, in linear light: spherical-harmonic radiance of bands 0 to 4 in the world frame.
//!
//! Diffuse shading uses irradiance over π, `Σ A_l·L_lm·Y_lm(n)` with `A = 1, 2/3, 1/4, 0, −1/24` (Ramamoorthi and
//! Hanrahan 2001); specular shading the lobe's share of each band around the mirror direction. Both are linear in the
//! coefficients, so a measured map is projected once onto the same basis that fitting learns. A direction is (x right,
//! y up, z toward the viewer); the harmonics' polar axis is z.

use crate::error::{SplatError, expect_length};
use crate::harmonics::{BAND_OF, BANDS, COUNT};
use crate::light_file::LightImage;
use crate::reference::harmonics::basis_f64;
use heartian_space::color::luminance;
use serde::{Deserialize, Serialize};

/// Coefficients of a colour channel.
pub const RADIANCE_COEFFICIENTS: usize = COUNT;

/// Irradiance over π of each band of radiance.
pub(crate) const COSINE_BANDS: [f32; BANDS] = [1.0, 2.0 / 3.0, 0.25, 0.0, -1.0 / 24.0];
/// Value of the constant harmonic.
const Y00: f32 = 0.282_094_8;

/// Learnable far light: linear RGB radiance coefficients, index `l² + l + m`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Environment {
    /// `25 × RGB`.
    pub radiance: Vec<[f32; 3]>,
}

impl Default for Environment {
    fn default() -> Self {
        Self::uniform([1.0; 3])
    }
}

impl Environment {
    /// The same radiance from everywhere: a white surface under `uniform([1; 3])` is 1.
    pub fn uniform(color: [f32; 3]) -> Self {
        let mut radiance = vec![[0.0; 3]; COUNT];
        radiance[0] = color.map(|c| c / Y00);
        Self { radiance }
    }

    /// A broad light of unit mean luminance, warm (about 3000 K) from the upper left over a weaker fill.
    pub fn warm() -> Self {
        Self::key_and_fill([1.0, 0.71, 0.42], [-0.6, 0.5, 0.6])
    }

    /// The same light as [`Self::warm`] in luminance and shape, bluish (about 9000 K), from the upper right.
    pub fn cool() -> Self {
        Self::key_and_fill([0.82, 0.90, 1.0], [0.6, 0.5, 0.6])
    }

    /// Light of colour `color` scaled to unit mean luminance, 40 % uniform and 60 % around a world direction.
    fn key_and_fill(color: [f32; 3], direction: [f32; 3]) -> Self {
        let scale = 1.0 / luminance(color);
        let norm = direction.iter().map(|d| d * d).sum::<f32>().sqrt();
        let y = basis_f64(direction.map(|d| f64::from(d / norm)));
        // The key is a clamped cosine lobe, which is 4π/4 of a uniform light in the mean: bands π·(1, 2/3, 1/4, 0, −1/24).
        let radiance = y.iter().zip(BAND_OF).enumerate().map(|(i, (y, band))| {
            let key = 0.6 * 4.0 * std::f32::consts::PI * COSINE_BANDS[band] * *y as f32;
            let fill = if i == 0 { 0.4 / Y00 } else { 0.0 };
            color.map(|c| c * scale * (key + fill))
        });
        Self { radiance: radiance.collect() }
    }

    /// Projects a linear-light latitude–longitude picture: its centre is −z (what the camera looks at), its right half
    /// +x, its top row +y.
    ///
    /// Non-finite and negative pixels count as black.
    ///
    /// # Errors
    /// When the picture's length contradicts its size or it has no pixels.
    pub fn from_equirectangular(image: &LightImage) -> Result<Self, SplatError> {
        let (width, height) = (image.width, image.height);
        expect_length("a light's picture", width.saturating_mul(height).saturating_mul(3), image.data.len())?;
        if width == 0 || height == 0 {
            return Err(SplatError::Light { path: "(picture)".into(), reason: "it has no pixels".into() });
        }
        let mut sum = vec![[0.0f64; 3]; COUNT];
        for row in 0..NODES[1] {
            let edge = |r: usize| (std::f64::consts::PI * r as f64 / NODES[1] as f64).cos();
            // Exact solid angle of a node of this row.
            let solid_angle = std::f64::consts::TAU / NODES[0] as f64 * (edge(row) - edge(row + 1));
            for column in 0..NODES[0] {
                let radiance = mean_over_node(image, [column, row]);
                let y = basis_f64(direction_of_pixel(column, row, NODES[0], NODES[1]));
                for (s, y) in sum.iter_mut().zip(y) {
                    for (s, radiance) in s.iter_mut().zip(radiance) {
                        *s += y * solid_angle * radiance;
                    }
                }
            }
        }
        Ok(Self { radiance: sum.into_iter().map(|s| s.map(|v| v as f32)).collect() })
    }

    /// Mean radiance over the sphere.
    pub fn mean(&self) -> [f32; 3] {
        self.radiance.first().map_or([0.0; 3], |c| c.map(|c| c * Y00))
    }

    /// The light scaled so that its mean luminance is `target`; a black light is returned as it is.
    pub fn with_mean_luminance(&self, target: f32) -> Self {
        let now = luminance(self.mean());
        let scale = if now > 1e-12 { target / now } else { 1.0 };
        Self { radiance: self.radiance.iter().map(|c| c.map(|v| v * scale)).collect() }
    }

    /// The light turned about the world's y axis by `radians` (counter-clockwise seen from above).
    pub fn turned(&self, radians: f64) -> Self {
        // The turn is applied by projecting the turned function: exact, for the quadrature integrates degree 8.
        let mut sum = vec![[0.0f64; 3]; COUNT];
        let (rows, columns) = (32, 32);
        for [z, weight] in gauss_legendre(rows) {
            let side = (1.0 - z * z).max(0.0).sqrt();
            for column in 0..columns {
                let phi = std::f64::consts::TAU * (f64::from(column) + 0.5) / f64::from(columns);
                let d = [side * phi.cos(), side * phi.sin(), z];
                let (s, c) = radians.sin_cos();
                let source = basis_f64([c * d[0] - s * d[2], d[1], s * d[0] + c * d[2]]);
                let mut value = [0.0; 3];
                for (radiance, y) in self.radiance.iter().zip(source) {
                    for (v, r) in value.iter_mut().zip(radiance) {
                        *v += f64::from(*r) * y;
                    }
                }
                for (s, y) in sum.iter_mut().zip(basis_f64(d)) {
                    for (s, v) in s.iter_mut().zip(value) {
                        *s += v * y * weight * std::f64::consts::TAU / f64::from(columns);
                    }
                }
            }
        }
        Self { radiance: sum.into_iter().map(|s| s.map(|v| v as f32)).collect() }
    }
}

/// Columns and rows that a picture is averaged onto before it is projected: bands 0 to 4 need no more.
const NODES: [usize; 2] = [256, 128];

/// Mean radiance of a picture over a node, each pixel by the share of it that the node covers.
fn mean_over_node(image: &LightImage, node: [usize; 2]) -> [f64; 3] {
    let size = [image.width, image.height];
    let [columns, rows] = [0, 1].map(|k| {
        let (from, to) =
            ((node[k] * size[k]) as f64 / NODES[k] as f64, ((node[k] + 1) * size[k]) as f64 / NODES[k] as f64);
        let last = (to.ceil() as usize).min(size[k]);
        (from as usize..last).map(move |i| (i, (to.min(i as f64 + 1.0) - from.max(i as f64)).max(0.0)))
    });
    let (mut sum, mut whole) = ([0.0; 3], 0.0);
    for (row, share_of_row) in rows {
        for (column, share) in columns.clone() {
            whole += share * share_of_row;
            for (s, &p) in sum.iter_mut().zip(&image.data[3 * (row * image.width + column)..]) {
                *s += share * share_of_row * if p.is_finite() { f64::from(p.max(0.0)) } else { 0.0 };
            }
        }
    }
    if whole > 0.0 { sum.map(|s| s / whole) } else { sum }
}

/// World direction of a pixel's centre in a latitude–longitude picture.
pub(crate) fn direction_of_pixel(column: usize, row: usize, width: usize, height: usize) -> [f64; 3] {
    let longitude = std::f64::consts::TAU * ((column as f64 + 0.5) / width as f64 - 0.5);
    let colatitude = std::f64::consts::PI * (row as f64 + 0.5) / height as f64;
    [colatitude.sin() * longitude.sin(), colatitude.cos(), -colatitude.sin() * longitude.cos()]
}

/// Nodes and weights of Gauss–Legendre quadrature on [−1, 1], by Newton's method on the polynomial.
fn gauss_legendre(n: usize) -> Vec<[f64; 2]> {
    (0..n)
        .map(|i| {
            let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..100 {
                let (mut p0, mut p1) = (1.0, x);
                for k in 2..=n {
                    let k = k as f64;
                    (p0, p1) = (p1, ((2.0 * k - 1.0) * x * p1 - (k - 1.0) * p0) / k);
                }
                slope = n as f64 * (x * p1 - p0) / (x * x - 1.0);
                let step = p1 / slope;
                x -= step;
                if step.abs() < 1e-15 {
                    break;
                }
            }
            [x, 2.0 / ((1.0 - x * x) * slope * slope)]
        })
        .collect()
}
