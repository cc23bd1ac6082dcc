//! What one step of a fit is asked for and gives, on whatever device it is made.

use heartian_space::Camera;

use crate::GpuBuffer;
use crate::adam::AdamOptions;
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

/// A fit that stays on a device.
#[derive(Clone, Copy, Debug)]
pub struct FitShape<'a> {
    /// Gaussians.
    pub count: usize,
    /// What films them.
    pub camera: &'a Camera,
    /// Whether features are materials (eight, see [`crate::channel`]) under a light, or linear colour (three).
    pub is_lit: bool,
    /// Of the picture's loss.
    pub weights: PhotometricWeights,
    /// Of alpha's mean squared error.
    pub mask_weight: f32,
    /// (Gaussian, tile) entries to make room for at first, where a guess by the number of Gaussians will not do.
    pub room: Option<usize>,
}

/// What a step of such a fit says of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Mean squared error of the encoded picture, held in [0, 1].
    pub squared_error: f64,
    /// (Gaussian, tile) entries that the picture asked for.
    pub entries: usize,
    /// Whether the step changed nothing, because its entries or those of a step before had no room.
    pub is_stopped: bool,
}

/// Parameters that move at one rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamGroup {
    /// How many.
    pub count: usize,
    /// Values are held here after each step: least and largest.
    pub range: [f32; 2],
}

/// One step of the light: what [`crate::Adam`] is told, and how far the bands above the mean are kept afterwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightRate {
    /// Steps taken, this one included.
    pub steps: u32,
    /// Learning rate.
    pub rate: f32,
    /// Factor on bands 1 and higher.
    pub keep: f32,
    /// Decay rates and guard.
    pub options: AdamOptions,
}

/// Steps whose reports a device keeps.
pub(crate) const REPORTS: usize = 64;

/// One dispatch of a kernel.
#[derive(Clone, Copy, Debug)]
pub struct GpuCall<'a> {
    /// WGSL; `common.wgsl` stands before it.
    pub text: &'static str,
    /// The entry point's name.
    pub entry: &'static str,
    /// What stands at which binding of group 0: exactly those that the entry point uses.
    pub bindings: &'a [(u32, &'a GpuBuffer)],
    /// Workgroups, in rows of `ROW`: number `group.y * ROW + group.x`.
    pub workgroups: usize,
}

/// What the kernels around the rasteriser share with it, in the layout that `project.wgsl` and `loss.wgsl` say.
#[derive(Clone, Debug)]
pub struct GpuScene {
    /// Three of four floats a Gaussian: mean and opacity; scales; rotation (w, x, y, z).
    pub geometry: GpuBuffer,
    /// Three features a Gaussian without a light, eight with one.
    pub features: GpuBuffer,
    /// Four of four a Gaussian: by mean and opacity; by scales, and weight; by rotation; by the mean in pixels, radius.
    pub on_geometry: GpuBuffer,
    /// One of four floats a Gaussian without a light, three with one: by its features.
    pub on_features: GpuBuffer,
    /// A pixel's wanted sRGB over black, and alpha.
    pub wanted: GpuBuffer,
    /// The first word is set when updates have stopped.
    pub status: GpuBuffer,
}
