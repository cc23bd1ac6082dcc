//! Gaussians as flat arrays, their gradients, and the activations that make them from unconstrained parameters.
//!
//! World frame, metres. Features are anything that is composited: colour, or albedo, normal, roughness, …

use crate::error::{SplatError, expect_length};

/// Most channels that are composited at once, depth included.
pub const MAX_CHANNELS: usize = 12;

/// A borrowed scene of `N` Gaussians.
#[derive(Clone, Copy, Debug)]
pub struct Gaussians<'a> {
    /// `N` centres in the world, metres.
    pub means: &'a [[f32; 3]],
    /// `N` standard deviations along the local axes, metres, ≥ 0 (zero is a point widened by the low-pass).
    pub scales: &'a [[f32; 3]],
    /// `N` rotations world-from-local (w, x, y, z), of any positive norm; a zero quaternion counts as the identity.
    pub rotations: &'a [[f32; 4]],
    /// `N` opacities; values above 1 count as 1, below 1/255 the Gaussian is invisible.
    pub opacities: &'a [f32],
    /// `N × channels`, one Gaussian's features together.
    pub features: &'a [f32],
    /// Number of features of each Gaussian, 1 to [`MAX_CHANNELS`].
    pub channels: usize,
}

impl Gaussians<'_> {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Checks that the arrays agree on `N`.
    ///
    /// # Errors
    /// When one does not, or when the channel count is out of range.
    pub fn check(&self) -> Result<(), SplatError> {
        let n = self.len();
        expect_length("scales", n, self.scales.len())?;
        expect_length("rotations", n, self.rotations.len())?;
        expect_length("opacities", n, self.opacities.len())?;
        if self.channels == 0 || self.channels > MAX_CHANNELS {
            return Err(SplatError::Channels { found: self.channels, most: MAX_CHANNELS });
        }
        expect_length("features", n.saturating_mul(self.channels), self.features.len())
    }
}

/// Gradients of a loss with respect to what [`Gaussians`] holds, and the statistics that density control needs.
///
/// Gaussians that no pixel sees have zeros. Every value is finite when the image gradients are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneGradients {
    /// `N`, per metre.
    pub means: Vec<[f32; 3]>,
    /// `N`, per metre of standard deviation.
    pub scales: Vec<[f32; 3]>,
    /// `N`, with respect to the given (not normalised) quaternion.
    pub rotations: Vec<[f32; 4]>,
    /// `N`; zero where the opacity was clamped.
    pub opacities: Vec<f32>,
    /// `N × channels`.
    pub features: Vec<f32>,
    /// `N`: gradient with respect to the projected centre, per pixel (its norm drives densification).
    pub means_px: Vec<[f32; 2]>,
    /// `N`: sum over pixels of blend weight `α·T`: how much of the picture a Gaussian makes, in pixels.
    pub weights: Vec<f32>,
    /// `N`: largest half-extent in the picture, pixels; 0 when not drawn.
    pub radii_px: Vec<f32>,
}

/// `1 / (1 + e^−x)`, exact at both ends.
pub fn sigmoid(x: f32) -> f32 {
    if x >= 0.0 {
        1.0 / (1.0 + (-x).exp())
    } else {
        let e = x.exp();
        e / (1.0 + e)
    }
}

/// Inverse of [`sigmoid`], clamped to ±16.
pub fn logit(p: f32) -> f32 {
    if p.is_nan() {
        0.0
    } else {
        (p.max(f32::MIN_POSITIVE).ln() - (1.0 - p).max(f32::MIN_POSITIVE).ln()).clamp(-16.0, 16.0)
    }
}

/// A scene in the unconstrained parameters of 3D Gaussian splatting files: log scales and opacity logits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawGaussians {
    /// `N` centres, metres.
    pub means: Vec<[f32; 3]>,
    /// `N` natural logarithms of the standard deviations in metres.
    pub log_scales: Vec<[f32; 3]>,
    /// `N` quaternions (w, x, y, z).
    pub rotations: Vec<[f32; 4]>,
    /// `N` opacity logits.
    pub logits: Vec<f32>,
    /// `N` linear or encoded colours, as the file means them.
    pub colors: Vec<[f32; 3]>,
}

/// The activated arrays of a [`RawGaussians`].
#[derive(Clone, Debug, Default)]
pub struct Activated {
    scales: Vec<[f32; 3]>,
    opacities: Vec<f32>,
}

impl RawGaussians {
    /// Scales and opacities by `exp` and [`sigmoid`].
    pub fn activate(&self) -> Activated {
        Activated {
            scales: self.log_scales.iter().map(|s| s.map(f32::exp)).collect(),
            opacities: self.logits.iter().map(|&x| sigmoid(x)).collect(),
        }
    }

    /// The scene to render, with the colours as its three features.
    pub fn view<'a>(&'a self, activated: &'a Activated) -> Gaussians<'a> {
        Gaussians {
            means: &self.means,
            scales: &activated.scales,
            rotations: &self.rotations,
            opacities: &activated.opacities,
            features: self.colors.as_flattened(),
            channels: 3,
        }
    }

    /// Turns gradients of scales and opacities into those of log scales and logits, in place.
    pub fn chain(activated: &Activated, gradients: &mut SceneGradients) {
        for (gradient, scale) in gradients.scales.as_flattened_mut().iter_mut().zip(activated.scales.as_flattened()) {
            *gradient *= scale;
        }
        for (gradient, &o) in gradients.opacities.iter_mut().zip(&activated.opacities) {
            *gradient *= o * (1.0 - o);
        }
    }
}
