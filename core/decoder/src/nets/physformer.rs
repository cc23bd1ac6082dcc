//! PhysFormer (Yu, Shen, Shi, Zhao, Torr, Zhao 2022): convolutional stems, tokens of 4 × 4 × 4, transformers whose queries
//! and keys are temporal-difference convolutions, and a head that doubles time twice.

use heartian_ops::activation::elu;
use heartian_ops::{Convolution, Extent, Filter, PairedConvolution, Volume, linear};
use rayon::prelude::*;

use super::{Trace, chunk_volume};
use crate::attention::{Attention, Tokens};
use crate::layer::{Kernel, Layer, Pool, identity, plane_means, relu, run_from};
use crate::norm::layer_norm;
use crate::parts::{Affine, Parts};
use crate::{Architecture, Batch, DecoderError, InputForm, Options};

/// Frames, rows and columns of a token.
const PATCH: usize = 4;
/// Rows and columns of tokens: the input is 128 pixels wide.
const GRID: usize = 4;
/// Tokens run through a dense layer together.
const ROWS: usize = 80;

#[derive(Debug)]
struct Block {
    norms: [(Vec<f32>, Vec<f32>); 2],
    attention: Attention,
    widen: Affine,
    /// Depth-wise: `27 × channels`, and a bias.
    depthwise: Affine,
    narrow: Affine,
}

/// The network, batch norms and temporal differences folded.
#[derive(Debug)]
pub struct PhysFormer {
    first: Convolution,
    stems: [PairedConvolution; 2],
    patch: Affine,
    transformers: Vec<Vec<Block>>,
    doublings: [Convolution; 2],
    last: Affine,
}

impl PhysFormer {
    /// Takes the weights apart; widths and depths follow from their shapes.
    pub fn new(parts: Parts<'_>, options: &Options) -> Result<(Self, InputForm), DecoderError> {
        let width = *parts.shape("Stem2.0.bias")?.first().unwrap_or(&0);
        check_options(options, width)?;
        let stem = |index: usize, inputs: usize, outputs: usize, [kt, k]: [usize; 2]| -> Result<Affine, DecoderError> {
            let affine = parts.affine(&format!("Stem{index}.0"), &[outputs, inputs, kt, k, k], true)?;
            Ok(affine.normed(&parts.norm(&format!("Stem{index}.1"), outputs)?))
        };
        let first = stem(0, 3, width / 4, [1, 5])?.convolution(3, [1, 5, 5])?;
        let second = stem(1, width / 4, width / 2, [3, 3])?.paired(width / 4)?;
        let stems = [second, stem(2, width / 2, width, [3, 3])?.paired(width / 2)?];
        let patch = parts.affine("patch_embedding", &[width, width, PATCH, PATCH, PATCH], true)?;
        let mut transformers = Vec::new();
        for index in 1..=3 {
            let mut blocks = Vec::new();
            while blocks.is_empty() || parts.has(&format!("transformer{index}.blocks.{}.norm1.weight", blocks.len())) {
                let name = format!("transformer{index}.blocks.{}", blocks.len());
                blocks.push(Block::new(&parts, &name, width, options)?);
            }
            transformers.push(blocks);
        }
        let doubling = |name: &str, outputs: usize| {
            let affine = parts.affine(&format!("{name}.1"), &[outputs, width, 3, 1, 1], true)?;
            affine.normed(&parts.norm(&format!("{name}.2"), outputs)?).convolution(width, [3, 1, 1])
        };
        let doublings = [doubling("upsample", width)?, doubling("upsample2", width / 2)?];
        let last = parts.affine("ConvBlockLast", &[1, width / 2, 1], true)?;
        parts.finish(|_| false)?;
        Ok((Self { first, stems, patch, transformers, doublings, last }, Architecture::PhysFormer.usual_input()))
    }

    /// All chunks of a checked batch.
    pub fn run(&self, batch: &Batch<'_>, form: &InputForm, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        let mut out = Vec::with_capacity(batch.chunks * batch.frames);
        for chunk in 0..batch.chunks {
            out.extend(self.chunk(chunk_volume(batch, form, chunk, 2)?, trace)?);
        }
        Ok(out)
    }

