//! The built-in recording: a procedural person before a camera, with everything known that a real recording hides.
//!
//! A head is drawn by the mesh renderer under a steady light while it sways, talks and blinks; blood modulates the red,
//! green and blue of its skin; a sensor adds noise and 8 bits. Positive pulse is more blood, so skin *darkens* where the
//! pulse is positive, as in nature. Equal options give equal bytes at any number of threads.

mod anatomy;
mod look;
mod material;
mod motion;
mod observe;
mod options;
mod physiology;
mod random;
mod scene;
mod score;
mod sensor;
#[cfg(test)]
mod tests;
mod truth;

use std::ops::ControlFlow;

use glam::Vec3;
use heartian_face::{FramePose, HeadModel, Observations, Track};
use heartian_space::{Camera, Clip, Progress, Sequence, Series};
use rayon::prelude::*;

pub use look::{Light, SkinTone};
pub use options::SyntheticOptions;
pub use score::TrackScores;
pub use truth::GroundTruth;

use crate::CaptureError;
use material::Materials;
use motion::Motion;
use physiology::{Heart, Physiology};
use random::{Random, Stream};
use scene::{Blood, Canvas, Frame, Scene};

/// Frames drawn between two reports of progress.
const CHUNK_FRAMES: usize = 16;
/// Where the head rests: 1 m away, lowered so that crown and neck fit the picture.
const REST_TRANSLATION: Vec3 = Vec3::new(0.0, 0.018, -1.0);
/// Focal length in picture widths: 0.36 m of the world fill the picture at the head's distance.
const FOCAL_WIDTHS: f32 = 2.75;
/// Spread of the person's identity coefficients: nearer the mean head than a random draw.
const IDENTITY_SPREAD: f64 = 0.7;

/// A recording and what a laboratory would know of it.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntheticRecording {
    /// The clip labelled `input`: straight colours with the background in them, and the matte.
    pub clip: Clip,
    /// The contact sensor's trace from 0 to the end of the clip.
    pub ppg: Series,
    /// Landmarks as a detector would report them.
    pub observations: Observations,
    /// What no estimator may see.
    pub truth: GroundTruth,
}

