//! PhysFormer's attention: queries and keys by temporal-difference convolutions, scores divided by a fixed sharpness.

use heartian_ops::activation::softmax;
use heartian_ops::{Extent, Filter, PairedConvolution, Volume, linear};
use rayon::prelude::*;

use crate::nets::Trace;
use crate::nets::physformer::{dense, project};
use crate::parts::{Affine, Parts};
use crate::{DecoderError, Options};

/// Query rows whose scores are held at once.
const QUERY_ROWS: usize = 80;

/// Tokens, channels fastest, in the order of frames, rows, columns.
#[derive(Debug)]
pub struct Tokens {
    /// Sizes; a token is a pixel.
    pub extent: Extent,
    /// `frames × height × width × channels`.
    pub values: Vec<f32>,
}

impl Tokens {
    /// As planes.
    pub fn to_volume(&self, margin: usize) -> Result<Volume, DecoderError> {
        let Extent { frames, channels, height, width } = self.extent;
        let area = height * width;
        let planes: Vec<f32> = (0..frames * channels * area)
            .map(|i| self.values[(i / (channels * area) * area + i % area) * channels + i / area % channels])
            .collect();
        Ok(Volume::from_dense(self.extent, margin, &planes, true)?)
    }
}

/// One attention layer.
#[derive(Debug)]
pub struct Attention {
    query: PairedConvolution,
    key: PairedConvolution,
    value: Affine,
    out: Affine,
    heads: usize,
    sharpness: f32,
}

/// Moves θ times the temporal border taps' sum to the centre: the difference term is a pointwise convolution with it.
pub fn temporal_difference(mut affine: Affine, theta: f32) -> Affine {
    for kernel in affine.weights.as_chunks_mut::<27>().0 {
        let border: f64 = kernel[..9].iter().chain(&kernel[18..]).map(|w| f64::from(*w)).sum();
        kernel[13] = (f64::from(kernel[13]) - f64::from(theta) * border) as f32;
    }
    affine
}

impl Attention {
    /// The attention of the block `name`.
    pub fn new(parts: &Parts<'_>, name: &str, width: usize, options: &Options) -> Result<Self, DecoderError> {
        let projection = |which: &str| {
            let affine = parts.affine(&format!("{name}.attn.proj_{which}.0.conv"), &[width, width, 3, 3, 3], false)?;
            let norm = parts.norm(&format!("{name}.attn.proj_{which}.1"), width)?;
            temporal_difference(affine, options.theta).normed(&norm).paired(width)
        };
        Ok(Self {
            query: projection("q")?,
            key: projection("k")?,
            value: parts.affine(&format!("{name}.attn.proj_v.0"), &[width, width, 1, 1, 1], false)?,
            out: parts.affine(&format!("{name}.proj"), &[width, width], true)?,
            heads: options.heads,
            sharpness: options.sharpness,
        })
    }

    /// What the attention adds to the tokens; `last_of` names the transformer if the block is its last.
    pub fn run(&self, tokens: &Tokens, last_of: Option<usize>, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        let planes = tokens.to_volume(1)?;
        let queries = self.by_head(&project(&self.query, &planes)?);
        let keys = self.by_head(&project(&self.key, &planes)?);
        let values = dense(&tokens.values, &self.value)?;
        let width = tokens.extent.channels;
        let count = values.len() / width;
        let depth = width / self.heads;
        // Channels × tokens, so that a head's values are the rows of a product.
        let values: Vec<f32> = (0..values.len()).map(|i| values[i % count * width + i / count]).collect();
        if let Some(transformer) = last_of {
            for head in 0..self.heads {
                let name = || format!("score{transformer}_head{head}");
                trace.note(name, || self.scores(&queries, &keys, head, 0..8.min(count)).unwrap_or_default());
            }
        }
        let blocks = count.div_ceil(QUERY_ROWS);
        let heads: Vec<Vec<f32>> = (0..self.heads * blocks)
            .into_par_iter()
            .map(|job| {
                let (head, first) = (job / blocks, job % blocks * QUERY_ROWS);
                let rows = first..(first + QUERY_ROWS).min(count);
                let scores = self.scores(&queries, &keys, head, rows.clone())?;
                let weights = &values[head * depth * count..(head + 1) * depth * count];
                let mut out = vec![0.0; rows.len() * depth];
                linear(&scores, Filter { weights, bias: &[] }, &mut out, [rows.len(), depth, count])?;
                Ok(out)
            })
            .collect::<Result<_, DecoderError>>()?;
        let mut joined = vec![0.0; count * width];
        for (job, part) in heads.iter().enumerate() {
            let (head, first) = (job / blocks, job % blocks * QUERY_ROWS);
            for (row, values) in part.chunks_exact(depth).enumerate() {
                joined[(first + row) * width + head * depth..][..depth].copy_from_slice(values);
            }
        }
        dense(&joined, &self.out)
    }

    /// Softmax scores of some queries of a head over all keys.
    fn scores(
        &self,
        queries: &[Vec<f32>],
        keys: &[Vec<f32>],
        head: usize,
        rows: std::ops::Range<usize>,
    ) -> Result<Vec<f32>, DecoderError> {
        let (queries, keys) = (&queries[head], &keys[head]);
        let depth = self.value.bias.len() / self.heads;
        let count = keys.len() / depth;
        let mut scores = vec![0.0; rows.len() * count];
        let filter = Filter { weights: keys, bias: &[] };
        linear(&queries[rows.start * depth..rows.end * depth], filter, &mut scores, [rows.len(), count, depth])?;
        scores.chunks_exact_mut(count).for_each(|row| softmax(row, 1.0 / self.sharpness));
        Ok(scores)
    }

    /// Planes as `tokens × channels` of each head.
    fn by_head(&self, planes: &Volume) -> Vec<Vec<f32>> {
        let Extent { frames, channels, height, width } = planes.extent();
        let depth = channels / self.heads;
        (0..self.heads)
            .map(|head| {
                let mut rows = vec![0.0; frames * height * width * depth];
                for (t, c) in (0..frames * depth).map(|i| (i / depth, i % depth)) {
                    for y in 0..height {
                        for (x, value) in planes.row(t, head * depth + c, y).iter().enumerate() {
                            rows[((t * height + y) * width + x) * depth + c] = *value;
                        }
                    }
                }
                rows
            })
            .collect()
    }
}
