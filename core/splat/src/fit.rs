//! What one step of a fit is asked for and gives, on whatever device it is made.

use crate::gaussians::SceneGradients;
use crate::loss::{Photometric, PhotometricWeights};

/// What a picture is compared with.
#[derive(Clone, Copy, Debug)]
pub struct FitTarget<'a> {
    /// `3 × height × width`, sRGB-encoded in [0, 1], over black.
    pub rgb: &'a [f32],
    /// `height × width` in [0, 1].
    pub alpha: &'a [f32],
    /// Of the picture's loss.
    pub weights: PhotometricWeights,
    /// Of alpha's mean squared error.
    pub mask_weight: f32,
}

/// What came of a step.
#[derive(Clone, Debug, Default)]
pub struct FitStep {
    /// The picture's loss and its parts.
    pub photometric: Photometric,
    /// Mean squared error of the encoded picture, held in [0, 1].
    pub squared_error: f64,
    /// Mean squared error of alpha, not weighted.
    pub mask: f64,
    /// With respect to the scene.
    pub gradients: SceneGradients,
    /// With respect to the light's coefficients; empty without a light.
    pub radiance: Vec<[f32; 3]>,
}
