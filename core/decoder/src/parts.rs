//! Taking a network's tensors out of its weights: every tensor is asked for by name and shape, the first that is missing
//! or misshapen is named, and so is one that nobody asked for. Batch norms are folded into the layer before them.

use std::cell::RefCell;
use std::collections::BTreeSet;

use heartian_ops::{Convolution, PairedConvolution};

use crate::{Architecture, DecoderError, Weights};

/// ε of a batch norm.
const NORM_EPSILON: f64 = 1e-5;

/// The weights of one network while it is built.
pub struct Parts<'a> {
    weights: &'a Weights,
    architecture: Architecture,
    used: RefCell<BTreeSet<String>>,
}

/// Weights and bias of a layer that are about to be packed.
#[derive(Clone, Debug)]
pub struct Affine {
    /// `outputs × …`.
    pub weights: Vec<f32>,
    /// One an output.
    pub bias: Vec<f32>,
}

impl<'a> Parts<'a> {
    /// All of `weights`, as `architecture`'s.
    pub fn new(weights: &'a Weights, architecture: Architecture) -> Self {
        Self { weights, architecture, used: RefCell::default() }
    }

    /// The shape of a tensor.
    pub fn shape(&self, name: &str) -> Result<&'a [usize], DecoderError> {
        match self.weights.get(name) {
            Some(tensor) => Ok(&tensor.shape),
            None => Err(DecoderError::Missing { architecture: self.architecture.name(), name: name.to_owned() }),
        }
    }

    /// Whether there is such a tensor.
    pub fn has(&self, name: &str) -> bool {
        self.weights.contains(name)
    }

    /// An error about a tensor's shape.
    pub fn misshapen(&self, name: &str, expected: &str, remedy: &'static str) -> DecoderError {
        let found = self.weights.get(name).map(|tensor| tensor.shape.clone()).unwrap_or_default();
        DecoderError::Shape {
            architecture: self.architecture.name(),
            name: name.to_owned(),
            found,
            expected: expected.to_owned(),
            remedy,
        }
    }

    /// A tensor of exactly this shape.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<&'a [f32], DecoderError> {
        if self.shape(name)? != shape {
            return Err(self.misshapen(name, &format!("{shape:?}"), "give weights of the same size of network"));
        }
        self.used.borrow_mut().insert(name.to_owned());
        Ok(self.weights.get(name).map(|tensor| tensor.data.as_slice()).unwrap_or_default())
    }

    /// `NAME.weight` of this shape and, where it `has_bias`, `NAME.bias`; zeros else.
    pub fn affine(&self, name: &str, shape: &[usize], has_bias: bool) -> Result<Affine, DecoderError> {
        let weights = self.tensor(&format!("{name}.weight"), shape)?.to_vec();
        let bias =
            if has_bias { self.tensor(&format!("{name}.bias"), &shape[..1])?.to_vec() } else { vec![0.0; shape[0]] };
        Ok(Affine { weights, bias })
    }

    /// Scale and shift of the batch norm `name` with its running statistics: `y = scale·x + shift`.
    pub fn norm(&self, name: &str, channels: usize) -> Result<Vec<(f64, f64)>, DecoderError> {
        let part = |suffix: &str| self.tensor(&format!("{name}.{suffix}"), &[channels]);
        let (gain, offset) = (part("weight")?, part("bias")?);
        let (mean, variance_name) = (part("running_mean")?, format!("{name}.running_var"));
        let variance = self.tensor(&variance_name, &[channels])?;
        if let Some(index) = variance.iter().position(|v| f64::from(*v) <= -NORM_EPSILON) {
            let value = f64::from(variance[index]);
            return Err(DecoderError::WeightNotFinite { name: variance_name, index, value });
        }
        Ok((0..channels)
            .map(|c| {
                let scale = f64::from(gain[c]) / (f64::from(variance[c]) + NORM_EPSILON).sqrt();
                (scale, f64::from(offset[c]) - scale * f64::from(mean[c]))
            })
            .collect())
    }

    /// Errs if a tensor was not asked for, save those whose names `spare` accepts.
    pub fn finish(self, spare: impl Fn(&str) -> bool) -> Result<(), DecoderError> {
        let used = self.used.into_inner();
        match self.weights.names().find(|name| !used.contains(*name) && !spare(name)) {
            Some(name) => Err(DecoderError::Extra { architecture: self.architecture.name(), name: name.to_owned() }),
            None => Ok(()),
        }
    }
}

impl Affine {
    /// Applies a batch norm after this layer, output by output.
    pub fn normed(mut self, norm: &[(f64, f64)]) -> Self {
        let each = self.weights.len() / norm.len().max(1);
        for (o, (scale, shift)) in norm.iter().enumerate() {
            for weight in &mut self.weights[o * each..(o + 1) * each] {
                *weight = (f64::from(*weight) * scale) as f32;
            }
            self.bias[o] = (f64::from(self.bias[o]) * scale + shift) as f32;
        }
        self
    }

    /// Packs the layer as a convolution of `inputs` channels.
    pub fn convolution(&self, inputs: usize, kernel: [usize; 3]) -> Result<Convolution, DecoderError> {
        Ok(Convolution::new(&self.weights, &self.bias, [self.bias.len(), inputs], kernel)?)
    }

    /// Packs a layer of 3 × 3 × 3 windows for pairs of frames.
    pub fn paired(&self, inputs: usize) -> Result<PairedConvolution, DecoderError> {
        Ok(PairedConvolution::new(&self.weights, &self.bias, [self.bias.len(), inputs], [3, 3])?)
    }

    /// Packs a layer of 3 × 3 windows for pairs of rows.
    pub fn paired_rows(&self, inputs: usize) -> Result<PairedConvolution, DecoderError> {
        Ok(PairedConvolution::new(&self.weights, &self.bias, [self.bias.len(), inputs], [1, 3])?)
    }
}
