//! PhysNet (Yu, Li, Zhao 2019): three-dimensional convolutions down to 4 × 4, transposed convolutions back up in time.

use heartian_ops::activation::elu;
use heartian_ops::{Convolution, Volume};

use super::{Trace, chunk_volume};
use crate::layer::{Layer, Pool, max_pool, plane_means, relu};
use crate::parts::{Affine, Parts};
use crate::{Architecture, Batch, DecoderError, InputForm, Options};

/// Channels of the inner layers.
const WIDTH: usize = 64;
/// Name, inputs, outputs, kernel, padding of the convolutions in order.
const BLOCKS: [(usize, usize, [usize; 3], [usize; 2]); 9] = [
    (3, 16, [1, 5, 5], [0, 2]),
    (16, 32, [3; 3], [1, 1]),
    (32, WIDTH, [3; 3], [1, 1]),
    (WIDTH, WIDTH, [3; 3], [1, 1]),
    (WIDTH, WIDTH, [3; 3], [1, 1]),
    (WIDTH, WIDTH, [3; 3], [1, 1]),
    (WIDTH, WIDTH, [3; 3], [1, 1]),
    (WIDTH, WIDTH, [3; 3], [1, 1]),
    (WIDTH, WIDTH, [3; 3], [1, 1]),
];

/// The network, batch norms folded.
#[derive(Debug)]
pub struct PhysNet {
    blocks: Vec<Convolution>,
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
        let mut blocks = Vec::new();
        for (index, (inputs, outputs, kernel, _)) in BLOCKS.into_iter().enumerate() {
            let name = format!("ConvBlock{}", index + 1);
            let [kt, ky, kx] = kernel;
            let affine = parts.affine(&format!("{name}.0"), &[outputs, inputs, kt, ky, kx], true)?;
            let norm = parts.norm(&format!("{name}.1"), outputs)?;
            blocks.push(affine.normed(&norm).convolution(inputs, kernel)?);
        }
        let doublings =
            ["upsample", "upsample2"].into_iter().map(|name| doubling(&parts, name)).collect::<Result<_, _>>()?;
        let last = parts.affine("ConvBlock10", &[1, WIDTH, 1, 1, 1], true)?;
        parts.finish(|_| false)?;
        Ok((Self { blocks, doublings, last_weights: last.weights, last_bias: last.bias[0] }, input))
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
        let block = |index: usize, input: &Volume, pool| {
            let (_, _, _, padding) = BLOCKS[index];
            Layer { convolution: &self.blocks[index], padding, activation: relu, pool, margin: 1 }.run(input)
        };
        let x = block(0, &frames, Pool::Max)?;
        drop(frames);
        let x = block(1, &x, Pool::Keep)?;
        let x = max_pool(&block(2, &x, Pool::Max)?, 2, 1, 1);
        let x = block(3, &x, Pool::Keep)?;
        let x = max_pool(&block(4, &x, Pool::Max)?, 2, 1, 1);
        let x = block(5, &x, Pool::Keep)?;
        let x = block(6, &x, Pool::Keep)?;
        trace.note(|| "tap_x1616".to_owned(), || x.to_dense());
        let x = block(7, &max_pool(&x, 1, 2, 1), Pool::Keep)?;
        let mut x = block(8, &x, Pool::Keep)?;
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
fn doubling(parts: &Parts<'_>, name: &str) -> Result<[Convolution; 2], DecoderError> {
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

fn doubled(pair: &[Convolution; 2], input: &Volume) -> Result<Volume, DecoderError> {
    let frames = input.extent().frames;
    let layer = |convolution| Layer { convolution, padding: [0, 0], activation: elu, pool: Pool::Keep, margin: 0 };
    let even = layer(&pair[0]).run_from(input, frames, |t, k| (t + k).checked_sub(1))?;
    let odd = layer(&pair[1]).run_from(input, frames, |t, k| Some(t + k))?;
    Ok(Volume::interleaved(&even, &odd))
}
