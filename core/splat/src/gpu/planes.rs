//! Pictures and gradients between the host's planes and the device's groups of four.

use rayon::prelude::*;

use super::params::GROUP;
use super::raster::GpuRasteriser;
use crate::gaussians::SceneGradients;
use crate::render::{Frame, FrameGradient};

impl GpuRasteriser {
    /// The picture in planes from its groups of four.
    pub(super) fn frame(&self, words: &[u32], depth: bool) -> Frame {
        let shape = &self.shape;
        let pixels = shape.pixels();
        let values: &[[f32; GROUP]] = bytemuck::cast_slice(words);
        let plane = |channel: usize, out: &mut [f32]| {
            let group = &values[channel / GROUP * pixels..][..pixels];
            out.iter_mut().zip(group).for_each(|(out, value)| *out = value[channel % GROUP]);
        };
        let mut frame = Frame {
            width: shape.width,
            height: shape.height,
            channels: shape.features,
            planes: vec![0.0; shape.features * pixels],
            depth: vec![0.0; usize::from(depth) * pixels],
            transmittance: vec![0.0; pixels],
        };
        frame.planes.par_chunks_mut(pixels).enumerate().for_each(|(channel, out)| plane(channel, out));
        plane(shape.features, &mut frame.depth);
        plane(shape.features + usize::from(depth), &mut frame.transmittance);
        frame
    }

    /// The gradient in groups of four from its planes.
    pub(super) fn grouped(&self, gradient: &FrameGradient, depth: bool) -> Vec<[f32; GROUP]> {
        let (shape, pixels) = (&self.shape, self.shape.pixels());
        let plane = |channel: usize| match channel {
            c if c < shape.features => &gradient.planes[c * pixels..][..pixels],
            c if depth && c == shape.features => gradient.depth,
            c if c == shape.features + usize::from(depth) => gradient.transmittance,
            _ => &[],
        };
        let mut out = vec![[0.0; GROUP]; shape.groups * pixels];
        out.par_chunks_mut(pixels).enumerate().for_each(|(group, out)| {
            for lane in 0..GROUP {
                let values = plane(group * GROUP + lane);
                out.iter_mut().zip(values).for_each(|(out, value)| out[lane] = *value);
            }
        });
        out
    }

    /// The scene's gradients from what the device wrote.
    pub(super) fn gradients(&self, geometry: &[u32], features: &[u32]) -> SceneGradients {
        let (shape, n) = (&self.shape, self.shape.count);
        let rows: &[[f32; 4 * GROUP]] = bytemuck::cast_slice(geometry);
        let values: &[f32] = bytemuck::cast_slice(features);
        let mut out = SceneGradients {
            means: rows.iter().map(|r| [r[0], r[1], r[2]]).collect(),
            scales: rows.iter().map(|r| [r[4], r[5], r[6]]).collect(),
            rotations: rows.iter().map(|r| [r[8], r[9], r[10], r[11]]).collect(),
            opacities: rows.iter().map(|r| r[3]).collect(),
            features: Vec::with_capacity(n * shape.features),
            means_px: rows.iter().map(|r| [r[12], r[13]]).collect(),
            weights: rows.iter().map(|r| r[7]).collect(),
            radii_px: rows.iter().map(|r| r[14]).collect(),
        };
        for row in values.chunks_exact((GROUP * shape.groups).max(1)) {
            out.features.extend_from_slice(&row[..shape.features]);
        }
        out
    }
}
