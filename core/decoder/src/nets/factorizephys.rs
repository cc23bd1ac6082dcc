//! FactorizePhys (Joshi et al. 2024): narrow three-dimensional convolutions, tanh and instance norm throughout, with an
//! optional attention that factorises the embedding into one non-negative component (FSAM).
//!
//! Minima are taken over the whole batch, as in the reference, so with FSAM on a result depends on what it is batched with.

use heartian_ops::activation::tanh;
use heartian_ops::{Convolution, Extent, PairedConvolution, Volume};
use rayon::prelude::*;

use super::{Trace, chunk_volume};
use crate::layer::{Layer, Pool, identity, relu};
use crate::norm::instance_norm;
use crate::parts::Parts;
use crate::{Architecture, Batch, DecoderError, Factorisation, InputForm, Options};

/// Index, inputs, outputs, whether it halves rows and columns, padding.
const EXTRACTOR: [(usize, usize, usize, bool, [usize; 2]); 6] = [
    (0, 3, 8, false, [1, 1]),
    (1, 8, 12, true, [1, 0]),
    (2, 12, 12, false, [1, 0]),
    (4, 12, 12, false, [1, 0]),
    (5, 12, 16, true, [1, 0]),
    (6, 16, 16, false, [1, 0]),
];
/// Channels of the embedding and of its factorised part.
const EMBEDDED: usize = 16;
const FACTORED: usize = 8;
/// Multiplicative updates.
const STEPS: usize = 4;
const NMF_EPSILON: f64 = 1e-6;

/// One convolution, tanh, instance norm.
#[derive(Debug)]
struct Block {
    convolution: PairedConvolution,
    halves: bool,
    padding: [usize; 2],
}

#[derive(Debug)]
struct Attention {
    before: Convolution,
    after: [Convolution; 2],
    residual: bool,
}

/// The network.
#[derive(Debug)]
pub struct FactorizePhys {
    extractor: Vec<Block>,
    head: Vec<Block>,
    attention: Option<Attention>,
    finals: Vec<Block>,
    last: Convolution,
}

impl Block {
    fn new(
        parts: &Parts<'_>,
        name: &str,
        [inputs, outputs]: [usize; 2],
        halves: bool,
        padding: [usize; 2],
    ) -> Result<Self, DecoderError> {
        let affine = parts.affine(&format!("{name}.conv_block_3d.0"), &[outputs, inputs, 3, 3, 3], false)?;
        let convolution = if halves { halving(&affine.weights, [inputs, outputs])? } else { affine.paired(inputs)? };
        Ok(Self { convolution, halves, padding })
    }

    fn run(&self, input: &Volume) -> Result<Volume, DecoderError> {
        let (kernel, padding) = ((&self.convolution).into(), self.padding);
        let layer = Layer { kernel, padding, activation: tanh, pool: Pool::Keep, margin: 0 };
        let mut out = if self.halves { layer.run(&phases(input))? } else { layer.run(input)? };
        instance_norm(&mut out);
        Ok(out)
    }
}

impl FactorizePhys {
    /// Takes the weights apart; those of the attention are needed only if it is on.
    pub fn new(parts: Parts<'_>, options: &Options) -> Result<(Self, InputForm), DecoderError> {
        let mut extractor = Vec::new();
        for (index, inputs, outputs, halves, padding) in EXTRACTOR {
            let name = format!("rppg_feature_extractor.FeatureExtractor.{index}");
            extractor.push(Block::new(&parts, &name, [inputs, outputs], halves, padding)?);
        }
        let plain = |name: String, channels| Block::new(&parts, &name, channels, false, [1, 0]);
        let head = (0..3)
            .map(|index| plain(format!("rppg_head.conv_block.{index}"), [EMBEDDED; 2]))
            .collect::<Result<_, _>>()?;
        let attention = match options.factorisation {
            Factorisation::Off => None,
            how => Some(Attention::new(&parts, how == Factorisation::On)?),
        };
        let finals = vec![
            plain("rppg_head.final_layer.0".to_owned(), [EMBEDDED, 12])?,
            plain("rppg_head.final_layer.1".to_owned(), [12, 8])?,
        ];
        let last = parts.affine("rppg_head.final_layer.2", &[1, 8, 3, 3, 3], false)?.convolution(8, [3; 3])?;
        parts.finish(|name| name.starts_with("rppg_head.fsam.") || name == "rppg_head.bias1")?;
        Ok((Self { extractor, head, attention, finals, last }, Architecture::FactorizePhys.usual_input()))
    }

