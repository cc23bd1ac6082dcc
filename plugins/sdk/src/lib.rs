//! Write nodes for Heartian in safe Rust, as a shared library of your own.
//!
//! A node is a struct whose fields are its parameters ([`params!`]), a [`Node`] impl that names its ports and does the
//! work, and one [`export!`] line for the library:
//!
//! ```
//! use heartian_plugin::{Call, Error, Inputs, Node, Outputs, Port, export, params};
//!
//! params! {
//!     /// Adds a byte to the end of what it is given.
//!     pub struct Append {
//!         /// Which byte.
//!         byte: u8 = 33;
//!     }
//! }
//!
//! impl Node for Append {
//!     const KIND: &'static str = "Append";
//!     const REVISION: u32 = 1;
//!     const INPUTS: &'static [Port] = &[Port::many("in", "org.example.bytes/1", "What to join.").optional()];
//!     const OUTPUTS: &'static [Port] = &[Port::one("out", "org.example.bytes/1", "All of it, and the byte.")];
//!
//!     fn run(&self, inputs: &Inputs<'_>, _: &Call) -> Result<Outputs, Error> {
//!         let mut bytes: Vec<u8> = inputs.many("in").flat_map(|input| input.bytes).copied().collect();
//!         bytes.push(self.byte);
//!         Ok(Outputs::new().put("out", bytes))
//!     }
//! }
//!
//! export!(Append);
//! # fn main() {}
//! ```
//!
//! Set `crate-type = ["cdylib"]`, build, and `heartian run graph.ron --plugin target/release/libNAME.so`. The house's own
//! types (`clip/1`, `traces/1`, `metrics/1`, …) are safetensors files: read them with [`Input::bundle`], write them with
//! [`Outputs::put_bundle`]. A panic fails the node, and nothing else.

#[cfg(test)]
extern crate self as heartian_plugin;

mod call;
#[doc(hidden)]
pub mod entry;
mod node;
mod params;

pub use call::{Call, Error, Input, Inputs, Outputs};
pub use heartian_artifact::{ArtifactError, Bundle, BundleReader};
pub use node::{Kind, Node, Port};
pub use params::{ParamDoc, ParamType, Params};

#[doc(hidden)]
pub use {heartian_plugin_abi as abi, serde};

/// The page for strangers: its example must compile.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
