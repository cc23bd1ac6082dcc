//! Video readers, matting, and the synthetic recording with its mesh renderer.

mod error;
mod mesh;
pub mod ppg;
pub mod synthetic;
pub mod video;

pub use error::CaptureError;
