//! The frozen renderer as stage 2 sees it: how the green albedo of the skin Gaussians reaches pooled pixels.
//!
//! For a cell of `k × k` pixels, `green(cell) = base + Σ weight·offset`, with `weight` the mean over its pixels of
//! ∂(linear green)/∂(composited green albedo) × blend weight. Exact while no albedo is clamped. Linear light throughout.

use std::ops::ControlFlow;

use heartian_space::{AlbedoOperator, Clip, Progress, Skin, color};
use heartian_splat::{Csr, blend_weights, shade, shade_backward};

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::picture::{Features, Scene};

/// Cells whose skin moves their green by less than this share of full are left out: they see next to no skin.
const LEAST_WEIGHT: f32 = 0.02;

/// How coarse the operator is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OperatorOptions {
    /// Side of a cell, pixels.
    pub cell_px: usize,
    /// Most frames described, spread evenly over the training frames.
    pub frames: usize,
}

impl Default for OperatorOptions {
    fn default() -> Self {
        Self { cell_px: 8, frames: 96 }
    }
}

/// Describes the render of some training frames.
///
/// # Errors
/// When the clip is not the avatar's, an option is zero, or `progress` breaks.
pub fn albedo_operator(
    avatar: &Avatar,
    skin: &Skin,
    clip: &Clip,
    options: &OperatorOptions,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<AlbedoOperator, AvatarError> {
    let size = |width: usize, height: usize| format!("{width}×{height}");
    if (clip.width, clip.height) != (avatar.camera.width, avatar.camera.height) || clip.len() < avatar.training_frames {
        let expected = format!("{}, {} frames", size(avatar.camera.width, avatar.camera.height), avatar.states.len());
        let found = format!("{}, {} frames", size(clip.width, clip.height), clip.len());
        return Err(AvatarError::Mismatch { what: "clip of the albedo operator", expected, found });
    }
    for (name, value) in [("cell_px", options.cell_px), ("frames", options.frames)] {
        if value == 0 {
            return Err(AvatarError::Option { name, value: 0.0, range: "at least 1" });
        }
    }
    let mut builder = Builder::new(avatar, skin, options.cell_px)?;
    let count = options.frames.min(avatar.training_frames);
    for k in 0..count {
        let frame = k * avatar.training_frames / count;
        builder.add(frame, clip)?;
        if progress(Progress { step: k as u64 + 1, total: count as u64, metric: None }).is_break() {
            return Err(AvatarError::Cancelled);
        }
    }
    Ok(builder.operator.checked()?)
}

struct Builder<'a> {
    avatar: &'a Avatar,
    cell_px: usize,
    /// Which Gaussians have columns.
    subset: Vec<bool>,
    /// Column of each Gaussian that has one.
    column_of: Vec<u32>,
    operator: AlbedoOperator,
}

impl<'a> Builder<'a> {
    fn new(avatar: &'a Avatar, skin: &Skin, cell_px: usize) -> Result<Self, AvatarError> {
        let (mut subset, mut column_of) = (vec![false; avatar.len()], vec![0; avatar.len()]);
        for (column, &index) in skin.gaussians.iter().enumerate() {
            let missing = AvatarError::Index { what: "the skin", index: index as usize, count: avatar.len() };
            *subset.get_mut(index as usize).ok_or(missing)? = true;
            column_of[index as usize] = column as u32;
        }
        let operator = AlbedoOperator {
            column_count: skin.gaussians.len(),
            row_offsets: vec![0],
            entry_offsets: vec![0],
            ..AlbedoOperator::default()
        };
        Ok(Self { avatar, cell_px, subset, column_of, operator })
    }

    /// Appends the rows of one frame.
    fn add(&mut self, frame: usize, clip: &Clip) -> Result<(), AvatarError> {
        let Avatar { canonical, motion, camera, environment, states, .. } = self.avatar;
        let picture =
            Scene::new(canonical, &motion.motion(&states[frame]), camera, Features::Materials).picture(camera)?;
        let pixels = camera.width * camera.height;
        let linear = shade(&picture.frame, camera, environment)?;
        let mut green = vec![0.0; 3 * pixels];
        green[pixels..2 * pixels].fill(1.0);
        // Pixels do not mix in shading, so the gradient of the sum is each pixel's own slope.
        let slopes = shade_backward(&picture.frame, camera, environment, &green)?.planes;
        let weights =
            blend_weights(&picture.prepared, Some(&self.subset), self.cell_px, Some(&slopes[pixels..2 * pixels]))?;
        let image = clip.image_over_black(frame);
        let target: Vec<f32> =
            image.data.as_chunks::<3>().0.iter().map(|p| color::linear_from_srgb(f32::from(p[1]) / 255.0)).collect();
        self.operator.frames.push(frame as u32);
        self.append(&weights, &linear[pixels..2 * pixels], &target);
        self.operator.row_offsets.push(self.operator.base.len() as u32);
        Ok(())
    }

    fn append(&mut self, weights: &Csr, base: &[f32], target: &[f32]) {
        let (width, height) = (self.avatar.camera.width, self.avatar.camera.height);
        let cells_in_row = width.div_ceil(self.cell_px);
        for cell in 0..weights.rows() {
            let (x0, y0) = (cell % cells_in_row * self.cell_px, cell / cells_in_row * self.cell_px);
            let (x1, y1) = ((x0 + self.cell_px).min(width), (y0 + self.cell_px).min(height));
            let pixels = ((x1 - x0) * (y1 - y0)) as f32;
            if weights.row(cell).map(|(_, weight)| weight).sum::<f32>() < LEAST_WEIGHT * pixels {
                continue;
            }
            let mean = |plane: &[f32]| {
                let sum: f64 =
                    (y0..y1).flat_map(|y| &plane[y * width + x0..y * width + x1]).map(|v| f64::from(*v)).sum();
                (sum / f64::from(pixels)) as f32
            };
            for (gaussian, weight) in weights.row(cell) {
                self.operator.columns.push(self.column_of[gaussian as usize]);
                self.operator.weights.push(weight / pixels);
            }
            self.operator.entry_offsets.push(self.operator.columns.len() as u32);
            self.operator.base.push(mean(base));
            self.operator.target.push(mean(target));
            self.operator.pixels.push(pixels);
        }
    }
}
