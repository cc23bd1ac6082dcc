//! The avatar as it travels between nodes: canonical Gaussians, how they move, the light they were seen under, and the
//! poses they were fitted with.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};
use heartian_face::{FramePose, Track};
use heartian_space::Camera;
use heartian_splat::{Environment, RADIANCE_COEFFICIENTS};

use crate::AvatarError;
use crate::canonical::Canonical;
use crate::motion::{FrameState, MotionModel};
use crate::rig::{JOINTS, POSE_SIZE, Rig};

/// A relightable head of one person.
///
/// Always holds: the arrays of `canonical` agree and are finite, its bases answer to the coefficients of `motion`, and
/// there are as many states as times.
#[derive(Clone, Debug, PartialEq)]
pub struct Avatar {
    /// The Gaussians in neutral head space.
    pub canonical: Canonical,
    /// From tracked poses to joints and motion coefficients.
    pub motion: MotionModel,
    /// The light of the recording.
    pub environment: Environment,
    /// The camera of the recording.
    pub camera: Camera,
    /// Poses of the recording's frames: refined for training frames, corrected globally for the others.
    pub states: Vec<FrameState>,
    /// Frame times of the recording, seconds.
    pub times_seconds: Vec<f64>,
    /// The first so many frames were trained on; the rest are held out.
    pub training_frames: usize,
}

impl Avatar {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.canonical.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.canonical.is_empty()
    }

    /// The states to render a track with: those of the recording when the track is the one the avatar was fitted to
    /// (same frame times), otherwise what the track says.
    ///
    /// # Errors
    /// When the track has no frame, a pose is not finite or has another number of expression coefficients.
    pub fn states_for(&self, track: &Track) -> Result<Vec<FrameState>, AvatarError> {
        if track.frames.is_empty() {
            let remedy = "give a track of a clip with at least one frame";
            return Err(AvatarError::TooLittle { what: "the track has no frame", found: 0, remedy });
        }
        if let Some(frame) = track.frames.iter().position(|pose| !pose.is_finite()) {
            return Err(AvatarError::PoseNotFinite { frame });
        }
        if track.head.expression.count != self.motion.expression_count {
            return Err(AvatarError::Mismatch {
                what: "expression coefficients of the track's head model",
                expected: self.motion.expression_count.to_string(),
                found: track.head.expression.count.to_string(),
            });
        }
        if track.times_seconds == self.times_seconds {
            return Ok(self.states.clone());
        }
        Ok(track.frames.iter().map(|pose: &FramePose| self.motion.state(pose)).collect())
    }
}

/// Names of the canonical groups on disk, in the order of [`crate::Group`].
const GROUP_NAMES: [&str; 9] = [
    "positions",
    "log_scales",
    "rotations",
    "opacity_logits",
    "albedo_logits",
    "roughness_logits",
    "reflectance_logits",
    "bases",
    "weights",
];

impl Artifact for Avatar {
    const TYPE: ArtifactType = ArtifactType { name: "avatar", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let count = self.canonical.len();
        let mut bundle = Bundle::new();
        for ((name, values), width) in GROUP_NAMES.iter().zip(self.canonical.groups()).zip(self.canonical.widths()) {
            bundle = bundle.tensor(name, &[count, width], values)?;
        }
        let width = self.motion.origin.len();
        let poses: Vec<_> = self.states.iter().map(|state| state.pose).collect();
        let coefficients: Vec<_> = self.states.iter().map(|state| &state.coefficients).collect();
        bundle
            .tensor("motion.matrix", &[self.motion.modes(), width], &self.motion.matrix)?
            .tensor("motion.origin", &[width], &self.motion.origin)?
            .tensor("motion.range", &[self.motion.range.len(), 2], self.motion.range.as_flattened())?
            .tensor("times_seconds", &[self.times_seconds.len()], &self.times_seconds)?
            .meta("motion.joints", &self.motion.rig.joints)?
            .meta("motion.expression_count", &self.motion.expression_count)?
            .meta("environment", &self.environment)?
            .meta("camera", &self.camera)?
            .meta("states.poses", &poses)?
            .meta("states.coefficients", &coefficients)?
            .meta("training_frames", &self.training_frames)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let mut canonical = Canonical { modes: 0, ..Canonical::default() };
        let (shape, _) = reader.tensor::<f32>("bases")?;
        canonical.modes = shape.get(1).copied().unwrap_or(0) / 3;
        let widths = canonical.widths();
        for ((name, group), width) in GROUP_NAMES.iter().zip(canonical.groups_mut()).zip(widths) {
            *group = reader.shaped(name, &[None, Some(width)])?;
        }
        let joints: [[f64; 3]; JOINTS] = reader.meta("motion.joints")?;
        let motion = MotionModel {
            rig: Rig { joints },
            expression_count: reader.meta("motion.expression_count")?,
            matrix: reader.tensor("motion.matrix")?.1,
            origin: reader.tensor("motion.origin")?.1,
            range: reader.shaped::<f32>("motion.range", &[None, Some(2)])?.as_chunks::<2>().0.to_vec(),
        };
        let poses: Vec<[f64; POSE_SIZE]> = reader.meta("states.poses")?;
        let coefficients: Vec<Vec<f32>> = reader.meta("states.coefficients")?;
        let states =
            poses.into_iter().zip(coefficients).map(|(pose, coefficients)| FrameState { pose, coefficients }).collect();
        let avatar = Self {
            canonical,
            motion,
            environment: reader.meta("environment")?,
            camera: reader.meta("camera")?,
            states,
            times_seconds: reader.tensor("times_seconds")?.1,
            training_frames: reader.meta("training_frames")?,
        };
        avatar.check().map_err(|reason| ArtifactError::Invalid(format!("avatar: {reason}")))?;
        Ok(avatar)
    }
}

impl Avatar {
    fn check(&self) -> Result<(), String> {
        if !self.canonical.is_consistent() {
            return Err("its arrays describe different numbers of Gaussians".into());
        }
        if let Some(index) = self.canonical.first_not_finite() {
            return Err(format!("Gaussian {index} has a value that is not finite"));
        }
        let numbers =
            self.motion.matrix.iter().chain(&self.motion.origin).chain(self.environment.radiance.iter().flatten());
        let finite =
            numbers.chain(self.states.iter().flat_map(|state| &state.coefficients)).all(|value| value.is_finite());
        if !finite || !self.states.iter().flat_map(|state| state.pose).all(f64::is_finite) {
            return Err("its motion, light or poses hold a value that is not finite".into());
        }
        let modes = self.motion.modes();
        let ordered = self.motion.range.len() == modes && self.motion.range.iter().all(|[least, most]| least <= most);
        if self.motion.origin.len() != self.motion.width() || modes != self.canonical.modes || !ordered {
            return Err("its bases do not answer to its motion coefficients".into());
        }
        if self.environment.radiance.len() != RADIANCE_COEFFICIENTS {
            return Err(format!(
                "its light has {} coefficients, not {RADIANCE_COEFFICIENTS}",
                self.environment.radiance.len()
            ));
        }
        let modes = self.canonical.modes;
        let whole = self.states.len() == self.times_seconds.len()
            && self.states.iter().all(|state| state.coefficients.len() == modes);
        if !whole || self.training_frames > self.states.len() {
            return Err("its poses do not match its frame times".into());
        }
        Ok(())
    }
}
