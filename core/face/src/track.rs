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
    /// Neck rotation relative to the root. The tracker leaves it 0: landmarks show only its sum with `rotation`.
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

/// How sure a track is of each frame: standard deviations, a row a frame, or no rows where they are not known. They are of a
/// frame's pose against the other frames'; an error that all frames share, such as which pose counts as facing ahead, is
/// not in them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrackSigma {
    /// Of the head's turn about the camera's x, y and z axes, degrees.
    pub rotation_deg: Vec<[f32; 3]>,
    /// Of the head's place along the camera's axes, millimetres; z is the distance.
    pub translation_mm: Vec<[f32; 3]>,
    /// Of the jaw's opening, degrees.
    pub jaw_deg: Vec<f32>,
    /// Of the left and the right lid, in units of [`FramePose::eyelids`].
    pub eyelids: Vec<[f32; 2]>,
    /// Of the focal length, percent of it; `None` where it is not known.
    pub focal_percent: Option<f32>,
}

impl TrackSigma {
    /// Standard deviation of a frame's turn about any axis, degrees: of all three together; NaN where it is not known.
    pub fn turn_deg(&self, frame: usize) -> f64 {
        let own = self.rotation_deg.get(frame).copied().unwrap_or([f32::NAN; 3]);
        own.map(|sigma| f64::from(sigma).powi(2)).iter().sum::<f64>().sqrt()
    }

    /// Median over the frames of [`TrackSigma::turn_deg`]; NaN where it is not known.
    pub fn median_turn_deg(&self) -> f64 {
        let mut all: Vec<f64> = (0..self.rotation_deg.len()).map(|frame| self.turn_deg(frame)).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
    }

    /// Whether there are rows for so many frames, or none, and every number is finite and none negative.
    fn is_sound(&self, frames: usize) -> bool {
        let rows = [self.rotation_deg.len(), self.translation_mm.len(), self.jaw_deg.len(), self.eyelids.len()];
        let columns = [
            self.rotation_deg.as_flattened(),
            self.translation_mm.as_flattened(),
            &self.jaw_deg,
            self.eyelids.as_flattened(),
        ];
        (rows == [frames; 4] || rows == [0; 4])
            && self.focal_percent.is_none_or(|value| value.is_finite() && value >= 0.0)
            && columns.into_iter().flatten().all(|value| value.is_finite() && *value >= 0.0)
    }

    fn add_to_bundle<'a>(&'a self, bundle: Bundle<'a>) -> Result<Bundle<'a>, ArtifactError> {
        let frames = self.jaw_deg.len();
        bundle
            .tensor("sigma.rotation_deg", &[frames, 3], self.rotation_deg.as_flattened())?
            .tensor("sigma.translation_mm", &[frames, 3], self.translation_mm.as_flattened())?
            .tensor("sigma.jaw_deg", &[frames], &self.jaw_deg)?
            .tensor("sigma.eyelids", &[frames, 2], self.eyelids.as_flattened())?
            .meta("sigma.focal_percent", &self.focal_percent)
    }

    fn from_reader(reader: &BundleReader<'_>) -> Result<Self, ArtifactError> {
        let triples = |name: &str| -> Result<Vec<[f32; 3]>, ArtifactError> {
            Ok(reader.shaped::<f32>(name, &[None, Some(3)])?.as_chunks::<3>().0.to_vec())
        };
        Ok(Self {
            rotation_deg: triples("sigma.rotation_deg")?,
            translation_mm: triples("sigma.translation_mm")?,
            jaw_deg: reader.shaped("sigma.jaw_deg", &[None])?,
            eyelids: reader.shaped::<f32>("sigma.eyelids", &[None, Some(2)])?.as_chunks::<2>().0.to_vec(),
            focal_percent: reader.meta("sigma.focal_percent")?,
        })
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
    /// How sure each frame is.
    pub sigma: TrackSigma,
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
    const TYPE: ArtifactType = ArtifactType { name: "track", version: 2 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let scalars =
            Scalars { camera: self.camera, landmark_rms_px: self.landmark_rms_px, interocular_px: self.interocular_px };
        self.sigma
            .add_to_bundle(self.head.add_to_bundle(Bundle::new())?)?
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
            sigma: TrackSigma::from_reader(&reader)?,
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
        if !track.sigma.is_sound(track.frames.len()) {
            return invalid(format!("the standard deviations are not {} rows of sound numbers", track.frames.len()));
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
