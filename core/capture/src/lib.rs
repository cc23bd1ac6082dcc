//! Video readers and writers, matting, and the synthetic recording with its mesh renderer.

mod crop;
mod error;
pub mod export;
mod matte;
mod mesh;
mod observe;
pub mod ppg;
pub mod real;
pub mod synthetic;
pub mod video;

pub use crop::CropSquare;
pub use error::CaptureError;
pub use observe::observe_clip;
