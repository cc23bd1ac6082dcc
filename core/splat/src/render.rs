//! A frame from a scene: projection, depth order, tiles, kernels. Its derivative is in `gather.rs`.
//!
//! What always holds: the same inputs give the same bits at any number of threads, for tiles are independent.

use crate::bin::{MOST_PAIRS, TILE_HEIGHT, TILE_WIDTH, Tiles, bin};
use crate::error::SplatError;
use crate::gaussians::{Gaussians, MAX_CHANNELS};
use crate::project::{RasterOptions, Splat, View, project};
use crate::raster::{self, Blocks, PlanePointers, RECORD_HEAD, TileJob};
use crate::reach::{Reached, reach};
use crate::scratch::{Scratch, zeros};
use heartian_space::Camera;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Gaussians a task of the parallel loops over Gaussians takes.
pub(crate) const CHUNK: usize = 512;

/// A scene projected, sorted and binned for one camera; what [`composite`], [`crate::backward`] and blend weights share.
#[derive(Clone, Debug)]
pub struct Prepared {
    pub(crate) camera: Camera,
    pub(crate) options: RasterOptions,
    /// Channels of the kernel: those composited, depth included, and zeros up to what a kernel is built for.
    pub(crate) channels: usize,
    /// Features of each Gaussian.
    pub(crate) features: usize,
    /// Number of Gaussians in the scene.
    pub(crate) count: usize,
    /// Kernel records of every Gaussian, stride `RECORD_HEAD + channels`; a zero head where it is not drawn.
    pub(crate) records: Scratch,
    pub(crate) tiles: Tiles,
    /// The vectors of pixels that each entry visits, once the scene has been composited.
    visited: OnceLock<Vec<Blocks>>,
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
            _ => {
                const C: usize = MAX_CHANNELS;
                $body
            }
        }
    };
}

pub(crate) use with_channels;

/// The channels of the kernel that composites `channels`: the next count that one is built for. The rest are zeros.
fn kernel_channels(channels: usize) -> usize {
    [3, 4, 8, 9].into_iter().find(|&c| c >= channels).unwrap_or(MAX_CHANNELS)
}

/// Projects, sorts and bins a scene.
///
/// # Errors
/// When the scene's arrays disagree, there are too many channels, the camera is unusable, or the Gaussians cover too
/// many tiles.
pub fn prepare(gaussians: &Gaussians, camera: &Camera, options: &RasterOptions) -> Result<Prepared, SplatError> {
    let channels = kernel_channels(check_scene(gaussians, camera, options)?);
    let (n, size) = (gaussians.len(), [camera.width, camera.height]);
    let (mut keys, mut records) = (vec![0u64; n], Scratch::take(n * (RECORD_HEAD + channels)));
    let (view, pairs) = (View::new(camera, options), AtomicUsize::new(0));
    let chunks = keys.par_chunks_mut(CHUNK).zip(records.par_chunks_mut(CHUNK * (RECORD_HEAD + channels)));
    let reached: Vec<Reached> = chunks
        .enumerate()
        .map(|(chunk, (keys, records))| {
            let mut splats = [Splat::default(); CHUNK];
            let splats = &mut splats[..keys.len()];
            project(&view, gaussians, chunk * CHUNK, splats, keys);
            let mut reached = Reached::default();
            if pairs.load(Ordering::Relaxed) <= MOST_PAIRS {
                reach(splats, keys, size, &mut reached);
            }
            pairs.fetch_add(reached.tiles.len(), Ordering::Relaxed);
            write_records(gaussians, options.depth, chunk * CHUNK, splats, records);
            reached
        })
        .collect();
    if pairs.into_inner() > MOST_PAIRS {
        return Err(SplatError::Pairs { most: MOST_PAIRS });
    }
    let tiles = bin(&reached, &keys, size);
    Ok(Prepared {
        camera: *camera,
        options: *options,
        channels,
        features: gaussians.channels,
        count: n,
        records,
        tiles,
        visited: OnceLock::new(),
    })
}

/// Records of the Gaussians from `first` on; a feature that is not finite counts as 0.
fn write_records(gaussians: &Gaussians, depth: bool, first: usize, splats: &[Splat], records: &mut [f32]) {
    let stride = records.len() / splats.len().max(1);
    let own = gaussians.features[first * gaussians.channels..].chunks_exact(gaussians.channels);
    for ((record, splat), own) in records.chunks_exact_mut(stride).zip(splats).zip(own) {
        if !splat.is_drawn() {
            record[..RECORD_HEAD].fill(0.0);
            continue;
        }
        let mut features = [0.0; MAX_CHANNELS];
        for (to, from) in features.iter_mut().zip(own) {
            *to = if from.is_finite() { *from } else { 0.0 };
        }
        if depth {
            features[gaussians.channels] = splat.depth;
        }
        raster::write_record(splat, &features[..stride - RECORD_HEAD], record);
    }
}

