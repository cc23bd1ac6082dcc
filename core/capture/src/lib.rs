//! Video readers, matting, and the synthetic recording with its mesh renderer.

mod error;
mod mesh;
pub mod synthetic;

pub use error::CaptureError;
