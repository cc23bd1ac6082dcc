//! Gaussians on a head: deformation, stage-1 fitting, density control, skin selection.

mod canonical;
mod color;
mod deform;
mod density;
mod eigen;
mod error;
mod initialise;
mod motion;
mod optimiser;
mod refine;
mod rig;
mod sample;
mod surface;

pub use canonical::{Canonical, Group};
pub use deform::{Deformed, Motion, MotionGradient, deform, deform_backward};
pub use error::AvatarError;
pub use motion::{FrameState, MotionModel};
pub use refine::RefineOptions;
pub use rig::{JOINTS, POSE_SIZE, Pose, Rig};
