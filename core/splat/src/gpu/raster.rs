//! A scene rendered and differentiated on a device: [`render`](crate::render) and [`backward`](crate::backward) in one
//! object, which keeps its buffers and recorded dispatches from frame to frame.

use std::sync::Arc;

use heartian_space::Camera;
use rayon::prelude::*;

use super::arena::{Store, uniform};
use super::device::Gpu;
use super::params::{BLOCK, GROUP, Params};
use super::program::{Call, Groups, Recording, Source};
use super::scene::{Buffers, Shape};
use super::sort::{self, Pairs};
use crate::error::{SplatError, expect_length};
use crate::gaussians::{Gaussians, SceneGradients};
use crate::project::{RasterOptions, View};
use crate::render::{Frame, FrameGradient, check_scene};

/// Room for entries at first: of a Gaussian, and at least.
const ENTRIES_EACH: usize = 6;
const FEWEST_ENTRIES: usize = 1 << 16;
/// How often a list that does not fit is given more room before that counts as a fault.
const TRIES: usize = 4;
/// Words of the totals (see `common.wgsl`) and of the dispatches (see `plan` of `bin.wgsl`).
const ENTRIES: u32 = 0;
pub(super) const WANTED: usize = 1;
const GAUSSIANS: u32 = 2;
const OVER_BLOCKS: Groups = Groups::Indirect(0);
const OVER_ENTRIES: Groups = Groups::Indirect(1);
const OVER_BUCKETS: Groups = Groups::Indirect(2);

/// Renders scenes on a device, one at a time.
#[derive(Debug)]
pub struct GpuRasteriser {
    gpu: Arc<Gpu>,
    buffers: Buffers,
    pub(super) shape: Shape,
    /// Entries that a list is to have room for.
    room: usize,
    params: wgpu::Buffer,
    forward: Recording,
    backward: Recording,
    /// The last scene: whether it was rendered, and with depth.
    rendered: Option<bool>,
}

