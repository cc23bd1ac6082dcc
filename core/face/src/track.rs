//! A fitted head: one identity and camera, and a pose per frame.
//!
//! Always holds after loading: as many frames as times, every pose finite, at most as many coefficients as the head's
//! bases have modes. Rotations are axis-angle, radians; translations metres; frames are those of the clip tracked.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};
use heartian_space::Camera;
use serde::{Deserialize, Serialize};

use crate::model::HeadModel;

/// The pose and expression of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FramePose {
    /// Rotation of `world_from_head`, axis-angle.
    pub rotation: [f32; 3],
    /// Translation of `world_from_head`, metres.
    pub translation: [f32; 3],
    /// Neck rotation relative to the root.
    pub neck: [f32; 3],
    /// Jaw rotation relative to the head; positive x opens.
    pub jaw: [f32; 3],
    /// Left and right eyeball rotation relative to the head.
    pub eyes: [[f32; 3]; 2],
    /// Expression coefficients.
    pub expression: Vec<f32>,
    /// Left and right lid, 0 = open as in the template, 1 = closed.
    pub eyelids: [f32; 2],
    /// Whether landmarks were seen in this frame; otherwise the pose is interpolated.
    pub fitted: bool,
}

impl FramePose {
    /// The rest pose at the origin of head space: posing with it leaves the template in place.
    pub fn rest(expression_count: usize) -> Self {
        Self {
            rotation: [0.0; 3],
            translation: [0.0; 3],
            neck: [0.0; 3],
            jaw: [0.0; 3],
            eyes: [[0.0; 3]; 2],
            expression: vec![0.0; expression_count],
            eyelids: [0.0; 2],
            fitted: false,
        }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let fixed = [self.rotation, self.translation, self.neck, self.jaw, self.eyes[0], self.eyes[1]];
        fixed.as_flattened().iter().chain(&self.expression).chain(&self.eyelids).all(|value| value.is_finite())
    }
}

/// What the tracker found in a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The model fitted, its identity *not* baked in.
    pub head: HeadModel,
    /// Identity coefficients, at most `head.identity.count`.
    pub identity: Vec<f32>,
    /// The clip's camera.
    pub camera: Camera,
    /// One pose a frame.
    pub frames: Vec<FramePose>,
    /// Frame times, seconds, as in the clip.
    pub times_seconds: Vec<f64>,
    /// Root mean square distance of observed and fitted landmarks over all fitted frames, without the face oval, pixels.
    pub landmark_rms_px: f64,
    /// Mean distance between the outer eye corners as the fitted model projects them, pixels.
    pub interocular_px: f64,
}

impl Track {
    /// The head with this track's identity baked in, ready to pose.
    pub fn baked_head(&self) -> HeadModel {
        self.head.with_identity(&self.identity)
    }
}

/// The poses as columns, the form in which they rest on disk.
#[derive(Serialize, Deserialize)]
struct Scalars {
    camera: Camera,
    landmark_rms_px: f64,
    interocular_px: f64,
}

impl Artifact for Track {
    const TYPE: ArtifactType = ArtifactType { name: "track", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let scalars =
            Scalars { camera: self.camera, landmark_rms_px: self.landmark_rms_px, interocular_px: self.interocular_px };
        self.head
            .add_to_bundle(Bundle::new())?
            .tensor("identity", &[self.identity.len()], &self.identity)?
            .tensor("times_seconds", &[self.times_seconds.len()], &self.times_seconds)?
            .meta("frames", &self.frames)?
            .meta("scalars", &scalars)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let head = HeadModel::from_reader(&reader)?;
        let Scalars { camera, landmark_rms_px, interocular_px } = reader.meta("scalars")?;
        let track = Track {
            identity: reader.tensor("identity")?.1,
            frames: reader.meta("frames")?,
            times_seconds: reader.tensor("times_seconds")?.1,
            head,
            camera,
            landmark_rms_px,
            interocular_px,
        };
        let invalid = |what: String| Err(ArtifactError::Invalid(format!("track: {what}")));
        if track.frames.len() != track.times_seconds.len() {
            return invalid(format!("{} frames and {} times", track.frames.len(), track.times_seconds.len()));
        }
        if track.identity.len() > track.head.identity.count {
            return invalid(format!(
                "{} identity coefficients for {}",
                track.identity.len(),
                track.head.identity.count
            ));
        }
        let modes = track.head.expression.count;
        if let Some(frame) = track.frames.iter().position(|pose| !pose.is_finite() || pose.expression.len() > modes) {
            return invalid(format!("the pose of frame {frame} is not finite or has more than {modes} expressions"));
        }
        Ok(track)
    }
}
