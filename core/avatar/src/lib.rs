//! Gaussians on a head: deformation, stage-1 fitting, density control, skin selection, rendering.
//!
//! [`train`] makes an [`Avatar`] of a clip and its track; [`render_clip`] renders it on any track, under any light and
//! with an offset to the green albedo of some Gaussians; [`turntable`] shows it from the sides and [`bake`] gives it to
//! other programs; [`select_skin`] says which Gaussians are facial skin; and [`albedo_operator`] describes the render as a
//! linear map from those offsets to pixels.
//!
//! # What differs from HRAvatar (Zhang and others 2025), whose method stage 1 follows
//!
//! * Identity is baked in, and a motion basis is stored only when the tracked motion excites it (`motion.rs`): about 20 of
//!   the 36 numbers that are tracked. The baseline keeps 188 directions a Gaussian, 9.4 kB with its moments.
//! * The normal is the third axis, along which Gaussians start flat on the surface; the shortest axis jumps when two
//!   scales cross, and is arbitrary while Gaussians are still round. It is turned to the camera at the posed place, not at the rest place.
//! * Colours are composited in linear light and encoded at the edge. The light is radiance in spherical harmonics, with no
//!   sigmoid that ends at the albedo, filtered exactly; the baseline's solid angles are shifted by a texel and sum to
//!   1.08 times the sphere.
//! * Materials are divided by alpha before they shade, so silhouettes are not darkened twice.
//! * Focal lengths and principal point of the camera are used as they are; lengths are metres, so there is no free scale.
//! * Poses are refined frame by frame with a temporal prior instead of by an image encoder, whose batch statistics make
//!   its result depend on what else is in the batch; what that teaches is carried to frames outside training.
//! * Density control works under a budget, by what a Gaussian gives to any picture, and splits both small and large ones;
//!   the baseline's size limit splits nearly all, and its pruning by size never fires.
//! * What no frame saw is closed: the scalp is drawn out to the hair (`hull.rs`), and unseen Gaussians are held to the mesh
//!   and take the colours of seen ones (`ground.rs`). The baseline leaves holes and floaters there.
//! * Adam's guard is above the rounding of the gradients: at 1e-15 hidden Gaussians walk at random.

mod avatar;
mod bake;
pub mod blood;
mod canonical;
mod coherent;
mod color;
mod cost;
mod deform;
mod density;
mod device;
mod error;
mod evaluate;
mod frozen;
mod ground;
mod hull;
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
mod sight;
mod skin;
mod surface;
#[cfg(test)]
mod tests;
mod train;
mod turntable;

pub use avatar::Avatar;
pub use bake::{BakedPose, bake};
pub use canonical::{Canonical, Group};
pub use cost::{STAGES, state_bytes_per_gaussian, step_cost};
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
pub use turntable::{TurntableOptions, turntable};
