//! A frame from a scene, and a scene's gradients from a frame's: projection, depth order, tiles, kernels, gather.
//!
//! What always holds: the same inputs give the same bits at any number of threads (tiles are independent, each entry of
//! a tile has a slot of its own, slots are gathered in one order, and nothing is added atomically). A Gaussian that is
//! not drawn gets zero gradients.

use crate::bin::{TILE_HEIGHT, TILE_WIDTH, Tiles, bin, order_by_depth};
use crate::error::{SplatError, expect_length};
use crate::gaussians::{Gaussians, MAX_CHANNELS, SceneGradients};
use crate::lanes::MAX_LANES;
use crate::project::{GeometryGradient, RasterOptions, Splat, SplatGradient, View, project, project_backward};
use crate::raster::{self, PlaneGradients, PlanePointers, RECORD_HEAD, SLOT_HEAD, TileJob};
use heartian_space::Camera;
use rayon::prelude::*;

/// Gaussians a task of the parallel loops over Gaussians takes.
const CHUNK: usize = 512;

/// A scene projected, sorted and binned for one camera; what [`composite`], [`backward`] and blend weights share.
#[derive(Clone, Debug)]
pub struct Prepared {
    pub(crate) camera: Camera,
    pub(crate) options: RasterOptions,
    /// Number of Gaussians in the scene.
    pub(crate) count: usize,
    /// Channels of the kernel: those composited, depth included, and zeros up to what a kernel is built for.
    pub(crate) channels: usize,
    /// Features of each Gaussian.
    pub(crate) features: usize,
    /// Drawn splats in depth order, and the Gaussian of each.
    pub(crate) splats: Vec<Splat>,
    pub(crate) gaussian_of_splat: Vec<u32>,
    /// Kernel records in depth order, stride `RECORD_HEAD + channels`.
    pub(crate) records: Vec<f32>,
    pub(crate) tiles: Tiles,
}

/// A composited picture: planar, premultiplied over black.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Number of feature planes.
    pub channels: usize,
    /// `channels × height × width` composited features `Σ f·α·T`.
    pub planes: Vec<f32>,
    /// `height × width` composited depth `Σ z·α·T` in metres; empty unless asked for.
    pub depth: Vec<f32>,
    /// `height × width` transmittance left behind the last Gaussian; alpha is one minus this.
    pub transmittance: Vec<f32>,
}

impl Frame {
    /// One feature plane, `height × width`.
    pub fn plane(&self, channel: usize) -> &[f32] {
        let pixels = self.width * self.height;
        &self.planes[channel * pixels..][..pixels]
    }

    /// Alpha of every pixel, `height × width`.
    pub fn alpha(&self) -> Vec<f32> {
        self.transmittance.iter().map(|t| 1.0 - t).collect()
    }
}

/// Gradient of a loss with respect to a [`Frame`].
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameGradient<'a> {
    /// `channels × height × width`.
    pub planes: &'a [f32],
    /// `height × width`, or empty for zero.
    pub depth: &'a [f32],
    /// `height × width` with respect to transmittance (that of alpha, negated), or empty for zero.
    pub transmittance: &'a [f32],
}

/// Runs `$body` with the constant `C` equal to `$channels`, one of those that [`kernel_channels`] gives.
macro_rules! with_channels {
    ($channels:expr, $body:expr) => {
        match $channels {
            1 => {
                const C: usize = 1;
                $body
            }
            3 => {
                const C: usize = 3;
                $body
            }
            4 => {
                const C: usize = 4;
                $body
            }
            8 => {
                const C: usize = 8;
                $body
            }
            9 => {
                const C: usize = 9;
                $body
            }
            10 => {
                const C: usize = 10;
                $body
            }
            _ => {
                const C: usize = MAX_CHANNELS;
                $body
            }
        }
    };
}

/// The channels of the kernel that composites `channels`: the next count that one is built for. The rest are zeros.
fn kernel_channels(channels: usize) -> usize {
    [1, 3, 4, 8, 9, 10].into_iter().find(|&c| c >= channels).unwrap_or(MAX_CHANNELS)
}

