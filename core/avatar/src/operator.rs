//! The frozen renderer as stage 2 sees it: a sparse linear map from green albedo offsets to pooled linear green.
//!
//! With geometry, light and blending frozen, the linear green of a pixel is affine in the green albedo of the Gaussians
//! over it: slope = (diffuse light left after the mirror's share, at that pixel) × (blend weight). Both are exact, the
//! slope from the shader's own derivative. Cells that hold no skin to speak of, or lie on the matte's edge, are left out.

use std::ops::ControlFlow;

use heartian_space::color::linear_from_srgb;
use heartian_space::{AlbedoOperator, Clip, Progress, Skin};
use heartian_splat::{blend_weights, channel, shade, shade_backward};
use rayon::prelude::*;

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::picture::{Features, Scene};

/// How fine the map is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OperatorOptions {
    /// Side of a cell, pixels, 1 to 64.
    pub cell_px: usize,
    /// Frames are thinned evenly until there are about so many entries (8 bytes each), at least one frame.
    pub most_entries: usize,
    /// Least mean slope of a cell for it to count.
    pub least_weight: f32,
}

impl Default for OperatorOptions {
    fn default() -> Self {
        Self { cell_px: 8, most_entries: 3_000_000, least_weight: 0.05 }
    }
}

/// The rows of one frame.
#[derive(Default)]
struct Rows {
    lengths: Vec<u32>,
    columns: Vec<u32>,
    weights: Vec<f32>,
    base: Vec<f32>,
    target: Vec<f32>,
    pixels: Vec<f32>,
}

/// Builds the map for training frames of the avatar's recording.
///
/// # Errors
/// When the clip is not the avatar's recording, the skin names Gaussians that do not exist, no cell holds skin, or
/// `progress` breaks.
pub fn albedo_operator(
    avatar: &Avatar,
    skin: &Skin,
    clip: &Clip,
    options: &OperatorOptions,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<AlbedoOperator, AvatarError> {
    if !(1..=64).contains(&options.cell_px) {
        return Err(AvatarError::Option { name: "cell_px", value: options.cell_px as f64, range: "1 to 64" });
    }
    check_recording(avatar, skin, clip)?;
    let mut column_of = vec![u32::MAX; avatar.len()];
    for (column, &index) in skin.gaussians.iter().enumerate() {
        column_of[index as usize] = column as u32;
    }
    let job = Job { avatar, clip, options, in_skin: column_of.iter().map(|c| *c != u32::MAX).collect(), column_of };
    let training = avatar.training_frames.max(1).min(avatar.states.len());
    let sample = job.rows(training / 2)?.columns.len().max(1);
    let stride = (sample * training).div_ceil(options.most_entries.max(1)).max(1);
    let frames: Vec<usize> = (0..training).step_by(stride).collect();
    let mut operator = AlbedoOperator {
        column_count: skin.gaussians.len(),
        picture_pixels: clip.width * clip.height,
        frames: frames.iter().map(|&frame| frame as u32).collect(),
        row_offsets: vec![0],
        entry_offsets: vec![0],
        ..AlbedoOperator::default()
    };
    for (chunk, some) in frames.chunks(16).enumerate() {
        let rows: Vec<Rows> = some.par_iter().map(|&frame| job.rows(frame)).collect::<Result<_, _>>()?;
        rows.into_iter().for_each(|rows| append(&mut operator, rows));
        let step = (chunk * 16 + some.len()) as u64;
        if progress(Progress { step, total: frames.len() as u64, metric: None }).is_break() {
            return Err(AvatarError::Cancelled);
        }
    }
    if operator.base.is_empty() {
        let remedy = "the selected skin is hidden in every training frame; check the selection and the track";
        return Err(AvatarError::TooLittle { what: "no picture cell shows the selected skin", found: 0, remedy });
    }
    Ok(operator.checked()?)
}

/// Refuses a skin of other Gaussians and a clip that the avatar was not fitted to.
pub(crate) fn check_recording(avatar: &Avatar, skin: &Skin, clip: &Clip) -> Result<(), AvatarError> {
    if let Some(&index) = skin.gaussians.iter().find(|&&index| index as usize >= avatar.len()) {
        return Err(AvatarError::Index { what: "the skin", index: index as usize, count: avatar.len() });
    }
    let size = |width: usize, height: usize, frames: usize| format!("{width}×{height}, {frames} frames");
    let camera = &avatar.camera;
    let expected = size(camera.width, camera.height, avatar.states.len());
    let found = size(clip.width, clip.height, clip.len());
    if expected == found { Ok(()) } else { Err(AvatarError::Mismatch { what: "the recording", expected, found }) }
}

fn append(operator: &mut AlbedoOperator, rows: Rows) {
    for length in rows.lengths {
        let last = operator.entry_offsets.last().copied().unwrap_or(0);
        operator.entry_offsets.push(last + length);
    }
    operator.columns.extend(rows.columns);
    operator.weights.extend(rows.weights);
    operator.base.extend(rows.base);
    operator.target.extend(rows.target);
    operator.pixels.extend(rows.pixels);
    operator.row_offsets.push(operator.base.len() as u32);
}

struct Job<'a> {
    avatar: &'a Avatar,
    clip: &'a Clip,
    options: &'a OperatorOptions,
    in_skin: Vec<bool>,
    column_of: Vec<u32>,
}

impl Job<'_> {
    fn rows(&self, frame: usize) -> Result<Rows, AvatarError> {
        let Avatar { canonical, motion, environment, camera, states, .. } = self.avatar;
        let (width, height) = (camera.width, camera.height);
        let pixels = width * height;
        let picture =
            Scene::new(canonical, &motion.motion(&states[frame]), camera, Features::Materials).picture(camera)?;
        let linear = shade(&picture.frame, camera, environment)?;
        let mut green_alone = vec![0.0; 3 * pixels];
        green_alone[pixels..2 * pixels].fill(1.0);
        let slopes = shade_backward(&picture.frame, camera, environment, &green_alone)?.planes;
        let green = channel::ALBEDO + 1;
        let slope = &slopes[green * pixels..(green + 1) * pixels];
        let cell = self.options.cell_px;
        let weights = blend_weights(&picture.prepared, Some(&self.in_skin), cell, Some(slope))?;
        let image = self.clip.image_over_black(frame);
        let recorded = |pixel: usize| linear_from_srgb(f32::from(image.data[3 * pixel + 1]) / 255.0);
        let matte = self.clip.frame_alpha(frame);
        let columns = width.div_ceil(cell);
        let mut rows = Rows::default();
        for row in 0..weights.rows() {
            let (left, top) = (row % columns * cell, row / columns * cell);
            let inside = (top..(top + cell).min(height))
                .flat_map(|y| (left..(left + cell).min(width)).map(move |x| y * width + x));
            let (mut count, mut base, mut target, mut solid) = (0.0f32, 0.0, 0.0, true);
            for pixel in inside {
                count += 1.0;
                base += linear[pixels + pixel];
                target += recorded(pixel);
                solid &= matte[pixel] > 127;
            }
            let total: f32 = weights.row(row).map(|(_, weight)| weight).sum();
            if !solid || total < self.options.least_weight * count {
                continue;
            }
            let before = rows.columns.len();
            for (gaussian, weight) in weights.row(row) {
                rows.columns.push(self.column_of[gaussian as usize]);
                rows.weights.push(weight / count);
            }
            rows.lengths.push((rows.columns.len() - before) as u32);
            rows.base.push(base / count);
            rows.target.push(target / count);
            rows.pixels.push(count);
        }
        Ok(rows)
    }
}