/// Makes a recording of the built-in head.
///
/// # Errors
/// [`CaptureError::Option`] or [`CaptureError::TooLarge`] for options out of range, [`CaptureError::Cancelled`] when
/// `progress` breaks.
pub fn generate(
    options: &SyntheticOptions,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<SyntheticRecording, CaptureError> {
    options.validate()?;
    Studio::new(HeadModel::procedural(), options, None).record(progress)
}

/// The same of a person whose blood follows a contact PPG, which is then the recording's; `heart_rate_bpm` and `hrv_ms`
/// have no say. The trace holds its end values where it does not reach.
///
/// # Errors
/// As [`generate`].
pub fn generate_with_pulse(
    options: &SyntheticOptions,
    ppg: &Series,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<SyntheticRecording, CaptureError> {
    options.validate()?;
    Studio::new(HeadModel::procedural(), options, Some(ppg)).record(progress)
}

/// A person, a light and a camera, ready to record.
struct Studio<'a> {
    options: &'a SyntheticOptions,
    head: HeadModel,
    identity: Vec<f32>,
    scene: Scene,
    physiology: Physiology,
    motion: Motion,
    times_seconds: Vec<f64>,
}

impl<'a> Studio<'a> {
    fn new(head: HeadModel, options: &'a SyntheticOptions, ppg: Option<&Series>) -> Self {
        let draw = Random::new(options.seed, Stream::Identity);
        let identity: Vec<f32> =
            (0..head.identity.count).map(|mode| (IDENTITY_SPREAD * draw.normal(mode as u64)) as f32).collect();
        let person = head.with_identity(&identity);
        let materials = Materials::new(&person, options.skin_tone, options.seed);
        let lighting = options.light.lighting().scaled(options.skin_tone.exposure());
        let camera = Camera::at_origin(options.size, options.size, FOCAL_WIDTHS * options.size as f32);
        let heart = Heart { rate_bpm: options.heart_rate_bpm, sdnn_ms: options.hrv_ms, seed: options.seed };
        Self {
            options,
            head,
            identity,
            scene: Scene::new(person, materials, lighting, camera, options.seed),
            physiology: match ppg {
                Some(ppg) => Physiology::new(heart, options.seconds).following(ppg),
                None => Physiology::new(heart, options.seconds),
            },
            motion: Motion::new(options.seed, options.seconds, options.motion),
            times_seconds: (0..options.frame_count()).map(|frame| frame as f64 / options.frames_per_second).collect(),
        }
    }

    fn record(self, progress: &mut dyn FnMut(Progress) -> ControlFlow<()>) -> Result<SyntheticRecording, CaptureError> {
        let poses: Vec<FramePose> = self.times_seconds.iter().map(|seconds| self.pose(*seconds)).collect();
        let total = poses.len() as u64;
        let mut frames: Vec<Frame> = Vec::with_capacity(poses.len());
        while frames.len() < poses.len() {
            if progress(Progress { step: frames.len() as u64, total, metric: None }).is_break() {
                return Err(CaptureError::Cancelled);
            }
            let range = frames.len()..(frames.len() + CHUNK_FRAMES).min(poses.len());
            frames.par_extend(
                range.into_par_iter().map_init(|| self.scene.canvas(), |canvas, t| self.draw(canvas, t, &poses[t])),
            );
        }
        let _ = progress(Progress { step: total, total, metric: None });
        self.deliver(poses, frames)
    }

    fn pose(&self, seconds: f64) -> FramePose {
        let count = self.head.expression.count;
        let (mut pose, gesture) = self.motion.pose(seconds, REST_TRANSLATION, count);
        pose.expression = gesture.coefficients(count);
        pose
    }

    fn draw(&self, canvas: &mut Canvas, frame: usize, pose: &FramePose) -> Frame {
        let seconds = self.times_seconds[frame];
        let pulse_at_delay = |delay: f32| self.physiology.pulse(seconds - f64::from(delay)) as f32;
        let blood = Blood { strength: self.options.pulse_strength as f32, pulse_at_delay: &pulse_at_delay };
        self.scene.draw(canvas, frame as u64, pose, &blood)
    }

    fn deliver(self, poses: Vec<FramePose>, frames: Vec<Frame>) -> Result<SyntheticRecording, CaptureError> {
        let size = self.options.size;
        let seconds = self.times_seconds.last().copied().unwrap_or(0.0);
        let sequence = Sequence {
            frames: frames.iter().flat_map(|frame| frame.colors.iter().copied()).collect(),
            alpha: frames.iter().flat_map(|frame| frame.alpha.iter().copied()).collect(),
            times_seconds: self.times_seconds.clone(),
        };
        let observations = observe::observations(&self.scene, (&frames, &poses), &self.times_seconds, self.options)?;
        let truth = GroundTruth {
            pulse: self.times_seconds.iter().map(|time| self.physiology.pulse(*time)).collect(),
            systolic_peaks_seconds: self.physiology.systolic_peaks_seconds(seconds),
            skin_mask: frames.iter().flat_map(|frame| frame.skin.iter().copied()).collect(),
            albedo_mean: self.scene.materials.mean_skin_albedo().to_array(),
            track: Track {
                interocular_px: observe::mean_interocular_px(&self.scene, &frames),
                landmark_rms_px: 0.0,
                head: self.head,
                identity: self.identity,
                camera: self.scene.camera,
                frames: poses,
                times_seconds: self.times_seconds,
                sigma: heartian_face::TrackSigma::default(),
            },
        };
        Ok(SyntheticRecording {
            clip: Clip::new("input", size, size, sequence)?,
            ppg: self.physiology.contact_trace(seconds)?,
            observations,
            truth,
        })
    }
}
