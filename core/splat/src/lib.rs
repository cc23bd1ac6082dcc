//! Gaussians: projection, rasteriser with exact gradients, deferred shading, lights and image losses. Knows no face.
//!
//! One frame: [`prepare`] (project, sort, bin) → [`composite`] (blend) → [`shade`] → [`srgb_encode`] → [`photometric`],
//! and back by [`shade_backward`] and [`backward`]. Images here are planar f32 (`C × H × W`, top row first), colours
//! premultiplied over black. Each fast text has a naive f64 twin of the same stem under [`reference`].

mod adam;
mod bin;
mod blend_weights;
mod brdf;
mod device;
mod environment;
mod error;
mod fit;
mod gather;
mod gaussians;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(not(feature = "gpu"))]
mod gpu_absent;
mod harmonics;
mod lanes;
mod light_file;
mod loss;
mod ply;
mod project;
mod raster;
mod reach;
pub mod reference;
mod render;
mod scratch;
mod shade;
mod ssim;
mod transfer;

#[cfg(test)]
mod tests;

pub use adam::{Adam, AdamOptions};
pub use blend_weights::{Csr, blend_weights};
pub use device::{AdapterReport, Device, KERNEL_PRELUDE};
pub use environment::{Environment, RADIANCE_COEFFICIENTS};
pub use error::SplatError;
pub use fit::{AdamGroup, FitShape, FitStep, FitTarget, GpuCall, GpuScene, LightRate, StepReport};
pub use gather::backward;
pub use gaussians::{Activated, Gaussians, MAX_CHANNELS, RawGaussians, SceneGradients, logit, sigmoid};
#[cfg(feature = "gpu")]
pub use gpu::{
    Gpu, GpuAdam, GpuBuffer, GpuFitter, GpuFrames, GpuKernels, GpuPresenter, GpuRasteriser, GpuReading, adapters,
};
#[cfg(not(feature = "gpu"))]
pub use gpu_absent::{
    Gpu, GpuAdam, GpuBuffer, GpuFitter, GpuFrames, GpuKernels, GpuPresenter, GpuRasteriser, GpuReading, adapters,
};
pub use lanes::{SimdLevel, simd_level};
pub use light_file::{LightImage, light_from_file};
pub use loss::{Photometric, PhotometricWeights, mask_loss, mean_absolute_error, photometric, psnr};
pub use ply::{ply_bytes, read_ply, write_ply};
pub use project::RasterOptions;
pub use raster::{Floor, floor};
pub use render::{Frame, FrameGradient, Prepared, composite, prepare, render};
pub use shade::{DEFERRED_CHANNELS, ShadeGradients, channel, shade, shade_backward};
pub use ssim::ssim;
pub use transfer::{srgb_encode, srgb_encode_backward};