impl GpuRasteriser {
    /// On a device.
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self {
            gpu: Arc::clone(gpu),
            buffers: Buffers::new(),
            shape: Shape::default(),
            room: 0,
            params: uniform(gpu, bytemuck::bytes_of(&Params::default())),
            forward: Recording::default(),
            backward: Recording::default(),
            rendered: None,
        }
    }

    /// The picture of a scene; [`crate::render`] gives the same within rounding.
    ///
    /// # Errors
    /// As [`crate::render`]; when the device cannot hold the scene, or failed.
    pub fn render(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        options: &RasterOptions,
    ) -> Result<Frame, SplatError> {
        self.rendered = None;
        for _ in 0..TRIES {
            self.take(gaussians, camera, options)?;
            let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            self.encode_forward(&mut encoder)?;
            self.gpu.queue.submit([encoder.finish()]);
            let picture = (self.buffers.picture.get()?, 4 * self.shape.picture_words() as u64);
            let parts = self.gpu.read(&[picture, (self.totals()?, 16)])?;
            if !self.make_room(parts[1][WANTED] as usize) {
                self.rendered = Some(options.depth);
                return Ok(self.frame(&parts[0], options.depth));
            }
        }
        Err(self.gpu.error("the list of tile entries does not settle; run with --device cpu"))
    }

    /// Gradients of the scene that was rendered last; [`crate::backward`] gives the same within rounding.
    ///
    /// # Errors
    /// When a length contradicts the frame's, nothing was rendered yet, the device cannot hold the gradients, or failed.
    pub fn backward(&mut self, gradient: &FrameGradient) -> Result<SceneGradients, SplatError> {
        let Some(depth) = self.rendered else {
            return Err(self.gpu.error("gradients were asked for before a picture; render first"));
        };
        let shape = self.shape;
        let pixels = shape.pixels();
        expect_length("the gradient of the planes", shape.features * pixels, gradient.planes.len())?;
        if !gradient.depth.is_empty() {
            expect_length("the gradient of the depth", usize::from(depth) * pixels, gradient.depth.len())?;
        }
        if !gradient.transmittance.is_empty() {
            expect_length("the gradient of the transmittance", pixels, gradient.transmittance.len())?;
        }
        self.ready_backward()?;
        let grouped = self.grouped(gradient, depth);
        self.gpu.queue.write_buffer(self.buffers.gradient.get()?, 0, bytemuck::cast_slice(&grouped));
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.encode_backward(&mut encoder)?;
        self.gpu.queue.submit([encoder.finish()]);
        let parts = self.gpu.read(&self.gradient_parts()?)?;
        Ok(self.gradients(&parts[0], &parts[1]))
    }

    /// Brings a scene to the device: room for it, its dispatches, its values; gives whether the buffers are others than
    /// before or of other sizes.
    ///
    /// # Errors
    /// As [`GpuRasteriser::render`].
    pub(super) fn take(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        options: &RasterOptions,
    ) -> Result<bool, SplatError> {
        check_scene(gaussians, camera, options)?;
        let changed = self.reserve([gaussians.len(), gaussians.channels], camera, options, None)?;
        self.upload(gaussians)?;
        Ok(changed)
    }

    /// Room and dispatches for so many Gaussians of so many features, and the constants of a frame; gives what
    /// [`GpuRasteriser::take`] does. The camera is one that was checked; `room` is for entries, unless more was asked for
    /// before.
    ///
    /// # Errors
    /// When the device cannot hold the scene.
    pub(super) fn reserve(
        &mut self,
        [count, features]: [usize; 2],
        camera: &Camera,
        options: &RasterOptions,
        room: Option<usize>,
    ) -> Result<bool, SplatError> {
        let channels = features + usize::from(options.depth);
        let shape = Shape {
            count,
            features,
            groups: Shape::groups_for(channels),
            width: camera.width,
            height: camera.height,
            capacity: self.room.max(room.unwrap_or((ENTRIES_EACH * count).max(FEWEST_ENTRIES))),
        };
        let changed = self.buffers.ensure_forward(&self.gpu, &shape)? || shape != self.shape || self.forward.is_empty();
        if changed {
            self.shape = shape;
            self.backward = Recording::default();
            self.record_forward()?;
        }
        let params = Params {
            count: count as u32,
            features: features as u32,
            channels: channels as u32,
            width: shape.width as u32,
            height: shape.height as u32,
            columns: shape.grid()[0] as u32,
            tiles: shape.tiles() as u32,
            capacity: shape.capacity as u32,
            stride: shape.stride() as u32,
            ..Params::of_view(&View::new(camera, options))
        };
        self.gpu.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
        Ok(changed)
    }

    /// Whether a list of `wanted` entries had no room; it has at the next frame.
    pub(super) fn make_room(&mut self, wanted: usize) -> bool {
        let is_short = wanted > self.shape.capacity;
        if is_short {
            self.room = wanted + wanted / 4;
        }
        is_short
    }

    /// The device.
    pub(super) fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The constants and the composited picture, for kernels that go on from there.
    pub(super) fn picture(&self) -> Result<(&wgpu::Buffer, &wgpu::Buffer), SplatError> {
        Ok((&self.params, self.buffers.picture.get()?))
    }

    /// What kernels before and after the rasteriser write and read: geometry, features, and the gradients of both, with
    /// their words.
    pub(super) fn scene(&self) -> [(&Store, usize); 4] {
        let (b, n) = (&self.buffers, self.shape.count);
        [
            (&b.geometry, 12 * n),
            (&b.features, self.shape.features * n),
            (&b.on_geometry, 4 * GROUP * n),
            (&b.on_features, GROUP * self.shape.groups * n),
        ]
    }

    /// The totals; the second word is how many entries there were, with or without room.
    pub(super) fn totals(&self) -> Result<&wgpu::Buffer, SplatError> {
        self.buffers.totals.get()
    }

    /// The sizes of dispatches that the device decides.
    pub(super) fn dispatches(&self) -> Result<&wgpu::Buffer, SplatError> {
        self.buffers.dispatches.get()
    }

    fn upload(&self, gaussians: &Gaussians) -> Result<(), SplatError> {
        let mut geometry = vec![[0.0f32; 12]; self.shape.count];
        geometry.par_iter_mut().enumerate().for_each(|(i, row)| {
            let ([x, y, z], [a, b, c]) = (gaussians.means[i], gaussians.scales[i]);
            let [qw, qx, qy, qz] = gaussians.rotations[i];
            *row = [x, y, z, gaussians.opacities[i], a, b, c, 0.0, qw, qx, qy, qz];
        });
        let queue = &self.gpu.queue;
        queue.write_buffer(self.buffers.geometry.get()?, 0, bytemuck::cast_slice(&geometry));
        queue.write_buffer(self.buffers.features.get()?, 0, bytemuck::cast_slice(gaussians.features));
        Ok(())
    }

    /// Everything from the values to the composited picture.
    pub(super) fn encode_forward(&self, encoder: &mut wgpu::CommandEncoder) -> Result<(), SplatError> {
        encoder.clear_buffer(self.buffers.ranges.get()?, 0, None);
        encoder.clear_buffer(self.totals()?, 0, None);
        self.forward.replay(encoder, Some(self.dispatches()?));
        Ok(())
    }

    /// Makes room for a backward pass and records it; gives whether the buffers are others than before.
    ///
    /// # Errors
    /// When the device cannot hold it.
    pub(super) fn ready_backward(&mut self) -> Result<bool, SplatError> {
        let changed = self.buffers.ensure_backward(&self.gpu, &self.shape)? || self.backward.is_empty();
        if changed {
            self.record_backward()?;
        }
        Ok(changed)
    }

    /// The picture's gradient, to be written before the backward pass.
    pub(super) fn gradient(&self) -> Result<&wgpu::Buffer, SplatError> {
        self.buffers.gradient.get()
    }

    /// Everything from the picture's gradient to the scene's.
    pub(super) fn encode_backward(&self, encoder: &mut wgpu::CommandEncoder) -> Result<(), SplatError> {
        encoder.clear_buffer(self.buffers.buckets.get()?, 0, None);
        self.backward.replay(encoder, Some(self.dispatches()?));
        Ok(())
    }

    /// What to read for [`GpuRasteriser::gradients`], with its bytes.
    pub(super) fn gradient_parts(&self) -> Result<[(&wgpu::Buffer, u64); 2], SplatError> {
        let geometry = 16 * GROUP * self.shape.count;
        let features = 4 * GROUP * self.shape.groups * self.shape.count;
        Ok([(self.buffers.on_geometry.get()?, geometry as u64), (self.buffers.on_features.get()?, features as u64)])
    }

    fn record_forward(&mut self) -> Result<(), SplatError> {
        let (gpu, b, shape) = (&*self.gpu, &self.buffers, self.shape);
        let mut recording = Recording::default();
        let groups = shape.groups as u32;
        let over = |size: usize| Groups::Linear(shape.count.div_ceil(size) as u32);
        let (params, records, payload) = ((0, &self.params), (3, b.records.get()?), (4, b.payload.get()?));
        let (depths, order) = ([b.depths[0].get()?, b.depths[1].get()?], [b.order[0].get()?, b.order[1].get()?]);
        let (tiles, places) = ([b.tiles[0].get()?, b.tiles[1].get()?], [b.places[0].get()?, b.places[1].get()?]);
        let (totals, table, digits) = (b.totals.get()?, b.table.get()?, b.digits.get()?);
        let bindings = [
            params,
            (1, b.geometry.get()?),
            (2, b.features.get()?),
            records,
            payload,
            (5, depths[0]),
            (6, order[0]),
            (7, totals),
        ];
        recording.add(
            gpu,
            groups,
            &Call { source: Source::Project, entry: "project", bindings: &bindings, groups: over(256) },
        );
        let stride = shape.stride() as u32;
        let passes = |count, word, indexed| -> Vec<wgpu::Buffer> {
            let constants = sort::constants(count, word, stride, indexed);
            constants.iter().map(|pass| uniform(gpu, bytemuck::bytes_of(pass))).collect()
        };
        let pairs = Pairs { keys: depths, values: order, totals, table, digits };
        let at = sort::record(&mut recording, gpu, &pairs, &passes(4, GAUSSIANS, false), over(BLOCK));
        let (keys, order) = ((2, depths[at]), (3, order[at]));
        let (records, before, blocks) = ((1, b.records.get()?), (4, b.before.get()?), (5, b.blocks.get()?));
        let mut bin = |entry, bindings: &[(u32, &wgpu::Buffer)], size| {
            recording.add(gpu, groups, &Call { source: Source::Bin, entry, bindings, groups: size });
        };
        bin("count", &[params, records, keys, order, before, blocks], over(BLOCK));
        bin("plan", &[params, blocks, (6, totals), (7, b.dispatches.get()?)], Groups::Linear(1));
        let (spans, owners) = ((8, b.spans.get()?), b.owners.get()?);
        bin(
            "emit",
            &[params, records, order, before, blocks, (6, totals), spans, (9, tiles[0]), (11, owners)],
            over(256),
        );
        // One more tile than there are: that of entries that belong to none.
        let digits_of_tiles = passes(sort::passes_for(shape.tiles() + 1), ENTRIES, true);
        let pairs = Pairs { keys: tiles, values: places, totals, table, digits };
        let at = sort::record(&mut recording, gpu, &pairs, &digits_of_tiles, OVER_BLOCKS);
        let (ranges, entries) = (b.ranges.get()?, b.entries.get()?);
        let sorted = [(12, tiles[at]), (13, places[at]), (14, owners)];
        let bindings = [params, (6, totals), sorted[0], sorted[1], sorted[2], (15, ranges), (16, entries)];
        let call = Call { source: Source::Bin, entry: "delimit", bindings: &bindings, groups: OVER_ENTRIES };
        recording.add(gpu, groups, &call);
        let [columns, rows] = shape.grid();
        let bindings = [params, records, (2, payload.1), (3, entries), (4, ranges), (5, b.picture.get()?)];
        let size = Groups::Grid(columns as u32, rows as u32);
        recording.add(
            gpu,
            groups,
            &Call { source: Source::Raster, entry: "forward", bindings: &bindings, groups: size },
        );
        self.forward = recording;
        self.gpu.check()
    }

    fn record_backward(&mut self) -> Result<(), SplatError> {
        let (gpu, b, shape) = (&*self.gpu, &self.buffers, self.shape);
        let mut recording = Recording::default();
        let params = (0, &self.params);
        let mut add = |source, entry, bindings: &[(u32, &wgpu::Buffer)], size| {
            recording.add(gpu, shape.groups as u32, &Call { source, entry, bindings, groups: size });
        };
        let (records, payload) = ((1, b.records.get()?), (2, b.payload.get()?));
        let (entries, ranges) = ((3, b.entries.get()?), (4, b.ranges.get()?));
        let (picture, gradient) = ((6, b.picture.get()?), (7, b.gradient.get()?));
        let (states, buckets, slots) = (b.states.get()?, b.buckets.get()?, b.slots.get()?);
        let [columns, rows] = shape.grid();
        let scene = [params, records, payload, entries, ranges];
        let bindings: Vec<_> = scene.into_iter().chain([picture, gradient, (8, states), (9, buckets)]).collect();
        add(Source::Raster, "states", &bindings, Groups::Grid(columns as u32, rows as u32));
        let bindings: Vec<_> = scene.into_iter().chain([gradient, (10, states), (11, buckets), (12, slots)]).collect();
        add(Source::Raster, "backward", &bindings, OVER_BUCKETS);
        let bindings = [
            params,
            (1, b.geometry.get()?),
            (3, records.1),
            (8, slots),
            (9, b.spans.get()?),
            (10, b.on_geometry.get()?),
            (11, b.on_features.get()?),
        ];
        add(Source::Project, "project_backward", &bindings, Groups::Linear(shape.count.div_ceil(64) as u32));
        self.backward = recording;
        self.gpu.check()
    }
}