/// Projects, sorts and bins a scene.
///
/// # Errors
/// When the scene's arrays disagree, there are too many channels, or the camera is unusable.
pub fn prepare(gaussians: &Gaussians, camera: &Camera, options: &RasterOptions) -> Result<Prepared, SplatError> {
    gaussians.check()?;
    check_camera(camera)?;
    let channels = gaussians.channels + usize::from(options.depth);
    if channels > MAX_CHANNELS {
        return Err(SplatError::Channels { found: channels, most: MAX_CHANNELS });
    }
    let channels = kernel_channels(channels);
    let view = View::new(camera, options);
    let drawn: Vec<Vec<(u32, Splat)>> = (0..gaussians.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut found = Vec::with_capacity(CHUNK);
            project(&view, gaussians, chunk * CHUNK..((chunk + 1) * CHUNK).min(gaussians.len()), &mut found);
            found
        })
        .collect();
    let drawn = drawn.concat();
    let depths: Vec<f32> = drawn.iter().map(|(_, splat)| splat.depth).collect();
    let order = order_by_depth(&depths);
    let splats: Vec<Splat> = order.iter().map(|&i| drawn[i as usize].1).collect();
    let gaussian_of_splat: Vec<u32> = order.iter().map(|&i| drawn[i as usize].0).collect();
    let stride = RECORD_HEAD + channels;
    let mut records = vec![0.0; splats.len() * stride];
    records
        .par_chunks_mut(stride * CHUNK)
        .zip(splats.par_chunks(CHUNK))
        .zip(gaussian_of_splat.par_chunks(CHUNK))
        .for_each(|((records, splats), indices)| {
            for ((record, splat), &i) in records.chunks_exact_mut(stride).zip(splats).zip(indices) {
                let mut features = [0.0; MAX_CHANNELS];
                let own = &gaussians.features[i as usize * gaussians.channels..][..gaussians.channels];
                for (to, from) in features.iter_mut().zip(own) {
                    *to = if from.is_finite() { *from } else { 0.0 };
                }
                if options.depth {
                    features[gaussians.channels] = splat.depth;
                }
                raster::write_record(splat, &features[..channels], record);
            }
        });
    let tiles = bin(&splats, [camera.width, camera.height]);
    Ok(Prepared {
        camera: *camera,
        options: *options,
        count: gaussians.len(),
        channels,
        features: gaussians.channels,
        splats,
        gaussian_of_splat,
        records,
        tiles,
    })
}

fn check_camera(camera: &Camera) -> Result<(), SplatError> {
    let finite = camera.focal_px.iter().chain(&camera.principal_px).chain(&camera.translation).all(|v| v.is_finite())
        && camera.rotation.as_flattened().iter().all(|v| v.is_finite());
    if camera.width == 0 || camera.height == 0 {
        return Err(SplatError::Camera("its picture has no pixels; give it a width and a height"));
    }
    if camera.width > 32_768 || camera.height > 32_768 {
        return Err(SplatError::Camera("its picture is larger than 32768 pixels a side; render it in parts"));
    }
    if !finite || camera.focal_px.iter().any(|f| *f <= 0.0) {
        return Err(SplatError::Camera("its focal lengths must be positive and all its values finite"));
    }
    Ok(())
}

impl Prepared {
    /// Number of Gaussians drawn.
    pub fn drawn(&self) -> usize {
        self.splats.len()
    }

    /// Number of (Gaussian, tile) pairs.
    pub fn entries(&self) -> usize {
        self.tiles.entries.len()
    }

    /// The job of tile `index`.
    pub(crate) fn job(&self, index: usize) -> TileJob<'_> {
        let origin = [index % self.tiles.columns * TILE_WIDTH, index / self.tiles.columns * TILE_HEIGHT];
        TileJob {
            records: &self.records,
            entries: &self.tiles.entries[self.tiles.offsets[index] as usize..self.tiles.offsets[index + 1] as usize],
            origin,
            size: [TILE_WIDTH.min(self.camera.width - origin[0]), TILE_HEIGHT.min(self.camera.height - origin[1])],
        }
    }
}

/// Blends a prepared scene.
pub fn composite(prepared: &Prepared) -> Frame {
    let (width, height) = (prepared.camera.width, prepared.camera.height);
    let pixels = width * height;
    let depth = usize::from(prepared.options.depth);
    let mut frame = Frame {
        width,
        height,
        channels: prepared.features,
        planes: vec![0.0; prepared.features * pixels],
        depth: vec![0.0; depth * pixels],
        transmittance: vec![1.0; pixels],
    };
    with_channels!(prepared.channels, composite_into::<C>(prepared, &mut frame));
    frame
}

