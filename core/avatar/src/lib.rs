//! Gaussians on a head: deformation, stage-1 fitting, density control, skin selection, rendering.
//!
//! [`train`] makes an [`Avatar`] of a clip and its track; [`render_clip`] renders it on any track, under any light and
//! with an offset to the green albedo of some Gaussians; [`select_skin`] says which are facial skin; and
//! [`albedo_operator`] describes the render as a linear map from those offsets to pixels.

mod avatar;
pub mod blood;
mod canonical;
mod color;
mod deform;
mod density;
mod eigen;
mod error;
mod evaluate;
mod frozen;
mod initialise;
mod light;
mod linear;
mod motion;
mod operator;
mod optimiser;
mod perfusion;
#[cfg(test)]
mod phantom;
mod picture;
mod refine;
mod render;
mod rig;
mod sample;
mod skin;
mod surface;
#[cfg(test)]
mod tests;
mod train;

pub use avatar::Avatar;
pub use canonical::{Canonical, Group};
pub use deform::{Deformed, Motion, MotionGradient, deform, deform_backward};
pub use error::AvatarError;
pub use evaluate::{Score, evaluate};
pub use frozen::FrozenRender;
pub use motion::{FrameState, MotionModel};
pub use operator::{OperatorOptions, albedo_operator};
pub use perfusion::{PerfusionMap, perfusion};
pub use refine::RefineOptions;
pub use render::{RenderOptions, relight, render_clip};
pub use rig::{JOINTS, POSE_SIZE, Pose, Rig};
pub use skin::{SkinOptions, select_skin};
pub use train::{TrainOptions, TrainReport, train};
