//! Containers that other programs write, read with bounded memory and without running anything of theirs.
//!
//! [`Archive`] takes members out of a zip no further than the caller allows; [`Pickle`] replays a pickle as plain
//! objects, knows only the names on the caller's allow-list and calls nothing; [`numpy`] finds arrays in such a pickle;
//! [`npy`] reads `.npy` and `.npz`. Every size in a file is a claim, checked before memory is taken.

mod archive;
mod element;
mod error;
pub mod npy;
pub mod numpy;
mod pickle;
#[cfg(test)]
mod tests;

pub use archive::Archive;
pub use element::Element;
pub use error::ForeignError;
pub use numpy::Array;
pub use pickle::{Id, Object, Pickle};