fn composite_into<const C: usize>(prepared: &Prepared, frame: &mut Frame) {
    let pixels = frame.width * frame.height;
    let mut planes = frame.planes.chunks_exact_mut(pixels).chain(frame.depth.chunks_exact_mut(pixels));
    let out = PlanePointers::<C> {
        planes: std::array::from_fn(|_| planes.next().map_or(std::ptr::null_mut(), <[f32]>::as_mut_ptr)),
        transmittance: frame.transmittance.as_mut_ptr(),
        width: frame.width,
    };
    (0..prepared.tiles.columns * prepared.tiles.rows).into_par_iter().for_each(|index| {
        let job = prepared.job(index);
        if !job.entries.is_empty() {
            raster::forward::<C>(&job, &out);
        }
    });
}

/// Projects, sorts, bins and blends: what [`backward`] needs, and the picture.
///
/// # Errors
/// As [`prepare`].
pub fn render(
    gaussians: &Gaussians,
    camera: &Camera,
    options: &RasterOptions,
) -> Result<(Prepared, Frame), SplatError> {
    let prepared = prepare(gaussians, camera, options)?;
    let frame = composite(&prepared);
    Ok((prepared, frame))
}

/// Exact gradients of a loss with respect to the scene that `prepared` and `frame` came from.
///
/// # Errors
/// When a buffer's length contradicts the frame's or the scene is not the one that was prepared.
pub fn backward(
    gaussians: &Gaussians,
    prepared: &Prepared,
    frame: &Frame,
    gradient: &FrameGradient,
) -> Result<SceneGradients, SplatError> {
    let pixels = frame.width * frame.height;
    gaussians.check()?;
    expect_length("the prepared scene", prepared.count, gaussians.len())?;
    expect_length("the features of a Gaussian", prepared.features, gaussians.channels)?;
    expect_length("the frame", prepared.camera.width * prepared.camera.height, pixels)?;
    expect_length("the gradient of the planes", frame.planes.len(), gradient.planes.len())?;
    if !gradient.depth.is_empty() {
        expect_length("the gradient of the depth", frame.depth.len(), gradient.depth.len())?;
    }
    if !gradient.transmittance.is_empty() {
        expect_length("the gradient of the transmittance", pixels, gradient.transmittance.len())?;
    }
    let zeros = if prepared.options.depth && gradient.depth.is_empty() { vec![0.0; pixels] } else { Vec::new() };
    let gradient = FrameGradient { depth: if zeros.is_empty() { gradient.depth } else { &zeros }, ..*gradient };
    let slots = with_channels!(prepared.channels, slots::<C>(prepared, frame, &gradient));
    Ok(gather(gaussians, prepared, &slots))
}

/// Every entry's gradients, in the order of the tiles.
fn slots<const C: usize>(prepared: &Prepared, frame: &Frame, gradient: &FrameGradient) -> Vec<f32> {
    let pixels = frame.width * frame.height;
    let pick = |k: usize| -> (&[f32], &[f32]) {
        match k < frame.channels {
            true => (frame.plane(k), &gradient.planes[k * pixels..][..pixels]),
            false if k == frame.channels && prepared.options.depth => (&frame.depth[..], gradient.depth),
            false => (&[], &[]),
        }
    };
    let picture = PlaneGradients::<C> {
        values: std::array::from_fn(|k| pick(k).0),
        gradients: std::array::from_fn(|k| pick(k).1),
        transmittance: &frame.transmittance,
        on_transmittance: gradient.transmittance,
        width: frame.width,
    };
    let stride = SLOT_HEAD + C;
    let mut slots = vec![0.0; prepared.tiles.entries.len() * stride];
    let mut rest = slots.as_mut_slice();
    let mut jobs = Vec::new();
    for index in 0..prepared.tiles.columns * prepared.tiles.rows {
        let job = prepared.job(index);
        let (own, next) = rest.split_at_mut(job.entries.len() * stride);
        rest = next;
        if !job.entries.is_empty() {
            jobs.push((job, own));
        }
    }
    jobs.into_par_iter().for_each(|(job, own)| raster::backward::<C>(&job, &picture, own));
    slots
}

