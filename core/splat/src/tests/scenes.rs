//! Seeded scenes and the few comparisons that all tests share.

use crate::{Gaussians, RasterOptions};
use heartian_space::Camera;

/// A small counter-based generator: the same numbers everywhere.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03)
    }
    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f32 / 16_777_216.0
    }
    /// Uniform in [low, high).
    pub fn within(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }
}

/// An owned scene.
#[derive(Clone, Default)]
pub struct Owned {
    pub means: Vec<[f32; 3]>,
    pub scales: Vec<[f32; 3]>,
    pub rotations: Vec<[f32; 4]>,
    pub opacities: Vec<f32>,
    pub features: Vec<f32>,
    pub channels: usize,
}

impl Owned {
    pub fn view(&self) -> Gaussians<'_> {
        Gaussians {
            means: &self.means,
            scales: &self.scales,
            rotations: &self.rotations,
            opacities: &self.opacities,
            features: &self.features,
            channels: self.channels,
        }
    }

    /// `n` Gaussians of all shapes about one metre in front of [`camera`], some outside the picture.
    pub fn random(n: usize, channels: usize, seed: u64) -> Self {
        let mut r = Random::new(seed);
        let mut out = Self { channels, ..Self::default() };
        for _ in 0..n {
            let depth = r.within(0.7, 1.3);
            out.means.push([r.within(-0.2, 0.2) * depth, r.within(-0.2, 0.2) * depth, -depth]);
            out.scales.push([r.within(0.002, 0.04), r.within(0.002, 0.04), r.within(0.0005, 0.01)]);
            out.rotations.push([0; 4].map(|_| r.within(-1.0, 1.0)));
            out.opacities.push(r.within(0.02, 0.98));
            out.features.extend((0..channels).map(|_| r.unit()));
        }
        out
    }
}

/// A camera of our clips with an uneven picture.
pub fn camera(width: usize, height: usize) -> Camera {
    Camera {
        principal_px: [width as f32 * 0.52, height as f32 * 0.47],
        ..Camera::at_origin(width, height, 2.6 * width as f32)
    }
}

pub fn options(depth: bool) -> RasterOptions {
    RasterOptions { depth, ..RasterOptions::default() }
}

pub fn noise(n: usize, seed: u64) -> Vec<f32> {
    let mut r = Random::new(seed);
    (0..n).map(|_| r.within(-1.0, 1.0)).collect()
}

/// Largest absolute difference.
pub fn worst(fast: &[f32], exact: &[f64]) -> f64 {
    assert_eq!(fast.len(), exact.len());
    fast.iter().zip(exact).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
}

/// ‖fast − exact‖ / ‖exact‖.
pub fn relative(fast: &[f32], exact: &[f64]) -> f64 {
    assert_eq!(fast.len(), exact.len());
    let off: f64 = fast.iter().zip(exact).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum();
    let whole: f64 = exact.iter().map(|b| b * b).sum();
    if whole == 0.0 { off.sqrt() } else { (off / whole).sqrt() }
}