    /// All chunks of a checked batch, together.
    pub fn run(&self, batch: &Batch<'_>, form: &InputForm, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        let mut embedded = Vec::new();
        for chunk in 0..batch.chunks {
            let mut x = differences(&chunk_volume(batch, form, chunk, 0)?);
            instance_norm(&mut x);
            for block in &self.extractor {
                x = block.run(&x)?;
            }
            trace.note(|| "voxel_embeddings".to_owned(), || x.to_dense());
            for block in &self.head {
                x = block.run(&x)?;
            }
            trace.note(|| "tap_head_conv".to_owned(), || x.to_dense());
            embedded.push(x);
        }
        if let Some(attention) = &self.attention {
            embedded = attention.run(embedded, trace)?;
        }
        let mut out = Vec::with_capacity(batch.chunks * batch.frames);
        for mut x in embedded {
            for block in &self.finals {
                x = block.run(&x)?;
            }
            let (kernel, padding) = ((&self.last).into(), [1, 0]);
            let last = Layer { kernel, padding, activation: identity, pool: Pool::Keep, margin: 0 };
            out.extend(last.run(&x)?.to_dense());
        }
        Ok(out)
    }
}

impl Attention {
    fn new(parts: &Parts<'_>, residual: bool) -> Result<Self, DecoderError> {
        let pointwise = |name: &str, [outputs, inputs]: [usize; 2], bias| {
            parts
                .affine(&format!("rppg_head.fsam.{name}"), &[outputs, inputs, 1, 1, 1], bias)?
                .convolution(inputs, [1; 3])
        };
        Ok(Self {
            before: pointwise("pre_conv_block.0", [FACTORED, EMBEDDED], true)?,
            after: [
                pointwise("post_conv_block.0.conv", [FACTORED; 2], false)?,
                pointwise("post_conv_block.1", [EMBEDDED, FACTORED], false)?,
            ],
            residual,
        })
    }

    fn run(&self, embedded: Vec<Volume>, trace: &mut Trace) -> Result<Vec<Volume>, DecoderError> {
        let least = minimum(&embedded);
        let mut attentions = Vec::new();
        let mut error = 0.0;
        for v in &embedded {
            let mut shifted = v.clone();
            each(&mut shifted, |value| value - least);
            let e = pointwise(&self.before, relu, &shifted)?;
            let extent = e.extent();
            let e = e.to_dense();
            let approximated = factorised(&e, extent.frames);
            error += e.iter().zip(&approximated).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            trace.note(|| "tap_md_in".to_owned(), || e.clone());
            trace.note(|| "tap_md_out".to_owned(), || approximated.clone());
            let x = pointwise(&self.after[0], relu, &Volume::from_dense(extent, 0, &approximated, false)?)?;
            let attention = pointwise(&self.after[1], identity, &x)?;
            trace.note(|| "tap_att".to_owned(), || attention.to_dense());
            attentions.push(attention);
        }
        trace.note(|| "fsam_appx_error".to_owned(), || vec![error.sqrt() as f32]);
        let least_attention = minimum(&attentions);
        embedded
            .into_iter()
            .zip(&attentions)
            .map(|(v, attention)| {
                let (v, attention, extent) = (v.to_dense(), attention.to_dense(), v.extent());
                let gated = v.iter().zip(&attention).map(|(v, a)| (v - least + 1.0) * (a - least_attention + 1.0));
                let mut out = Volume::from_dense(extent, 0, &gated.collect::<Vec<_>>(), false)?;
                instance_norm(&mut out);
                if self.residual {
                    let sum: Vec<f32> = out.to_dense().iter().zip(&v).map(|(out, v)| out + v).collect();
                    out = Volume::from_dense(extent, 0, &sum, false)?;
                }
                Ok(out)
            })
            .collect()
    }
}

fn pointwise(convolution: &Convolution, activation: fn(&mut [f32]), input: &Volume) -> Result<Volume, DecoderError> {
    Layer { kernel: convolution.into(), padding: [0, 0], activation, pool: Pool::Keep, margin: 0 }.run(input)
}

/// Smallest value of several volumes.
fn minimum(volumes: &[Volume]) -> f32 {
    volumes.iter().flat_map(Volume::to_dense).fold(f32::INFINITY, f32::min)
}

fn each(volume: &mut Volume, function: impl Fn(f32) -> f32 + Sync) {
    let Extent { channels, height, .. } = volume.extent();
    volume.par_frames_mut().for_each(|mut frame| {
        for c in 0..channels {
            for y in 0..height {
                frame.row_mut(c, y).iter_mut().for_each(|value| *value = function(*value));
            }
        }
    });
}

