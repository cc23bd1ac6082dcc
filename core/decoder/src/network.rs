//! A loaded network: which one it is, what it wants, and running it.

use std::path::Path;

use crate::nets::Trace;
use crate::nets::factorizephys::FactorizePhys;
use crate::nets::physformer::PhysFormer;
use crate::nets::physnet::PhysNet;
use crate::nets::tscan::TsCan;
use crate::parts::Parts;
use crate::{Architecture, Batch, DecoderError, InputForm, Normalisation, Output, Weights};

/// FactorizePhys' factorised attention at inference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Factorisation {
    /// Skipped, as every published inference configuration does.
    #[default]
    Off,
    /// On, added to its input, as in training.
    On,
    /// On, in place of its input.
    WithoutResidual,
}

/// What TS-CAN's temporal shift takes from beyond the ends of a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SegmentEdge {
    /// Zeros (rPPG-Toolbox).
    #[default]
    Zero,
    /// The frame at the end, again (open-rppg).
    Replicate,
}

/// What the weights do not say about themselves; the defaults are rPPG-Toolbox's.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The network, if it is to be checked rather than recognised.
    pub architecture: Option<Architecture>,
    /// PhysNet: height and width of a frame, where not 72; the other networks' weights fix it.
    pub side_px: Option<usize>,
    /// FactorizePhys: the attention branch.
    pub factorisation: Factorisation,
    /// TS-CAN: frames of a segment (frame depth).
    pub segment_frames: usize,
    /// TS-CAN: what lies beyond a segment.
    pub segment_edge: SegmentEdge,
    /// PhysFormer: attention heads.
    pub heads: usize,
    /// PhysFormer: share of the temporal difference in the query and key convolutions (θ).
    pub theta: f32,
    /// PhysFormer: what attention scores are divided by (gra_sharp).
    pub sharpness: f32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            architecture: None,
            side_px: None,
            factorisation: Factorisation::Off,
            segment_frames: 10,
            segment_edge: SegmentEdge::Zero,
            heads: 4,
            theta: 0.7,
            sharpness: 2.0,
        }
    }
}

/// A network with its weights, ready to run; it may be shared between threads.
#[derive(Debug)]
pub struct Network {
    net: Net,
    input: InputForm,
}

#[derive(Debug)]
enum Net {
    TsCan(Box<TsCan>),
    PhysFormer(Box<PhysFormer>),
    FactorizePhys(Box<FactorizePhys>),
    PhysNet(PhysNet),
}

impl Network {
    /// Reads a weight file and builds the network it belongs to.
    ///
    /// # Errors
    /// When the file cannot be read, is damaged, or a tensor is missing, extra, misshapen or not finite.
    pub fn load(path: &Path, options: &Options) -> Result<Self, DecoderError> {
        Self::new(&Weights::load(path)?, options)
    }

    /// As [`Self::load`], from the file's content.
    ///
    /// # Errors
    /// As there.
    pub fn from_bytes(bytes: &[u8], options: &Options) -> Result<Self, DecoderError> {
        Self::new(&Weights::from_bytes(bytes)?, options)
    }

    /// Builds a network from its weights.
    ///
    /// # Errors
    /// When a tensor is missing, extra or misshapen, or an option does not fit.
    pub fn new(weights: &Weights, options: &Options) -> Result<Self, DecoderError> {
        let architecture = options.architecture.map_or_else(|| Architecture::of(weights), Ok)?;
        let parts = Parts::new(weights, architecture);
        let (net, input) = match architecture {
            Architecture::TsCan => TsCan::new(parts, options).map(|(net, input)| (Net::TsCan(Box::new(net)), input)),
            Architecture::PhysFormer => {
                PhysFormer::new(parts, options).map(|(net, input)| (Net::PhysFormer(Box::new(net)), input))
            }
            Architecture::FactorizePhys => {
                FactorizePhys::new(parts, options).map(|(net, input)| (Net::FactorizePhys(Box::new(net)), input))
            }
            Architecture::PhysNet => PhysNet::new(parts, options).map(|(net, input)| (Net::PhysNet(net), input)),
        }?;
        Ok(Self { net, input })
    }

    /// Which network it is.
    pub fn architecture(&self) -> Architecture {
        match self.net {
            Net::TsCan(_) => Architecture::TsCan,
            Net::PhysFormer(_) => Architecture::PhysFormer,
            Net::FactorizePhys(_) => Architecture::FactorizePhys,
            Net::PhysNet(_) => Architecture::PhysNet,
        }
    }

    /// What it wants to be fed.
    pub fn input(&self) -> &InputForm {
        &self.input
    }

    /// One sample a frame: `chunks × frames` values, what they mean is [`InputForm::output`].
    ///
    /// # Errors
    /// When the batch has another form, or holds or leads to numbers that are not finite.
    pub fn run(&self, batch: Batch<'_>) -> Result<Vec<f32>, DecoderError> {
        self.run_traced(&batch, &mut Trace::default())
    }

    /// As [`Self::run`], with inner values for tests.
    pub(crate) fn run_traced(&self, batch: &Batch<'_>, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        batch.check(&self.input)?;
        let out = match &self.net {
            Net::TsCan(net) => net.run(batch, &self.input, trace),
            Net::PhysFormer(net) => net.run(batch, &self.input, trace),
            Net::FactorizePhys(net) => net.run(batch, &self.input, trace),
            Net::PhysNet(net) => net.run(batch, &self.input, trace),
        }?;
        match out.iter().position(|value| !value.is_finite()) {
            Some(frame) => Err(DecoderError::OutputNotFinite {
                architecture: self.architecture().name(),
                frame,
                value: out[frame],
            }),
            None => Ok(out),
        }
    }
}

impl Architecture {
    /// What rPPG-Toolbox feeds the network by default; [`Network::input`] is the word of the weights themselves.
    pub fn usual_input(self) -> InputForm {
        let form = |frames, side_px, frame_multiple, normalisations: &[Normalisation], output| InputForm {
            frames,
            extra_frames: 0,
            frame_multiple,
            side_px,
            normalisations: normalisations.to_vec(),
            output,
        };
        let (diff, standardized) = (Normalisation::DiffNormalized, Normalisation::Standardized);
        match self {
            Self::TsCan => form(180, 72, 10, &[diff, standardized], Output::Derivative),
            Self::PhysFormer => form(160, 128, 4, &[diff], Output::Derivative),
            Self::FactorizePhys => {
                InputForm { extra_frames: 1, ..form(160, 72, 1, &[Normalisation::Raw], Output::Pulse) }
            }
            Self::PhysNet => form(128, 72, 4, &[diff], Output::Derivative),
        }
    }
}
