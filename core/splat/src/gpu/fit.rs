//! One step of a fit on a device, in one submission: picture, shading, encoding, loss, and the way back to the gradients
//! of the scene and of the light. What the CPU does with `render`, `shade`, `srgb_encode`, `photometric`, `mask_loss` and
//! their backward halves. Scenes go there and gradients come back, or both stay there too (`resident.rs`); pictures never
//! leave the device.

use std::sync::Arc;

use heartian_space::Camera;

use super::arena::{Store, uniform};
use super::device::Gpu;
use super::light::Lighting;
use super::params::{LossWeights, TILE};
use super::program::{Call, Groups, Recording, Source};
use super::raster::{GpuRasteriser, WANTED};
use crate::environment::Environment;
use crate::error::{SplatError, expect_length};
use crate::fit::{FitStep, FitTarget};
use crate::gaussians::Gaussians;
use crate::harmonics::COUNT;
use crate::loss::{Photometric, PhotometricWeights};
use crate::project::RasterOptions;
use crate::shade::DEFERRED_CHANNELS;

/// Features of a scene without a light: linear colour.
const COLORS: usize = 3;
/// How often a list that does not fit is given more room.
const TRIES: usize = 4;
/// Words of a step's report; see `total` of `loss.wgsl`.
pub(super) const REPORT_WORDS: usize = 8;

/// Makes steps on a device.
#[derive(Debug)]
pub struct GpuFitter {
    pub(super) gpu: Arc<Gpu>,
    pub(super) raster: GpuRasteriser,
    pub(super) lighting: Lighting,
    pub(super) weights: wgpu::Buffer,
    pub(super) buffers: Buffers,
    pub(super) recording: Recording,
    /// The light's step, made apart from the others.
    pub(super) light_step: Recording,
}

#[derive(Debug)]
pub(super) struct Buffers {
    linear: Store,
    image: Store,
    pub wanted: Store,
    maps: Store,
    slopes: Store,
    on_image: Store,
    sums: Store,
    pub reports: Store,
    pub status: Store,
    on_light: Store,
    pub on_radiance: Store,
}

impl Buffers {
    fn new() -> Self {
        let new = Store::new;
        Self {
            linear: new("the shaded picture"),
            image: new("the encoded picture"),
            wanted: new("the target"),
            maps: new("the smoothed maps"),
            slopes: new("the similarity's slopes"),
            on_image: new("the image's gradient"),
            sums: new("the losses of the tiles"),
            reports: new("the losses"),
            status: new("the losses"),
            on_light: new("the light's gradient in the tiles"),
            on_radiance: new("the light's gradient"),
        }
    }

    fn ensure(&mut self, gpu: &Gpu, pixels: usize, tiles: usize) -> Result<bool, SplatError> {
        let sizes = [
            (&mut self.linear, 4 * pixels),
            (&mut self.image, 4 * pixels),
            (&mut self.wanted, 4 * pixels),
            (&mut self.maps, 5 * 4 * pixels),
            (&mut self.slopes, 3 * 4 * pixels),
            (&mut self.on_image, 4 * pixels),
            (&mut self.sums, 4 * tiles),
            (&mut self.reports, REPORT_WORDS * GpuFitter::REPORTS),
            (&mut self.status, 1),
            (&mut self.on_light, 4 * COUNT * tiles),
            (&mut self.on_radiance, 4 * COUNT),
        ];
        let mut changed = false;
        for (store, words) in sizes {
            changed |= store.ensure(gpu, words)?;
        }
        Ok(changed)
    }
}