    fn chunk(&self, mut x: Volume, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        let stem = |kernel: Kernel<'_>, padding, x: &Volume| {
            Layer { kernel, padding, activation: relu, pool: Pool::Max, margin: 1 }.run(x)
        };
        x = stem((&self.first).into(), [0, 2], &x)?;
        for convolution in &self.stems {
            x = stem(convolution.into(), [1, 1], &x)?;
        }
        let mut tokens = self.tokens(&x)?;
        for (index, blocks) in self.transformers.iter().enumerate() {
            for (depth, block) in blocks.iter().enumerate() {
                let last = depth + 1 == blocks.len();
                block.run(&mut tokens, last.then_some(index + 1), trace)?;
            }
        }
        let mut x = tokens.to_volume(0)?;
        for convolution in &self.doublings {
            let doubled = 2 * x.extent().frames;
            let kernel = convolution.into();
            let layer = Layer { kernel, padding: [1, 0], activation: elu, pool: Pool::Keep, margin: 0 };
            // Every frame is seen twice; beyond the ends is zero.
            let source = |t: usize, k: usize| (t + k).checked_sub(1).filter(|s| *s < doubled).map(|s| s / 2);
            x = run_from(&layer, convolution, &x, doubled, source)?;
        }
        let means = plane_means(&x);
        let mut out = vec![0.0; x.extent().frames];
        let shape = [out.len(), 1, x.extent().channels];
        linear(&means, Filter { weights: &self.last.weights, bias: &self.last.bias }, &mut out, shape)?;
        Ok(out)
    }

    /// Cuts the features into blocks of 4 × 4 × 4 and brings each to a token.
    fn tokens(&self, x: &Volume) -> Result<Tokens, DecoderError> {
        let channels = x.extent().channels;
        let (frames, depth, width) = (x.extent().frames / PATCH, channels * PATCH.pow(3), self.patch.bias.len());
        let mut values = vec![0.0; frames * GRID * GRID * width];
        values.par_chunks_mut(GRID * GRID * width).enumerate().try_for_each_init(
            Vec::new,
            |patches, (frame, out)| {
                patches.clear();
                for (row, column) in (0..GRID * GRID).map(|token| (token / GRID, token % GRID)) {
                    for c in 0..channels {
                        for (t, y) in (0..PATCH * PATCH).map(|tap| (tap / PATCH, tap % PATCH)) {
                            let from = x.row(frame * PATCH + t, c, row * PATCH + y);
                            patches.extend_from_slice(&from[column * PATCH..(column + 1) * PATCH]);
                        }
                    }
                }
                let filter = Filter { weights: &self.patch.weights, bias: &self.patch.bias };
                linear(patches, filter, out, [GRID * GRID, width, depth])
            },
        )?;
        Ok(Tokens { extent: Extent { frames, channels: width, height: GRID, width: GRID }, values })
    }
}

fn check_options(options: &Options, width: usize) -> Result<(), DecoderError> {
    if width < 4 || !width.is_multiple_of(4) || options.heads == 0 || !width.is_multiple_of(options.heads) {
        return Err(DecoderError::Option {
            option: "heads",
            value: options.heads.to_string(),
            reason: format!("the {width} channels of these weights must divide evenly among the heads (and by 4)"),
        });
    }
    if !options.theta.is_finite() {
        let reason = "the share of the temporal difference is a finite number (0.7 in rPPG-Toolbox)".to_owned();
        return Err(DecoderError::Option { option: "theta", value: options.theta.to_string(), reason });
    }
    if !(options.sharpness > 0.0 && options.sharpness.is_finite()) {
        let reason = "scores are divided by a positive number (2 in rPPG-Toolbox)".to_owned();
        return Err(DecoderError::Option { option: "sharpness", value: options.sharpness.to_string(), reason });
    }
    Ok(())
}

