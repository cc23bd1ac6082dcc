//! The words of the reading nodes' parameters, and what they mean in `heartian-signal`.

use heartian_decoder::{Architecture, Averaged, Cut, Named, Statistics};
use heartian_graph::NodeError;
use heartian_signal::{EvenTrace, HeartRate, Method, Preset, SignalError, estimate, resampled_evenly};
use heartian_space::{Series, Trace};
use serde::{Deserialize, Serialize};

/// How a heart rate is read from a trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Convention {
    /// The paper's protocol with bins of at most 0.1 bpm.
    Paper,
    /// rPPG-Toolbox's, with its coarser bins.
    Toolbox,
    /// rPPG-Toolbox's band with bins of at most 0.1 bpm.
    ToolboxFine,
    /// As ToolboxFine, and the fundamental rather than its second harmonic where both stand out.
    Fundamental,
}

/// Which pixels count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pixels {
    /// The whole frame, as the toolbox reads a face crop.
    Frame,
    /// Each pixel by its alpha.
    Matte,
    /// The face crop at 72×72, as the toolbox reads a whole recording.
    Face,
}

/// How the face crop is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FaceCut {
    /// The box around the first frame's matte.
    Matte,
    /// The face seen in the first frame, enlarged by half.
    Detector,
    /// The face seen in every thirtieth frame, enlarged by half.
    MovingDetector,
    /// The whole frame.
    Frame,
}

/// Over what networks' inputs are normalised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum NormalisedOver {
    /// The whole clip, as the toolbox does.
    Clip,
    /// Each chunk by itself.
    Chunk,
}

/// A decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ReadBy {
    /// Plane orthogonal to skin.
    Pos,
    /// Chrominance.
    Chrom,
    /// Mean green.
    Green,
    /// Independent components (JADE).
    Ica,
    /// Local group invariance.
    Lgi,
    /// Blood-volume-pulse signature.
    Pbv,
    /// Orthogonal matrix image transformation.
    Omit,
    /// Temporal-shift convolutional attention network.
    TsCan,
    /// Temporal-difference video transformer.
    PhysFormer,
    /// Convolutions with factorised attention.
    FactorizePhys,
    /// Spatio-temporal encoder and decoder.
    PhysNet,
}

impl Convention {
    /// The settings of that name.
    pub fn preset(self) -> Preset {
        match self {
            Self::Paper => Preset::Paper,
            Self::Toolbox => Preset::Toolbox,
            Self::ToolboxFine => Preset::ToolboxFine,
            Self::Fundamental => Preset::Fundamental,
        }
    }
}

impl Pixels {
    /// What classical methods average.
    pub fn averaged(self) -> Averaged {
        match self {
            Self::Frame => Averaged::Frame,
            Self::Matte => Averaged::Matte,
            Self::Face => Averaged::Face,
        }
    }
}

impl FaceCut {
    /// What networks are shown.
    pub fn cut(self) -> Cut {
        match self {
            Self::Matte => Cut::Matte,
            Self::Detector => Cut::Still,
            Self::MovingDetector => Cut::Moving,
            Self::Frame => Cut::Frame,
        }
    }
}

impl NormalisedOver {
    /// The statistics of that name.
    pub fn statistics(self) -> Statistics {
        match self {
            Self::Clip => Statistics::WholeClip,
            Self::Chunk => Statistics::PerChunk,
        }
    }
}

impl ReadBy {
    /// The decoder of that name.
    pub fn named(self) -> Named {
        match self {
            Self::Pos => Named::Classical(Method::Pos),
            Self::Chrom => Named::Classical(Method::Chrom),
            Self::Green => Named::Classical(Method::Green),
            Self::Ica => Named::Classical(Method::Ica),
            Self::Lgi => Named::Classical(Method::Lgi),
            Self::Pbv => Named::Classical(Method::Pbv),
            Self::Omit => Named::Classical(Method::Omit),
            Self::TsCan => Named::Neural(Architecture::TsCan),
            Self::PhysFormer => Named::Neural(Architecture::PhysFormer),
            Self::FactorizePhys => Named::Neural(Architecture::FactorizePhys),
            Self::PhysNet => Named::Neural(Architecture::PhysNet),
        }
    }
}

/// Reads the heart rate of a trace with its own times.
pub(crate) fn read(series: &Series, preset: Preset) -> Result<HeartRate, SignalError> {
    let EvenTrace { rate_hertz, values } = resampled_evenly(&series.times_seconds, &series.values)?;
    estimate(&values, rate_hertz, preset)
}

/// The filtered waveform as a labelled trace that starts at `start_seconds`.
pub(crate) fn trace(label: &str, rate: &HeartRate, start_seconds: f64) -> Result<Trace, NodeError> {
    let times = (0..rate.filtered.len()).map(|k| start_seconds + k as f64 / rate.rate_hertz).collect();
    Ok(Trace { label: label.to_owned(), series: Series::new(times, rate.filtered.clone())? })
}
