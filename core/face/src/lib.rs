//! Head models, linear blend skinning, landmark networks and the head tracker.
//!
//! Head space: metres, x toward the subject's left, y up, z out of the face, origin near the centre of the head. A
//! frontal face before the camera of our clips has `world_from_head` ≈ (identity, (0, 0, −1)).

mod eigen;
mod error;
mod heads;
mod irises;
mod model;
pub mod models;
pub mod nets;
mod observations;
mod procedural;
mod skinning;
mod steadiness;
mod track;
mod tracker;

pub use eigen::{Eigen, symmetric_eigen};
pub use error::FaceError;
pub use heads::HeadSource;
pub use irises::Iris;
pub use model::{Basis, HeadModel, JOINTS, LandmarkAnchor, Region, joint};
pub use observations::{Landmark, Observations};
pub use skinning::vertex_normals;
pub use track::{FramePose, Track, TrackSigma};
pub use tracker::{TrackOptions, track};