impl Block {
    fn new(parts: &Parts<'_>, name: &str, width: usize, options: &Options) -> Result<Self, DecoderError> {
        let norm = |place: usize| -> Result<_, DecoderError> {
            let part = |suffix: &str| parts.tensor(&format!("{name}.norm{place}.{suffix}"), &[width]);
            Ok((part("weight")?.to_vec(), part("bias")?.to_vec()))
        };
        let attention = Attention::new(parts, name, width, options)?;
        let first = format!("{name}.pwff.fc1.0.weight");
        let inner = *parts.shape(&first)?.first().unwrap_or(&0);
        let layer = |layer: &str, shape: [usize; 2], kernel: usize| -> Result<Affine, DecoderError> {
            let affine = parts.affine(
                &format!("{name}.pwff.{layer}.0"),
                &[shape[0], shape[1], kernel, kernel, kernel],
                false,
            )?;
            Ok(affine.normed(&parts.norm(&format!("{name}.pwff.{layer}.1"), shape[0])?))
        };
        let by_channel = layer("STConv", [inner, 1], 3)?;
        let by_tap = (0..27 * inner).map(|i| by_channel.weights[i % inner * 27 + i / inner]).collect();
        Ok(Self {
            norms: [norm(1)?, norm(2)?],
            attention,
            widen: layer("fc1", [inner, width], 1)?,
            depthwise: Affine { weights: by_tap, bias: by_channel.bias },
            narrow: layer("fc2", [width, inner], 1)?,
        })
    }

    /// `last_of` names the transformer if this block is its last.
    fn run(&self, tokens: &mut Tokens, last_of: Option<usize>, trace: &mut Trace) -> Result<(), DecoderError> {
        let [(gain1, offset1), (gain2, offset2)] = &self.norms;
        let normed = Tokens { extent: tokens.extent, values: layer_norm(&tokens.values, gain1, offset1) };
        let change = self.attention.run(&normed, last_of, trace)?;
        add(&mut tokens.values, &change);
        let normed = layer_norm(&tokens.values, gain2, offset2);
        let mut wide = dense(&normed, &self.widen)?;
        elu(&mut wide);
        let mut mixed = self.mix(&wide, tokens.extent);
        elu(&mut mixed);
        add(&mut tokens.values, &dense(&mixed, &self.narrow)?);
        Ok(())
    }

    /// The depth-wise 3 × 3 × 3 convolution of tokens.
    fn mix(&self, values: &[f32], extent: Extent) -> Vec<f32> {
        let inner = self.depthwise.bias.len();
        let frame_len = GRID * GRID * inner;
        let mut out = vec![0.0; values.len()];
        out.par_chunks_mut(frame_len).enumerate().for_each(|(t, frame)| {
            for (place, pixel) in frame.chunks_exact_mut(inner).enumerate() {
                pixel.copy_from_slice(&self.depthwise.bias);
                for tap in 0..27 {
                    let at = [t, place / GRID, place % GRID];
                    let shift = [tap / 9, tap / 3 % 3, tap % 3];
                    let [ft, fy, fx] = std::array::from_fn(|axis| (at[axis] + shift[axis]).wrapping_sub(1));
                    if ft < extent.frames && fy < GRID && fx < GRID {
                        let from = &values[(ft * GRID * GRID + fy * GRID + fx) * inner..][..inner];
                        let weights = &self.depthwise.weights[tap * inner..(tap + 1) * inner];
                        for c in 0..inner {
                            pixel[c] += weights[c] * from[c];
                        }
                    }
                }
            }
        });
        out
    }
}

/// A dense layer of every token.
pub fn dense(rows: &[f32], layer: &Affine) -> Result<Vec<f32>, DecoderError> {
    let outputs = layer.bias.len();
    let depth = layer.weights.len() / outputs.max(1);
    let mut out = vec![0.0; rows.len() / depth.max(1) * outputs];
    out.par_chunks_mut(ROWS * outputs).zip(rows.par_chunks(ROWS * depth)).try_for_each(|(out, rows)| {
        let filter = Filter { weights: &layer.weights, bias: &layer.bias };
        linear(rows, filter, out, [rows.len() / depth, outputs, depth])
    })?;
    Ok(out)
}

fn add(values: &mut [f32], change: &[f32]) {
    values.iter_mut().zip(change).for_each(|(value, change)| *value += change);
}

/// No activation is applied to queries, keys and values.
pub fn project(convolution: &PairedConvolution, tokens: &Volume) -> Result<Volume, DecoderError> {
    Layer { kernel: convolution.into(), padding: [1, 1], activation: identity, pool: Pool::Keep, margin: 0 }.run(tokens)
}
