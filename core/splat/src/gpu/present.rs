//! Frames of a clip: rendered, shaded, encoded and quantised on a device, two in flight, read back while the next is
//! computed. What comes back is a frame's straight sRGB with its matte, eight bits each.

use std::collections::VecDeque;
use std::sync::Arc;

use heartian_space::Camera;

use super::arena::Store;
use super::device::Gpu;
use super::kernel::{GpuBuffer, GpuKernels};
use super::light::Lighting;
use super::program::{Call, Groups, Recording, Source};
use super::raster::{GpuRasteriser, WANTED};
use crate::environment::Environment;
use crate::error::{SplatError, expect_length};
use crate::gaussians::Gaussians;
use crate::project::RasterOptions;
use crate::render::check_camera;
use crate::shade::DEFERRED_CHANNELS;

/// Side of a workgroup of pixels.
const SIDE: usize = 16;

/// Renders frames on a device, some ahead of those that were collected.
#[derive(Debug)]
pub struct GpuPresenter {
    gpu: Arc<Gpu>,
    raster: GpuRasteriser,
    lighting: Lighting,
    codes: Store,
    linear: Store,
    image: Store,
    recording: Recording,
    /// Of a frame.
    pixels: usize,
    flying: VecDeque<Flight>,
}

/// A frame on its way back.
#[derive(Debug)]
struct Flight {
    submission: wgpu::SubmissionIndex,
    /// Codes, then the totals.
    staging: wgpu::Buffer,
    pixels: usize,
}

impl GpuPresenter {
    /// Frames that should be in flight before one is collected.
    pub const AHEAD: usize = 2;

    /// On a device.
    ///
    /// # Errors
    /// When the device failed.
    pub fn new(gpu: &Arc<Gpu>) -> Result<Self, SplatError> {
        Ok(Self {
            gpu: Arc::clone(gpu),
            raster: GpuRasteriser::new(gpu),
            lighting: Lighting::new(gpu)?,
            codes: Store::new("the finished picture"),
            linear: Store::new("the shaded picture"),
            image: Store::new("the encoded picture"),
            recording: Recording::default(),
            pixels: 0,
            flying: VecDeque::new(),
        })
    }

    /// Frames submitted and not collected.
    pub fn in_flight(&self) -> usize {
        self.flying.len()
    }

    /// Starts on a frame of materials (see [`crate::channel`]) under a light; does not wait for it.
    ///
    /// # Errors
    /// When the scene has not eight features, the camera is unusable, the device cannot hold the scene, or failed.
    pub fn submit(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        environment: &Environment,
    ) -> Result<(), SplatError> {
        expect_length("the features of a material", DEFERRED_CHANNELS, gaussians.channels)?;
        let changed = self.raster.take(gaussians, camera, &RasterOptions::default())?;
        self.ready(camera, environment, changed)?;
        self.launch(&[])
    }

    /// Makes room for `count` Gaussians of materials that kernels make; gives the buffers that they write, geometry and
    /// features (see [`crate::GpuScene`]). They are others after every call.
    ///
    /// # Errors
    /// When the camera is unusable, the light's coefficients are too few or many, or the device cannot hold the scene.
    pub fn reserve(
        &mut self,
        count: usize,
        camera: &Camera,
        environment: &Environment,
    ) -> Result<[GpuBuffer; 2], SplatError> {
        check_camera(camera)?;
        let changed = self.raster.reserve([count, DEFERRED_CHANNELS], camera, &RasterOptions::default(), None)?;
        self.ready(camera, environment, changed)?;
        let [geometry, features, ..] = self.raster.scene();
        Ok([GpuBuffer::of(&self.gpu, geometry.0, geometry.1)?, GpuBuffer::of(&self.gpu, features.0, features.1)?])
    }

    /// Starts on a frame that kernels make in what [`GpuPresenter::reserve`] gave; does not wait for it.
    ///
    /// # Errors
    /// When nothing was reserved, or the device failed.
    pub fn submit_made(&mut self, before: &[&GpuKernels]) -> Result<(), SplatError> {
        self.launch(before)
    }

    fn ready(&mut self, camera: &Camera, environment: &Environment, changed: bool) -> Result<(), SplatError> {
        self.pixels = camera.width * camera.height;
        if self.codes.ensure(&self.gpu, self.pixels)? || changed || self.recording.is_empty() {
            self.record(camera)?;
        }
        self.lighting.set(&self.gpu, environment)
    }

