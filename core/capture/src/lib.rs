//! Video and data-set readers and writers, matting, and the synthetic recording with its mesh renderer.

mod crop;
pub mod dataset;
mod error;
pub mod export;
#[cfg(test)]
mod fuzz;
mod guard;
mod matte;
mod mesh;
mod observe;
pub mod overlay;
pub mod ppg;
pub mod real;
pub mod synthetic;
pub mod video;

pub use crop::{CropMotion, CropSquare};
pub use error::CaptureError;
pub use matte::{MatteSource, matte_clip, matte_iou, network_iou};
pub use observe::observe_clip;
