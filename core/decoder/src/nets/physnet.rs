//! PhysNet (Yu, Li, Zhao 2019): three-dimensional convolutions down to 4 × 4, transposed convolutions back up in time.

use heartian_ops::activation::elu;
use heartian_ops::{Convolution, PairedConvolution, Volume};

use super::{Trace, chunk_volume};
use crate::layer::{Kernel, Layer, Pool, max_pool, plane_means, relu, run_from};
use crate::parts::{Affine, Parts};
use crate::{Architecture, Batch, DecoderError, InputForm, Options};

/// Channels of the inner layers.
const WIDTH: usize = 64;
/// Inputs and outputs of the convolutions of 3 × 3 × 3, in order.
const BLOCKS: [(usize, usize); 8] = [
    (16, 32),
    (32, WIDTH),
    (WIDTH, WIDTH),
    (WIDTH, WIDTH),
    (WIDTH, WIDTH),
    (WIDTH, WIDTH),
    (WIDTH, WIDTH),
    (WIDTH, WIDTH),
];

/// The network, batch norms folded.
#[derive(Debug)]
pub struct PhysNet {
    first: Convolution,
    blocks: Vec<PairedConvolution>,
    /// Two times: the even and the odd frames of a doubling.
    doublings: Vec<[Convolution; 2]>,
    last_weights: Vec<f32>,
    last_bias: f32,
}

impl PhysNet {
    /// Takes the weights apart.
    pub fn new(parts: Parts<'_>, options: &Options) -> Result<(Self, InputForm), DecoderError> {
        let mut input = Architecture::PhysNet.usual_input();
        input.side_px = options.side_px.unwrap_or(input.side_px);
        if !(16..=1024).contains(&input.side_px) {
            return Err(DecoderError::Option {
                option: "side_px",
                value: input.side_px.to_string(),
                reason: "PhysNet halves a frame four times and takes 16 to 1024 pixels".to_owned(),
            });
        }
        let first = parts.affine("ConvBlock1.0", &[16, 3, 1, 5, 5], true)?.normed(&parts.norm("ConvBlock1.1", 16)?);
        let first = first.convolution(3, [1, 5, 5])?;
        let mut blocks = Vec::new();
        for (index, (inputs, outputs)) in BLOCKS.into_iter().enumerate() {
            let name = format!("ConvBlock{}", index + 2);
            let affine = parts.affine(&format!("{name}.0"), &[outputs, inputs, 3, 3, 3], true)?;
            blocks.push(affine.normed(&parts.norm(&format!("{name}.1"), outputs)?).paired(inputs)?);
        }
        let doublings =
            ["upsample", "upsample2"].into_iter().map(|name| doubling(&parts, name)).collect::<Result<_, _>>()?;
        let last = parts.affine("ConvBlock10", &[1, WIDTH, 1, 1, 1], true)?;
        parts.finish(|_| false)?;
        Ok((Self { first, blocks, doublings, last_weights: last.weights, last_bias: last.bias[0] }, input))
    }

    /// All chunks of a checked batch.
    pub fn run(&self, batch: &Batch<'_>, form: &InputForm, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        let mut out = Vec::with_capacity(batch.chunks * batch.frames);
        for chunk in 0..batch.chunks {
            let mut quiet = Trace::default();
            let trace = if chunk == 0 { &mut *trace } else { &mut quiet };
            out.extend(self.chunk(chunk_volume(batch, form, chunk, 2)?, trace)?);
        }
        Ok(out)
    }

    fn chunk(&self, frames: Volume, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        let layer = |kernel: Kernel<'_>, padding, input: &Volume, pool| {
            Layer { kernel, padding, activation: relu, pool, margin: 1 }.run(input)
        };
        let block = |index: usize, input: &Volume, pool| layer((&self.blocks[index]).into(), [1, 1], input, pool);
        let x = layer((&self.first).into(), [0, 2], &frames, Pool::Max)?;
        drop(frames);
        let x = block(0, &x, Pool::Keep)?;
        let x = max_pool(&block(1, &x, Pool::Max)?, 2, 1, 1);
        let x = block(2, &x, Pool::Keep)?;
        let x = max_pool(&block(3, &x, Pool::Max)?, 2, 1, 1);
        let x = block(4, &x, Pool::Keep)?;
        let x = block(5, &x, Pool::Keep)?;
        trace.note(|| "tap_x1616".to_owned(), || x.to_dense());
        let x = block(6, &max_pool(&x, 1, 2, 1), Pool::Keep)?;
        let mut x = block(7, &x, Pool::Keep)?;
        for pair in &self.doublings {
            x = doubled(pair, &x)?;
        }
        let means = plane_means(&x);
        Ok(means.chunks_exact(WIDTH).map(|pixel| dot(pixel, &self.last_weights) + self.last_bias).collect())
    }
}

fn dot(left: &[f32], right: &[f32]) -> f32 {
    left.iter().zip(right).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>() as f32
}

/// A transposed convolution of four taps, step 2, one frame cut at each end: frame 2m takes taps 3 and 1 of frames m − 1 and
/// m, frame 2m + 1 taps 2 and 0 of frames m and m + 1.
pub fn doubling(parts: &Parts<'_>, name: &str) -> Result<[Convolution; 2], DecoderError> {
    let weights = parts.tensor(&format!("{name}.0.weight"), &[WIDTH, WIDTH, 4, 1, 1])?;
    let bias = parts.tensor(&format!("{name}.0.bias"), &[WIDTH])?;
    let norm = parts.norm(&format!("{name}.1"), WIDTH)?;
    let phase = |taps: [usize; 2]| {
        let mut phase = Affine { weights: Vec::with_capacity(WIDTH * WIDTH * 2), bias: bias.to_vec() };
        for out in 0..WIDTH {
            for input in 0..WIDTH {
                phase.weights.extend(taps.map(|tap| weights[(input * WIDTH + out) * 4 + tap]));
            }
        }
        phase.normed(&norm).convolution(WIDTH, [2, 1, 1])
    };
    Ok([phase([3, 1])?, phase([2, 0])?])
}

/// Twice the frames.
pub fn doubled(pair: &[Convolution; 2], input: &Volume) -> Result<Volume, DecoderError> {
    let frames = input.extent().frames;
    let phase = |convolution: &Convolution, delay: usize| {
        let kernel = convolution.into();
        let layer = Layer { kernel, padding: [0, 0], activation: elu, pool: Pool::Keep, margin: 0 };
        run_from(&layer, convolution, input, frames, |t, k| (t + k).checked_sub(delay))
    };
    let (even, odd) = (phase(&pair[0], 1)?, phase(&pair[1], 0)?);
    Ok(Volume::interleaved(&even, &odd))
}