/// Checks what is to be rendered; gives the number of channels, depth included.
///
/// # Errors
/// When the scene's arrays disagree, there are too many channels, or the camera is unusable.
pub(crate) fn check_scene(
    gaussians: &Gaussians,
    camera: &Camera,
    options: &RasterOptions,
) -> Result<usize, SplatError> {
    gaussians.check()?;
    check_camera(camera)?;
    let channels = gaussians.channels + usize::from(options.depth);
    if channels > MAX_CHANNELS {
        return Err(SplatError::Channels { found: channels, most: MAX_CHANNELS });
    }
    Ok(channels)
}

pub(crate) fn check_camera(camera: &Camera) -> Result<(), SplatError> {
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
        let records = self.records.chunks_exact(RECORD_HEAD + self.channels);
        records.filter(|record| raster::read_record(record, 1.0).is_some()).count()
    }

    /// Number of (Gaussian, tile) pairs.
    pub fn entries(&self) -> usize {
        self.tiles.entries.len()
    }

    /// The vectors of pixels that each entry visits.
    pub(crate) fn visited(&self) -> &[Blocks] {
        match self.visited.get() {
            Some(visited) => visited,
            None => {
                composite(self);
                self.visited.get().map_or(&[], Vec::as_slice)
            }
        }
    }

    /// The entries of tile `index`.
    pub(crate) fn entries_of(&self, index: usize) -> Range<usize> {
        self.tiles.offsets[index] as usize..self.tiles.offsets[index + 1] as usize
    }

    /// The job of tile `index`.
    pub(crate) fn job(&self, index: usize) -> TileJob<'_> {
        let origin = [index % self.tiles.columns * TILE_WIDTH, index / self.tiles.columns * TILE_HEIGHT];
        TileJob {
            records: &self.records,
            entries: &self.tiles.entries[self.entries_of(index)],
            origin,
            size: [TILE_WIDTH.min(self.camera.width - origin[0]), TILE_HEIGHT.min(self.camera.height - origin[1])],
        }
    }
}

/// Blends a prepared scene.
pub fn composite(prepared: &Prepared) -> Frame {
    with_channels!(prepared.channels, composite_channels::<C>(prepared))
}

fn composite_channels<const C: usize>(prepared: &Prepared) -> Frame {
    let (width, height) = (prepared.camera.width, prepared.camera.height);
    let pixels = width * height;
    let depths = usize::from(prepared.options.depth);
    let room = |planes: usize| Vec::<f32>::with_capacity(planes * pixels);
    let (mut planes, mut depth, mut transmittance) = (room(prepared.features), room(depths), room(1));
    let (feature_planes, depth_plane) = (planes.as_mut_ptr(), depth.as_mut_ptr());
    let out = PlanePointers::<C> {
        planes: std::array::from_fn(|k| match k {
            k if k < prepared.features => feature_planes.wrapping_add(k * pixels),
            k if k == prepared.features && depths == 1 => depth_plane,
            _ => std::ptr::null_mut(),
        }),
        transmittance: transmittance.as_mut_ptr(),
        width,
    };
    let mut visited: Vec<Blocks> = zeros(prepared.entries());
    let (mut rest, mut tiles) = (&mut visited[..], Vec::with_capacity(prepared.tiles.columns * prepared.tiles.rows));
    for index in 0..prepared.tiles.columns * prepared.tiles.rows {
        let (own, others) = std::mem::take(&mut rest).split_at_mut(prepared.entries_of(index).len());
        tiles.push(own);
        rest = others;
    }
    tiles.into_par_iter().enumerate().for_each(|(index, visited)| {
        let job = prepared.job(index);
        match job.entries.is_empty() {
            // SAFETY: the planes have room for the picture, and tiles do not overlap.
            true => unsafe { out.clear(job.origin, job.size) },
            false => raster::forward::<C>(&job, visited, &out),
        }
    });
    // A second time would have found the same.
    let _ = prepared.visited.set(visited);
    // SAFETY: the tiles cover the picture, and each wrote all its pixels in every plane.
    unsafe {
        planes.set_len(prepared.features * pixels);
        depth.set_len(depths * pixels);
        transmittance.set_len(pixels);
    }
    Frame { width, height, channels: prepared.features, planes, depth, transmittance }
}

/// Projects, sorts, bins and blends: what [`crate::backward`] needs, and the picture.
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