/// The nearest rank-one non-negative product, by [`STEPS`] multiplicative updates from constant factors.
///
/// The matrix is the `channels × frames × rows × columns` buffer read as `frames` rows: a plain reshape as in the
/// reference, not a transpose.
fn factorised(values: &[f32], frames: usize) -> Vec<f32> {
    let columns = values.len() / frames.max(1);
    let mut bases = vec![1.0 / (frames as f64).sqrt(); frames];
    let mut coefficients = vec![1.0f64; columns];
    for step in 0..=STEPS {
        let norm: f64 = bases.iter().map(|b| b * b).sum();
        let mut products = vec![0.0f64; columns];
        for (row, base) in values.chunks_exact(columns.max(1)).zip(&bases) {
            products.iter_mut().zip(row).for_each(|(sum, value)| *sum += base * f64::from(*value));
        }
        for (coefficient, product) in coefficients.iter_mut().zip(products) {
            *coefficient *= product / (*coefficient * norm + NMF_EPSILON);
        }
        if step == STEPS {
            break;
        }
        let norm: f64 = coefficients.iter().map(|c| c * c).sum();
        for (row, base) in values.chunks_exact(columns.max(1)).zip(&mut bases) {
            let product: f64 = row.iter().zip(&coefficients).map(|(value, c)| f64::from(*value) * c).sum();
            *base *= product / (*base * norm + NMF_EPSILON);
        }
    }
    bases.iter().flat_map(|base| coefficients.iter().map(move |c| (base * c) as f32)).collect()
}

/// Frame t + 1 less frame t, with a margin for the first layer.
fn differences(frames: &Volume) -> Volume {
    let extent = frames.extent();
    let mut out = Volume::zeros(Extent { frames: extent.frames.saturating_sub(1), ..extent }, 1);
    out.par_frames_mut().enumerate().for_each(|(t, mut frame)| {
        for c in 0..extent.channels {
            for y in 0..extent.height {
                let (now, next) = (frames.row(t, c, y), frames.row(t + 1, c, y));
                for (out, (now, next)) in frame.row_mut(c, y).iter_mut().zip(now.iter().zip(next)) {
                    *out = next - now;
                }
            }
        }
    });
    out
}

/// Every channel as four: its even and odd rows and columns. A window of 3 that steps by 2 becomes one of 2 that steps by 1.
pub fn phases(input: &Volume) -> Volume {
    let from = input.extent();
    let extent =
        Extent { channels: 4 * from.channels, height: from.height.div_ceil(2), width: from.width.div_ceil(2), ..from };
    let mut out = Volume::zeros(extent, 0);
    out.par_frames_mut().enumerate().for_each(|(t, mut frame)| {
        for c in 0..from.channels {
            for y in 0..from.height {
                let row = input.row(t, c, y);
                for odd in 0..2 {
                    let out = frame.row_mut(4 * c + 2 * (y % 2) + odd, y / 2);
                    out.iter_mut().zip(row.iter().skip(odd).step_by(2)).for_each(|(out, value)| *out = *value);
                }
            }
        }
    });
    out
}

/// Weights `outputs × inputs × 3 × 3 × 3` for the channels of [`phases`]: `outputs × 4·inputs × 3 × 2 × 2`.
pub fn halving(weights: &[f32], [inputs, outputs]: [usize; 2]) -> Result<PairedConvolution, DecoderError> {
    let mut split = vec![0.0; outputs * inputs * 4 * 12];
    for plane in 0..outputs * inputs {
        for t in 0..3 {
            for (y, x) in (0..9).map(|tap| (tap / 3, tap % 3)) {
                let phase = 4 * plane + 2 * (y % 2) + x % 2;
                split[(phase * 3 + t) * 4 + 2 * (y / 2) + x / 2] = weights[(plane * 3 + t) * 9 + 3 * y + x];
            }
        }
    }
    Ok(PairedConvolution::new(&split, &[], [outputs, 4 * inputs], [2, 2])?)
}

/// The trainer's last step: the batch's samples less their mean, over their standard deviation (n − 1).
pub fn standardised(samples: &[f32]) -> Vec<f32> {
    let n = samples.len() as f64;
    let mean = samples.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
    let variance = samples.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / (n - 1.0);
    samples.iter().map(|v| ((f64::from(*v) - mean) / variance.sqrt()) as f32).collect()
}
