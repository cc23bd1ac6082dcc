//! Gaussians on a head: deformation, stage-1 fitting, density control, skin selection.

mod canonical;
mod deform;
mod rig;

pub use canonical::{Canonical, Group};
pub use deform::{Deformed, Motion, MotionGradient, deform, deform_backward};
pub use rig::{JOINTS, POSE_SIZE, Pose, Rig};
