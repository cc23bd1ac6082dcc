//! What is known of a synthetic recording and must stay hidden from every estimator.
//!
//! Always holds: as many pulse values as frames, and a skin mask of whole bytes a frame.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};
use heartian_face::Track;

/// Ground truth of a synthetic recording; artifact type `truth`.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// The true head, camera and poses. `landmark_rms_px` is 0: nothing was fitted.
    pub track: Track,
    /// `T` values of the blood-volume pulse at the frame times, height 1 from trough to peak, positive = more blood.
    pub pulse: Vec<f64>,
    /// Systolic peaks in the face, seconds.
    pub systolic_peaks_seconds: Vec<f64>,
    /// `T × ⌈H·W/8⌉`, lowest bit first: pixels that are mostly pulsatile skin.
    pub skin_mask: Vec<u8>,
    /// Mean albedo of facial skin without pulse, linear RGB.
    pub albedo_mean: [f32; 3],
}

impl GroundTruth {
    /// Whether a pixel (`y·W + x`) of a frame is mostly pulsatile skin; false outside.
    pub fn is_skin(&self, frame: usize, pixel: usize) -> bool {
        let (pixels, bytes) = (self.pixels(), self.pixels().div_ceil(8));
        pixel < pixels && self.skin_mask.get(frame * bytes + pixel / 8).is_some_and(|byte| byte >> (pixel % 8) & 1 == 1)
    }

    fn pixels(&self) -> usize {
        self.track.camera.width * self.track.camera.height
    }
}

impl Artifact for GroundTruth {
    const TYPE: ArtifactType = ArtifactType { name: "truth", version: 2 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let frames = self.pulse.len();
        self.track
            .to_bundle()?
            .tensor("pulse", &[frames], &self.pulse)?
            .tensor("systolic_peaks_seconds", &[self.systolic_peaks_seconds.len()], &self.systolic_peaks_seconds)?
            .tensor("skin_mask", &[frames, self.pixels().div_ceil(8)], &self.skin_mask)?
            .tensor("albedo_mean", &[3], &self.albedo_mean)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let pulse: Vec<f64> = reader.tensor("pulse")?.1;
        let systolic_peaks_seconds = reader.tensor("systolic_peaks_seconds")?.1;
        let (mask_shape, skin_mask) = reader.tensor::<u8>("skin_mask")?;
        let albedo: Vec<f32> = reader.shaped("albedo_mean", &[Some(3)])?;
        let track = Track::from_bundle(reader)?;
        let bytes = (track.camera.width * track.camera.height).div_ceil(8);
        if pulse.len() != track.frames.len() || mask_shape != [pulse.len(), bytes] {
            let reason =
                format!("truth: {} poses, {} pulse values, mask {mask_shape:?}", track.frames.len(), pulse.len());
            return Err(ArtifactError::Invalid(reason));
        }
        let albedo_mean = [albedo[0], albedo[1], albedo[2]];
        Ok(Self { track, pulse, systolic_peaks_seconds, skin_mask, albedo_mean })
    }
}