/// Adds up each splat's slots in the order of the tiles, and carries the sums back through the projection.
fn gather(gaussians: &Gaussians, prepared: &Prepared, slots: &[f32]) -> SceneGradients {
    let (n, channels) = (gaussians.len(), gaussians.channels);
    let view = View::new(&prepared.camera, &prepared.options);
    let mut splat_of_gaussian = vec![u32::MAX; n];
    for (splat, &i) in prepared.gaussian_of_splat.iter().enumerate() {
        splat_of_gaussian[i as usize] = splat as u32;
    }
    let mut out = SceneGradients {
        means: vec![[0.0; 3]; n],
        scales: vec![[0.0; 3]; n],
        rotations: vec![[0.0; 4]; n],
        opacities: vec![0.0; n],
        features: vec![0.0; n * channels],
        means_px: vec![[0.0; 2]; n],
        weights: vec![0.0; n],
        radii_px: vec![0.0; n],
    };
    let rows =
        out.means.par_chunks_mut(CHUNK).zip(out.scales.par_chunks_mut(CHUNK)).zip(out.rotations.par_chunks_mut(CHUNK));
    let rows = rows.zip(out.opacities.par_chunks_mut(CHUNK)).zip(out.features.par_chunks_mut(CHUNK * channels));
    let rows = rows
        .zip(out.means_px.par_chunks_mut(CHUNK))
        .zip(out.weights.par_chunks_mut(CHUNK))
        .zip(out.radii_px.par_chunks_mut(CHUNK));
    rows.enumerate().for_each(
        |(chunk, (((((((means, scales), rotations), opacities), features), means_px), weights), radii))| {
            let mut batch = Batch::default();
            for k in 0..means.len() {
                let i = chunk * CHUNK + k;
                let at = splat_of_gaussian[i] as usize;
                if let Some(splat) = prepared.splats.get(at) {
                    let sum = prepared.slot_sum(at, slots);
                    let on_depth = if prepared.options.depth { sum[SLOT_HEAD + channels] } else { 0.0 };
                    let on_splat = from_moments(splat, &sum, on_depth);
                    opacities[k] = if gaussians.opacities[i] <= 1.0 { sum[0] / splat.opacity } else { 0.0 };
                    features[k * channels..][..channels].copy_from_slice(&sum[SLOT_HEAD..][..channels]);
                    means_px[k] = on_splat.mean;
                    weights[k] = sum[6];
                    radii[k] = splat.extent()[0].max(splat.extent()[1]);
                    batch.push(i as u32, *splat, on_splat);
                }
                if batch.is_full() || k + 1 == means.len() {
                    batch.flush(&view, gaussians, |i, g| {
                        let k = i as usize - chunk * CHUNK;
                        (means[k], scales[k], rotations[k]) = (g.mean, g.scale, g.rotation);
                    });
                }
            }
        },
    );
    out
}

impl Prepared {
    /// The sum of a splat's slots, in the order of its tiles.
    fn slot_sum(&self, splat: usize, slots: &[f32]) -> [f32; SLOT_HEAD + MAX_CHANNELS] {
        let stride = SLOT_HEAD + self.channels;
        let range = self.tiles.place_offsets[splat] as usize..self.tiles.place_offsets[splat + 1] as usize;
        let mut sum = [0.0f32; SLOT_HEAD + MAX_CHANNELS];
        for &place in &self.tiles.places[range] {
            for (s, v) in sum.iter_mut().zip(&slots[place as usize * stride..][..stride]) {
                *s += v;
            }
        }
        sum
    }
}

/// Splats on their way back through the projection, as many as fit a block of lanes.
#[derive(Default)]
struct Batch {
    indices: Vec<u32>,
    splats: Vec<(Splat, SplatGradient)>,
}

impl Batch {
    fn push(&mut self, index: u32, splat: Splat, gradient: SplatGradient) {
        self.indices.push(index);
        self.splats.push((splat, gradient));
    }

    fn is_full(&self) -> bool {
        self.indices.len() == MAX_LANES
    }

    fn flush(&mut self, view: &View, gaussians: &Gaussians, mut give: impl FnMut(u32, &GeometryGradient)) {
        let mut out = [GeometryGradient::default(); MAX_LANES];
        project_backward(view, gaussians, &self.indices, &self.splats, &mut out);
        self.indices.iter().zip(&out).for_each(|(&i, g)| give(i, g));
        self.indices.clear();
        self.splats.clear();
    }
}

/// Gradients of `p = −½·u²/v − ½·e·dy²`, `u = dx − s·dy`, from the moments of its gradient.
fn from_moments(splat: &Splat, sum: &[f32], depth: f32) -> SplatGradient {
    let a = 1.0 / splat.variance;
    let (s, e) = (splat.shear, splat.precision_y);
    SplatGradient {
        mean: [a * sum[1], e * sum[3] - a * s * sum[1]],
        variance: 0.5 * a * a * sum[2],
        shear: a * sum[4],
        precision_y: -0.5 * sum[5],
        depth,
    }
}
