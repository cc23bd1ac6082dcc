//! Image losses on encoded (sRGB) pictures, planar f32, with exact gradients; sums are f64 in fixed chunks, so a loss is
//! the same at any number of threads. Twin of `reference/loss.rs`.

use crate::error::{SplatError, expect_length};
use crate::ssim::similarity;
use rayon::prelude::*;

/// Elements of a partial sum.
const CHUNK: usize = 16 * 1024;

/// Weights of the photometric loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotometricWeights {
    /// Of the mean absolute error.
    pub l1: f32,
    /// Of one minus structural similarity.
    pub dssim: f32,
}

impl Default for PhotometricWeights {
    fn default() -> Self {
        Self { l1: 0.8, dssim: 0.2 }
    }
}

/// A photometric loss and its parts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Photometric {
    /// `l1·L1 + dssim·(1 − SSIM)`.
    pub total: f64,
    /// Mean absolute error.
    pub l1: f64,
    /// Mean structural similarity; 1 where its weight is 0, for it is not computed then.
    pub ssim: f64,
}

/// Photometric loss of an `image` against a `target` (planes of `width × height`, encoded, in [0, 1]); **adds** its
/// gradient with respect to the image to `gradient`.
///
/// # Errors
/// When the lengths differ or are not whole planes.
pub fn photometric(
    image: &[f32],
    target: &[f32],
    size: [usize; 2],
    weights: PhotometricWeights,
    gradient: &mut [f32],
) -> Result<Photometric, SplatError> {
    let l1 = mean_absolute_error(image, target, weights.l1, gradient)?;
    let ssim = match weights.dssim == 0.0 {
        true => 1.0,
        false => similarity(image, target, size, Some((-weights.dssim, gradient)))?,
    };
    Ok(Photometric { total: f64::from(weights.l1) * l1 + f64::from(weights.dssim) * (1.0 - ssim), l1, ssim })
}

/// Mean absolute error, not weighted; **adds** `weight` times its gradient to `gradient` (0 where the two are equal).
///
/// # Errors
/// When the lengths differ or are 0.
pub fn mean_absolute_error(
    image: &[f32],
    target: &[f32],
    weight: f32,
    gradient: &mut [f32],
) -> Result<f64, SplatError> {
    same_length(image, target, gradient)?;
    let step = weight / image.len() as f32;
    let chunks = image.par_chunks(CHUNK).zip(target.par_chunks(CHUNK)).zip(gradient.par_chunks_mut(CHUNK));
    let sums: Vec<f64> = chunks
        .map(|((image, target), gradient)| {
            let mut sum = 0.0;
            for ((a, b), g) in image.iter().zip(target).zip(gradient) {
                let d = a - b;
                sum += f64::from(d.abs());
                *g += if d == 0.0 { 0.0 } else { step * d.signum() };
            }
            sum
        })
        .collect();
    Ok(sums.iter().sum::<f64>() / image.len() as f64)
}

/// Mean squared error of alpha (one minus `transmittance`) against a mask in [0, 1], not weighted; **adds** `weight` times
/// its gradient with respect to transmittance to `gradient`.
///
/// # Errors
/// When the lengths differ or are 0.
pub fn mask_loss(transmittance: &[f32], mask: &[f32], weight: f32, gradient: &mut [f32]) -> Result<f64, SplatError> {
    same_length(transmittance, mask, gradient)?;
    let step = 2.0 * weight / mask.len() as f32;
    let chunks = transmittance.par_chunks(CHUNK).zip(mask.par_chunks(CHUNK)).zip(gradient.par_chunks_mut(CHUNK));
    let sums: Vec<f64> = chunks
        .map(|((transmittance, mask), gradient)| {
            let mut sum = 0.0;
            for ((t, m), g) in transmittance.iter().zip(mask).zip(gradient) {
                let d = (1.0 - t) - m;
                sum += f64::from(d * d);
                *g -= step * d;
            }
            sum
        })
        .collect();
    Ok(sums.iter().sum::<f64>() / mask.len() as f64)
}

/// Peak signal-to-noise ratio in dB for values in [0, 1] (held there); infinite for equal pictures.
///
/// # Errors
/// When the lengths differ or are 0.
pub fn psnr(image: &[f32], target: &[f32]) -> Result<f64, SplatError> {
    expect_length("the second picture", image.len(), target.len())?;
    if image.is_empty() {
        return Err(SplatError::Length { what: "a picture", expected: 1, found: 0 });
    }
    let held = |v: &f32| f64::from(v.clamp(0.0, 1.0));
    let sums: Vec<f64> = image
        .par_chunks(CHUNK)
        .zip(target.par_chunks(CHUNK))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (held(a) - held(b)).powi(2)).sum::<f64>())
        .collect();
    Ok(-10.0 * (sums.iter().sum::<f64>() / image.len() as f64).log10())
}

fn same_length(image: &[f32], target: &[f32], gradient: &[f32]) -> Result<(), SplatError> {
    expect_length("the second picture", image.len(), target.len())?;
    expect_length("the gradient of a picture", image.len(), gradient.len())?;
    if image.is_empty() { Err(SplatError::Length { what: "a picture", expected: 1, found: 0 }) } else { Ok(()) }
}
