//! The landmark networks: a reader and interpreter for TFLite files, and the pipelines built on them.
//!
//! A model file is data from outside: every read is bounds-checked, every size is limited, and a malformed file is a
//! [`NetError`], never a panic. Networks are immutable once read and run on one thread each; callers run frames in
//! parallel. Pixel coordinates have their centres at +0.5.

mod constant;
mod detector;
mod flatbuffer;
mod follow;
#[cfg(test)]
mod golden;
mod interpret;
mod irises;
mod matting;
mod op;
mod parse;
mod sampling;
#[cfg(test)]
mod tests;

pub use detector::{Detection, Detector};
pub use follow::{FaceFollower, FaceLandmarks, LandmarkNet, Roi};
pub use interpret::Tensor;
pub use irises::IrisNet;
pub use matting::PersonMatte;
pub use parse::Net;

/// What can go wrong with a network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetError {
    /// The bytes are not a TFLite model, or are cut short or damaged.
    #[error("not a sound TFLite model: {0}; run `heartian models install` to fetch a fresh copy")]
    Malformed(&'static str),
    /// The model uses something this interpreter does not implement.
    #[error("the TFLite model uses {0}, which this interpreter does not implement; install the pinned models instead")]
    Unsupported(String),
    /// A network's inputs contradict its layers.
    #[error("layer {layer} ({kind}): {reason}")]
    Shape {
        /// Number of the layer.
        layer: usize,
        /// Its kind.
        kind: &'static str,
        /// What contradicts what.
        reason: String,
    },
    /// The network is sound but is not the one expected here.
    #[error("the file is a TFLite model but not the {expected}: {reason}; run `heartian models install`")]
    WrongModel {
        /// Which model was expected.
        expected: &'static str,
        /// What differs.
        reason: String,
    },
}
