//! What can be wrong with weights or input; each message names what, where and the remedy.

use std::path::PathBuf;

/// Errors of the decoder crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecoderError {
    /// The file cannot be read.
    #[error("{path}: {source}; give the path of a .pth or .safetensors weight file", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a weight file this crate reads, or is damaged.
    #[error("the weight file cannot be read: {what}; {remedy}")]
    Format {
        /// What is wrong and where.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// No architecture has these tensors.
    #[error(
        "the {tensors} tensors of the weight file{} belong to none of TS-CAN, PhysFormer, FactorizePhys, PhysNet; \
         give weights trained with rPPG-Toolbox", first.as_ref().map(|name| format!(" (the first is `{name}`)")).unwrap_or_default()
    )]
    Unrecognised {
        /// Tensors found.
        tensors: usize,
        /// One of them.
        first: Option<String>,
    },
    /// The weights lack a tensor.
    #[error("the weight file lacks the tensor `{name}` that {architecture} needs; it holds weights of another network")]
    Missing {
        /// The network.
        architecture: &'static str,
        /// The tensor.
        name: String,
    },
    /// The weights hold a tensor that the network does not have.
    #[error(
        "the weight file holds a tensor `{name}` that {architecture} does not have; it holds weights of another network"
    )]
    Extra {
        /// The network.
        architecture: &'static str,
        /// The tensor.
        name: String,
    },
    /// A tensor has another shape than the network's.
    #[error("the tensor `{name}` is {found:?} where {architecture} needs {expected}; {remedy}")]
    Shape {
        /// The network.
        architecture: &'static str,
        /// The tensor.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape it should have.
        expected: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A weight is NaN or infinite.
    #[error("the tensor `{name}` holds {value} at {index}; the weight file is damaged or its training diverged")]
    WeightNotFinite {
        /// The tensor.
        name: String,
        /// Where.
        index: usize,
        /// What.
        value: f64,
    },
    /// An option does not fit the weights.
    #[error("`{option}` is {value}, but {reason}")]
    Option {
        /// The option.
        option: &'static str,
        /// Its value.
        value: String,
        /// What it must be, and why.
        reason: String,
    },
    /// A chunk of a length the network cannot take.
    #[error("a chunk has {frames} frames; this network takes multiples of {multiple}, at least one")]
    ChunkLength {
        /// Frames given.
        frames: usize,
        /// What divides them.
        multiple: usize,
    },
    /// A batch of another size than it says.
    #[error(
        "a batch holds {found} values where {chunks} chunks × {channels} channels × {frames} frames × {side_px} × {side_px} were expected"
    )]
    BatchSize {
        /// Chunks.
        chunks: usize,
        /// Channels of a frame.
        channels: usize,
        /// Frames with the repeated ones.
        frames: usize,
        /// Height and width.
        side_px: usize,
        /// Values given.
        found: usize,
    },
    /// The frames hold a NaN or an infinity.
    #[error("the frames hold {value} at {index}; only finite numbers can be decoded")]
    InputNotFinite {
        /// Where.
        index: usize,
        /// What.
        value: f32,
    },
    /// The numbers left the range of f32 on the way.
    #[error("{architecture} gives {value} for frame {frame}; the input is far outside what the network was trained on")]
    OutputNotFinite {
        /// The network.
        architecture: &'static str,
        /// The first such sample.
        frame: usize,
        /// What came out.
        value: f32,
    },
    /// A clip is shorter than one chunk of a network.
    #[error(
        "the clip has {frames} frames and {architecture} reads {needed} at a time; \
         give a longer clip, or use a method without weights (POS needs 49 frames at 30 Hz)"
    )]
    ShortClip {
        /// The network.
        architecture: &'static str,
        /// Frames there are.
        frames: usize,
        /// Frames of a chunk.
        needed: usize,
    },
    /// Nothing changes from frame to frame.
    #[error(
        "all {frames} frames that {architecture} is shown are the same (black, or a still picture); \
         check that the face is lit and in the frame"
    )]
    Still {
        /// The network.
        architecture: &'static str,
        /// Frames there are.
        frames: usize,
    },
    /// A trace has no answer.
    #[error(transparent)]
    Signal(#[from] heartian_signal::SignalError),
    /// Buffers of an op contradict each other.
    #[error(transparent)]
    Ops(#[from] heartian_ops::ShapeError),
}

impl From<heartian_foreign::ForeignError> for DecoderError {
    fn from(error: heartian_foreign::ForeignError) -> Self {
        Self::Format { what: error.what().to_owned(), remedy: error.remedy() }
    }
}
