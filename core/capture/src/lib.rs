//! Video readers, matting, and the synthetic recording with its mesh renderer.

mod mesh;