impl GpuFitter {
    /// On a device.
    ///
    /// # Errors
    /// When the device failed.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, SplatError> {
        Ok(Self {
            gpu: Arc::clone(gpu),
            raster: GpuRasteriser::new(gpu),
            lighting: Lighting::new(gpu)?,
            weights: uniform(gpu, bytemuck::bytes_of(&LossWeights::default())),
            buffers: Buffers::new(),
            recording: Recording::default(),
            light_step: Recording::default(),
        })
    }

    /// Renders, compares and differentiates. A scene of three features is linear colour and needs no light; one of eight
    /// is materials (see [`crate::channel`]) and needs one.
    ///
    /// # Errors
    /// When lengths do not fit, the light is missing or too many, the device cannot hold the scene, or failed.
    pub fn step(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        environment: Option<&Environment>,
        target: &FitTarget<'_>,
    ) -> Result<FitStep, SplatError> {
        let pixels = camera.width * camera.height;
        let features = if environment.is_some() { DEFERRED_CHANNELS } else { COLORS };
        expect_length("the features of a Gaussian", features, gaussians.channels)?;
        expect_length("the target", 3 * pixels, target.rgb.len())?;
        expect_length("the target's alpha", pixels, target.alpha.len())?;
        if let Some(environment) = environment {
            self.lighting.set(&self.gpu, environment)?;
        }
        for _ in 0..TRIES {
            self.prepare(gaussians, camera, target)?;
            let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            self.encode(&mut encoder)?;
            self.gpu.queue.submit([encoder.finish()]);
            let [geometry, channels] = self.raster.gradient_parts()?;
            let parts = self.gpu.read(&[
                (self.raster.totals()?, 16),
                (self.buffers.reports.get()?, 16),
                (self.buffers.on_radiance.get()?, 16 * COUNT as u64),
                geometry,
                channels,
            ])?;
            if !self.raster.make_room(parts[0][WANTED] as usize) {
                return Ok(self.result(&parts, environment.is_some(), target));
            }
        }
        Err(self.gpu.error("the list of tile entries does not settle; run with --device cpu"))
    }

    /// Everything from the scene's values to its gradients.
    pub(super) fn encode(&self, encoder: &mut wgpu::CommandEncoder) -> Result<(), SplatError> {
        self.raster.encode_forward(encoder)?;
        self.recording.replay(encoder, Some(self.raster.dispatches()?));
        self.raster.encode_backward(encoder)
    }

    /// Brings scene, target and constants to the device, and records the dispatches where buffers changed.
    fn prepare(&mut self, gaussians: &Gaussians, camera: &Camera, target: &FitTarget<'_>) -> Result<(), SplatError> {
        let pixels = camera.width * camera.height;
        let changed = self.raster.take(gaussians, camera, &RasterOptions::default())?;
        self.ready(camera, gaussians.channels, changed)?;
        let wanted: Vec<[f32; 4]> = (0..pixels)
            .map(|i| [target.rgb[i], target.rgb[pixels + i], target.rgb[2 * pixels + i], target.alpha[i]])
            .collect();
        self.gpu.queue.write_buffer(self.buffers.wanted.get()?, 0, bytemuck::cast_slice(&wanted));
        self.set_weights(pixels, target.weights, target.mask_weight);
        Ok(())
    }

    /// Room for pictures and losses, and their dispatches where the scene's buffers, or these, are others than before.
    pub(super) fn ready(&mut self, camera: &Camera, features: usize, changed: bool) -> Result<(), SplatError> {
        let pixels = camera.width * camera.height;
        let grid = [camera.width.div_ceil(TILE), camera.height.div_ceil(TILE)];
        let changed = changed | self.raster.ready_backward()?;
        let others = self.buffers.ensure(&self.gpu, pixels, grid[0] * grid[1])?;
        if changed || others || self.recording.is_empty() {
            self.record(grid, features)?;
        }
        Ok(())
    }

    pub(super) fn set_weights(&self, pixels: usize, weights: PhotometricWeights, mask: f32) {
        let each = 1.0 / pixels as f32;
        let (l1, dssim) = (weights.l1 * each / 3.0, weights.dssim * each / 3.0);
        let weights = LossWeights { l1, dssim, mask: mask * each, slot: 0 };
        self.gpu.queue.write_buffer(&self.weights, 0, bytemuck::bytes_of(&weights));
    }

    fn record(&mut self, grid: [usize; 2], features: usize) -> Result<(), SplatError> {
        let b = &self.buffers;
        let mut recording = Recording::default();
        let groups_of_channels = (features + 1).div_ceil(4) as u32;
        let over_pixels = Groups::Grid(grid[0] as u32, grid[1] as u32);
        let mut add = |source, entry, bindings: &[(u32, &wgpu::Buffer)], groups| {
            recording.add(&self.gpu, groups_of_channels, &Call { source, entry, bindings, groups });
        };
        let (params, picture) = self.raster.picture()?;
        let (params, picture, linear) = ((0, params), (3, picture), (4, b.linear.get()?));
        let [light, tables] = self.lighting.bindings()?;
        let (image, on_image) = (b.image.get()?, b.on_image.get()?);
        // A kernel's text decides what is bound to it, also where there is no light.
        add(Source::Shade, "shade", &[params, light, tables, picture, linear, (6, image)], over_pixels);
        let (weights, from, wanted) = ((1, &self.weights), (2, image), (3, b.wanted.get()?));
        let (maps, slopes) = ((4, b.maps.get()?), (5, b.slopes.get()?));
        add(Source::Loss, "across", &[params, from, wanted, maps], over_pixels);
        add(Source::Loss, "similarity", &[params, maps, slopes], over_pixels);
        add(Source::Loss, "back_across", &[params, maps, slopes], over_pixels);
        let sums = (7, b.sums.get()?);
        let bindings = [params, weights, from, wanted, maps, slopes, (6, on_image), sums];
        add(Source::Loss, "differentiate", &bindings, over_pixels);
        let bindings =
            [params, weights, sums, (8, b.reports.get()?), (9, self.raster.totals()?), (10, b.status.get()?)];
        add(Source::Loss, "total", &bindings, Groups::Linear(1));
        let gradient = (8, self.raster.gradient()?);
        let on_light = (9, b.on_light.get()?);
        let bindings = [params, light, tables, picture, linear, (7, on_image), gradient, on_light];
        add(Source::Shade, "shade_backward", &bindings, over_pixels);
        if groups_of_channels > 1 {
            let bindings = [params, on_light, (10, b.on_radiance.get()?)];
            add(Source::Shade, "sum_light", &bindings, Groups::Linear(COUNT as u32));
        }
        let mut light_step = Recording::default();
        self.lighting.record(&self.gpu, &mut light_step, [b.on_radiance.get()?, b.status.get()?])?;
        (self.recording, self.light_step) = (recording, light_step);
        self.gpu.check()
    }

    fn result(&self, parts: &[Vec<u32>], is_lit: bool, target: &FitTarget<'_>) -> FitStep {
        let values = |part: usize| -> &[[f32; 4]] { bytemuck::cast_slice(&parts[part]) };
        let [absolute, squared, similarity, mask] = values(1)[0].map(f64::from);
        let (l1, ssim) = (absolute / 3.0, similarity / 3.0);
        let PhotometricWeights { l1: of_l1, dssim } = target.weights;
        let total = f64::from(of_l1) * l1 + f64::from(dssim) * (1.0 - ssim);
        let lit = if is_lit { COUNT } else { 0 };
        FitStep {
            photometric: Photometric { total, l1, ssim },
            squared_error: squared / 3.0,
            mask,
            gradients: self.raster.gradients(&parts[3], &parts[4]),
            radiance: values(2)[..lit].iter().map(|[r, g, b, _]| [*r, *g, *b]).collect(),
        }
    }
}
