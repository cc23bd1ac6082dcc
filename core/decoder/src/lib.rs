//! Neural pulse decoders: TS-CAN, PhysFormer, FactorizePhys and PhysNet, run on the CPU from the published weight files.
//!
//! A [`Network`] is read from a `.pth` or `.safetensors` file ([`Network::load`]), says what it wants to be fed
//! ([`InputForm`]) and turns a [`Batch`] of frames into one sample a frame. Weight files are foreign: they are read within
//! bounds, pickles by an allow-list and never executed, and every disagreement with the architecture is an error that names
//! the tensor. Results are the same at any number of threads.

mod architecture;
mod attention;
pub mod bench;
mod clip;
mod error;
mod following;
mod input;
mod layer;
mod measurement;
mod nets;
mod network;
mod norm;
mod parts;
pub mod preprocess;
mod reader;
mod reading;
#[cfg(test)]
mod tests;
mod weights;

pub use architecture::Architecture;
pub use clip::{Averaged, ClipOptions, Cut, Find, read_clip};
pub use error::DecoderError;
pub use following::{Following, Looks, hand_on};
pub use input::{Batch, InputForm, Normalisation, Output};
pub use measurement::{Measured, measure};
pub use nets::factorizephys::standardised as standardised_batch;
pub use network::{Factorisation, Network, Options, SegmentEdge};
pub use reader::{Named, Reader, keys};
pub use reading::{Reading, Statistics, Wave};
pub use weights::{Tensor, Weights};
