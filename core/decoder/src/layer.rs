//! Layers over stacks of planes: a convolution of every frame with what follows it while it is warm.

use heartian_ops::{Convolution, Extent, FrameMut, PairScratch, PairedConvolution, Scratch, Strip, Volume, Windows};
use rayon::prelude::*;

use crate::DecoderError;

/// What a layer does to its planes at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pool {
    /// Nothing.
    Keep,
    /// Largest of 2 × 2; an odd last row or column is dropped.
    Max,
}

/// The weights of a layer.
#[derive(Clone, Copy)]
pub enum Kernel<'a> {
    /// Frame by frame.
    Single(&'a Convolution),
    /// Three frames deep, two output frames at a time.
    Paired(&'a PairedConvolution),
}

impl<'a> From<&'a Convolution> for Kernel<'a> {
    fn from(convolution: &'a Convolution) -> Self {
        Self::Single(convolution)
    }
}

impl<'a> From<&'a PairedConvolution> for Kernel<'a> {
    fn from(convolution: &'a PairedConvolution) -> Self {
        Self::Paired(convolution)
    }
}

/// How a layer runs.
pub struct Layer<'a> {
    /// The weights.
    pub kernel: Kernel<'a>,
    /// Zeros before and after: frames, then rows and columns.
    pub padding: [usize; 2],
    /// Applied in place to what comes out.
    pub activation: fn(&mut [f32]),
    /// Pooling after it.
    pub pool: Pool,
    /// Margin that the next layer needs.
    pub margin: usize,
}

/// ReLU.
pub fn relu(values: &mut [f32]) {
    heartian_ops::activation::clamp(values, 0.0, f32::INFINITY);
}

/// No activation.
pub fn identity(_: &mut [f32]) {}

impl Layer<'_> {
    /// Every frame of the input, windows centred by the padding.
    pub fn run(&self, input: &Volume) -> Result<Volume, DecoderError> {
        let [before, pad] = self.padding;
        let frames = |depth| (input.extent().frames + 2 * before + 1).saturating_sub(depth);
        match self.kernel {
            Kernel::Single(convolution) => {
                let frames = frames(convolution.kernel()[0]);
                run_from(self, convolution, input, frames, |t, k| (t + k).checked_sub(before))
            }
            Kernel::Paired(convolution) => {
                let output = self.output(input, convolution.kernel());
                let mut out = self.empty(frames(3), convolution.outputs(), output);
                let pairs = out.par_frames_mut().chunks(2).enumerate();
                pairs.try_for_each_init(PairScratch::default, |scratch, (pair, mut frames)| {
                    let first = (2 * pair) as isize - before as isize;
                    convolution.pair(input, first, [[pad; 2], output], scratch, |which, strip| {
                        if let Some(frame) = frames.get_mut(which) {
                            self.finish(strip, convolution.outputs(), frame);
                        }
                    })
                })?;
                Ok(out)
            }
        }
    }

    fn output(&self, input: &Volume, [ky, kx]: [usize; 2]) -> [usize; 2] {
        let (extent, pad) = (input.extent(), self.padding[1]);
        [(extent.height + 2 * pad + 1).saturating_sub(ky), (extent.width + 2 * pad + 1).saturating_sub(kx)]
    }

    fn empty(&self, frames: usize, channels: usize, output: [usize; 2]) -> Volume {
        let [height, width] = if self.pool == Pool::Max { output.map(|side| side / 2) } else { output };
        Volume::zeros(Extent { frames, channels, height, width }, self.margin)
    }

    /// Activation and pooling of a strip, into its frame.
    fn finish(&self, strip: &mut Strip<'_>, channels: usize, frame: &mut FrameMut<'_>) {
        strip.each(self.activation);
        for c in 0..channels {
            match self.pool {
                Pool::Keep => {
                    for r in 0..strip.rows {
                        frame.row_mut(c, strip.first_row + r).copy_from_slice(strip.row(c, r));
                    }
                }
                Pool::Max => {
                    for r in 0..strip.rows / 2 {
                        max_rows(strip, c, 2 * r, frame.row_mut(c, strip.first_row / 2 + r));
                    }
                }
            }
        }
    }
}

/// `frames` output frames of a layer with these weights, the one of frame `t` at temporal tap `k` being `source(t, k)`.
pub fn run_from(
    layer: &Layer<'_>,
    convolution: &Convolution,
    input: &Volume,
    frames: usize,
    source: impl Fn(usize, usize) -> Option<usize> + Sync,
) -> Result<Volume, DecoderError> {
    let [_, ky, kx] = convolution.kernel();
    let output = layer.output(input, [ky, kx]);
    let mut out = layer.empty(frames, convolution.outputs(), output);
    out.par_frames_mut().enumerate().try_for_each_init(Scratch::default, |scratch, (t, mut frame)| {
        let windows = Windows { before: [layer.padding[1]; 2], output, source: |_, k| source(t, k) };
        convolution.frame(input, &windows, scratch, |strip| layer.finish(strip, convolution.outputs(), &mut frame))
    })?;
    Ok(out)
}

fn max_rows(strip: &mut Strip<'_>, channel: usize, row: usize, out: &mut [f32]) {
    let (upper, lower) = strip.two_rows(channel, row);
    let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
    for (out, (a, b)) in out.iter_mut().zip(pairs) {
        *out = a[0].max(a[1]).max(b[0].max(b[1]));
    }
}

/// Largest of `time × 2 × 2` (or `time × 1 × 1`) neighbours; what does not fill a window is dropped.
pub fn max_pool(input: &Volume, time: usize, side: usize, margin: usize) -> Volume {
    let from = input.extent();
    let extent = Extent {
        frames: from.frames / time,
        channels: from.channels,
        height: from.height / side,
        width: from.width / side,
    };
    let mut out = Volume::zeros(extent, margin);
    out.par_frames_mut().enumerate().for_each(|(t, mut frame)| {
        for c in 0..extent.channels {
            for y in 0..extent.height {
                let out = frame.row_mut(c, y);
                out.fill(f32::NEG_INFINITY);
                for tap in 0..time * side {
                    let row = input.row(t * time + tap / side, c, y * side + tap % side);
                    for (out, values) in out.iter_mut().zip(row.chunks_exact(side)) {
                        *out = values.iter().fold(*out, |most, v| most.max(*v));
                    }
                }
            }
        }
    });
    out
}

/// Mean over each plane, `frames × channels`.
pub fn plane_means(input: &Volume) -> Vec<f32> {
    let Extent { frames, channels, height, width } = input.extent();
    let mut means = Vec::with_capacity(frames * channels);
    for t in 0..frames {
        for c in 0..channels {
            let sum: f64 = (0..height).map(|y| input.row(t, c, y).iter().map(|v| f64::from(*v)).sum::<f64>()).sum();
            means.push((sum / (height * width).max(1) as f64) as f32);
        }
    }
    means
}
