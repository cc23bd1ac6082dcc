//! A scene's gradients from a frame's: the backward kernels, and each Gaussian's slots added up and carried back
//! through the projection.
//!
//! What always holds: the same inputs give the same bits at any number of threads (each entry of a tile has a slot of its
//! own, a Gaussian's slots lie together in the order of its tiles and are added in that order, and nothing is added
//! atomically). A Gaussian that is not drawn gets zero gradients.

use crate::error::{SplatError, expect_length};
use crate::gaussians::{Gaussians, MAX_CHANNELS, SceneGradients};
use crate::lanes::MAX_LANES;
use crate::project::{GeometryGradient, Splat, SplatGradient, View, project_backward};
use crate::raster::{self, PlaneGradients, RECORD_HEAD, SLOT_HEAD, Slots};
use crate::render::{CHUNK, Frame, FrameGradient, Prepared, with_channels};
use crate::scratch::{Scratch, zeros};
use rayon::prelude::*;

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
    let stride = SLOT_HEAD + prepared.channels;
    let mut slots = Scratch::take(prepared.tiles.entries.len() * stride);
    with_channels!(prepared.channels, fill_slots::<C>(prepared, frame, &gradient, &mut slots));
    Ok(gather(gaussians, prepared, &slots))
}

/// Every entry's gradients, in its slot.
fn fill_slots<const C: usize>(prepared: &Prepared, frame: &Frame, gradient: &FrameGradient, slots: &mut [f32]) {
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
    let (visited, slots) = (prepared.visited(), Slots(slots.as_mut_ptr()));
    (0..prepared.tiles.columns * prepared.tiles.rows).into_par_iter().for_each(|index| {
        let job = prepared.job(index);
        if !job.entries.is_empty() {
            raster::backward::<C>(&job, &visited[prepared.entries_of(index)], &picture, slots);
        }
    });
}

/// Adds up each splat's slots in the order of the tiles, and carries the sums back through the projection.
fn gather(gaussians: &Gaussians, prepared: &Prepared, slots: &[f32]) -> SceneGradients {
    let (n, channels) = (gaussians.len(), gaussians.channels);
    let view = View::new(&prepared.camera, &prepared.options);
    let mut out = SceneGradients {
        means: zeros(n),
        scales: zeros(n),
        rotations: zeros(n),
        opacities: zeros(n),
        features: zeros(n * channels),
        means_px: zeros(n),
        weights: zeros(n),
        radii_px: zeros(n),
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
                if let Some(splat) = prepared.splat(i, gaussians.opacities[i]) {
                    let [x, y] = splat.extent();
                    radii[k] = x.max(y);
                    let sum = prepared.slot_sum(i, slots);
                    // What no pixel saw keeps its zeros.
                    if sum.iter().any(|v| *v != 0.0) {
                        let on_depth = if prepared.options.depth { sum[SLOT_HEAD + channels] } else { 0.0 };
                        let on_splat = from_moments(&splat, &sum, on_depth);
                        opacities[k] = if gaussians.opacities[i] <= 1.0 { sum[0] / splat.opacity } else { 0.0 };
                        features[k * channels..][..channels].copy_from_slice(&sum[SLOT_HEAD..][..channels]);
                        means_px[k] = on_splat.mean;
                        weights[k] = sum[6];
                        batch.push(i as u32, splat, on_splat);
                    }
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
    /// A drawn Gaussian as projected.
    fn splat(&self, i: usize, opacity: f32) -> Option<Splat> {
        raster::read_record(&self.records[i * (RECORD_HEAD + self.channels)..], opacity)
    }

    /// The sum of a Gaussian's slots, in the order of its tiles.
    fn slot_sum(&self, i: usize, slots: &[f32]) -> [f32; SLOT_HEAD + MAX_CHANNELS] {
        let stride = SLOT_HEAD + self.channels;
        let range = self.tiles.slot_offsets[i] as usize * stride..self.tiles.slot_offsets[i + 1] as usize * stride;
        let mut sum = [0.0f32; SLOT_HEAD + MAX_CHANNELS];
        for slot in slots[range].chunks_exact(stride) {
            for (s, v) in sum.iter_mut().zip(slot) {
                *s += v;
            }
        }
        sum
    }
}

/// Splats on their way back through the projection, as many as fit a block of lanes.
#[derive(Default)]
struct Batch {
    count: usize,
    indices: [u32; MAX_LANES],
    splats: [(Splat, SplatGradient); MAX_LANES],
}

impl Batch {
    fn push(&mut self, index: u32, splat: Splat, gradient: SplatGradient) {
        self.indices[self.count] = index;
        self.splats[self.count] = (splat, gradient);
        self.count += 1;
    }

    fn is_full(&self) -> bool {
        self.count == MAX_LANES
    }

    fn flush(&mut self, view: &View, gaussians: &Gaussians, mut give: impl FnMut(u32, &GeometryGradient)) {
        let mut out = [GeometryGradient::default(); MAX_LANES];
        let indices = &self.indices[..self.count];
        project_backward(view, gaussians, indices, &self.splats[..self.count], &mut out);
        indices.iter().zip(&out).for_each(|(&i, g)| give(i, g));
        self.count = 0;
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
