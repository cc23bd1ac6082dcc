//! The words of the reading nodes' parameters, and what they mean in `heartian-signal`.

use heartian_graph::NodeError;
use heartian_signal::trace::Weighting;
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
}

/// Which pixels count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pixels {
    /// The whole frame, as the toolbox reads a face crop.
    Frame,
    /// Each pixel by its alpha.
    Matte,
}

/// A classical method.
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
}

impl Convention {
    /// The settings of that name.
    pub fn preset(self) -> Preset {
        match self {
            Self::Paper => Preset::Paper,
            Self::Toolbox => Preset::Toolbox,
            Self::ToolboxFine => Preset::ToolboxFine,
        }
    }
}

impl Pixels {
    /// The weighting of that name.
    pub fn weighting(self) -> Weighting {
        match self {
            Self::Frame => Weighting::WholeFrame,
            Self::Matte => Weighting::Alpha,
        }
    }
}

impl ReadBy {
    /// The method of that name.
    pub fn method(self) -> Method {
        match self {
            Self::Pos => Method::Pos,
            Self::Chrom => Method::Chrom,
            Self::Green => Method::Green,
            Self::Ica => Method::Ica,
            Self::Lgi => Method::Lgi,
            Self::Pbv => Method::Pbv,
            Self::Omit => Method::Omit,
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
