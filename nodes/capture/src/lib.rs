//! The nodes that see the face: frames with their matte and landmarks, and the head tracked through them.

mod flame_tracker;
mod frame_loader;

pub use flame_tracker::FlameTracker;
pub use frame_loader::FrameLoader;