    fn launch(&mut self, before: &[&GpuKernels]) -> Result<(), SplatError> {
        let (pixels, bytes) = (self.pixels, 4 * self.pixels as u64);
        let staging = self.gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("a finished picture"),
            size: bytes + 16,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        before.iter().for_each(|kernels| kernels.recording.replay(&mut encoder, None));
        self.raster.encode_forward(&mut encoder)?;
        self.recording.replay(&mut encoder, Some(self.raster.dispatches()?));
        encoder.copy_buffer_to_buffer(self.codes.get()?, 0, &staging, 0, bytes);
        encoder.copy_buffer_to_buffer(self.raster.totals()?, 0, &staging, bytes, 16);
        let submission = self.gpu.queue.submit([encoder.finish()]);
        // What goes wrong here shows when the range is asked for.
        staging.map_async(wgpu::MapMode::Read, .., |_| ());
        self.flying.push_back(Flight { submission, staging, pixels });
        self.gpu.check()
    }

    /// The oldest frame in flight, `height × width` of red, green, blue and matte; waits for it. Nothing when its list of
    /// entries had no room: more is made then, all frames in flight are dropped, and it and they must be submitted again
    /// (and reserved anew).
    ///
    /// # Errors
    /// When no frame is in flight, or the device failed.
    pub fn collect(&mut self) -> Result<Option<Vec<u8>>, SplatError> {
        let Some(flight) = self.flying.pop_front() else {
            return Err(self.gpu.error("no frame is in flight; submit one first"));
        };
        self.gpu.wait_for(flight.submission)?;
        let range = flight.staging.get_mapped_range(..);
        let range = range.map_err(|e| self.gpu.error(format!("nothing can be read back: {e}")))?;
        let (codes, totals) = range.split_at(4 * flight.pixels);
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(totals);
        if self.raster.make_room(totals[WANTED] as usize) {
            self.flying.clear();
            return Ok(None);
        }
        Ok(Some(codes.to_vec()))
    }

    /// The shaded picture of a scene before it is encoded, `3 × height × width` linear RGB over black; waits for it.
    ///
    /// # Errors
    /// As [`GpuPresenter::submit`].
    pub fn shaded(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        environment: &Environment,
    ) -> Result<Vec<f32>, SplatError> {
        let pixels = camera.width * camera.height;
        self.linear.ensure(&self.gpu, 4 * pixels)?;
        self.image.ensure(&self.gpu, 4 * pixels)?;
        loop {
            self.submit(gaussians, camera, environment)?;
            if self.collect()?.is_some() {
                break;
            }
        }
        let mut recording = Recording::default();
        let linear = (4, self.linear.get()?);
        self.add(&mut recording, "shade", &[linear, (6, self.image.get()?)], camera)?;
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        recording.replay(&mut encoder, Some(self.raster.dispatches()?));
        self.gpu.queue.submit([encoder.finish()]);
        let parts = self.gpu.read(&[(linear.1, 16 * pixels as u64)])?;
        let values: &[[f32; 4]] = bytemuck::cast_slice(&parts[0]);
        Ok((0..3).flat_map(|c| values.iter().map(move |v| v[c])).collect())
    }

    fn record(&mut self, camera: &Camera) -> Result<(), SplatError> {
        let mut recording = Recording::default();
        self.add(&mut recording, "present", &[(5, self.codes.get()?)], camera)?;
        self.recording = recording;
        self.gpu.check()
    }

    fn add(
        &self,
        recording: &mut Recording,
        entry: &'static str,
        out: &[(u32, &wgpu::Buffer)],
        camera: &Camera,
    ) -> Result<(), SplatError> {
        let (params, picture) = self.raster.picture()?;
        let [light, tables] = self.lighting.bindings()?;
        let bindings = [&[(0, params), light, tables, (3, picture)], out].concat();
        let grid = Groups::Grid(camera.width.div_ceil(SIDE) as u32, camera.height.div_ceil(SIDE) as u32);
        recording.add(&self.gpu, 3, &Call { source: Source::Shade, entry, bindings: &bindings, groups: grid });
        Ok(())
    }
}
