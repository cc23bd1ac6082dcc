//! What a landmark detector would report: true projections with correlated noise, doubts and dropouts; and the centres of
//! the irises while the lids are open.

use glam::{Vec2, Vec3};
use heartian_face::{FramePose, Landmark, Observations};

use super::options::SyntheticOptions;
use super::random::{Random, Stream};
use super::scene::{Frame, Scene};
use crate::CaptureError;

/// Correlation of a landmark's error from one frame to the next.
const CORRELATION: f64 = 0.5;
/// Chance that a landmark is missing in a frame.
const POINT_DROPOUT: f64 = 0.01;
/// Chance that the detector misses the face in a frame; never in the first, which starts every tracker.
const FRAME_DROPOUT: f64 = 0.006;
/// Centres of the left and of the right iris, MediaPipe indices.
const IRISES: [u32; 2] = [473, 468];
/// A lid closed further than this hides the iris.
const HIDDEN: f32 = 0.6;
/// Outer eye corners, MediaPipe indices.
const EYE_CORNERS: [u32; 2] = [33, 263];

/// The observations of all frames.
pub(crate) fn observations(
    scene: &Scene,
    (frames, poses): (&[Frame], &[FramePose]),
    times_seconds: &[f64],
    options: &SyntheticOptions,
) -> Result<Observations, CaptureError> {
    let dropouts = Random::new(options.seed, Stream::Dropouts);
    let count = scene.head.landmarks.len();
    let mut errors: Vec<Vec2> = Vec::new();
    let mut seen = Vec::with_capacity(frames.len());
    for (number, frame) in frames.iter().enumerate() {
        errors = next_errors(&errors, count + IRISES.len(), options, number);
        let in_frame = dropouts.substream(number as u64);
        if number > 0 && in_frame.uniform(0) < FRAME_DROPOUT {
            seen.push(None);
            continue;
        }
        let landmarks = scene
            .head
            .landmarks
            .iter()
            .zip(frame.landmarks.iter().zip(&errors))
            .filter(|(anchor, (found, _))| {
                found.0.is_finite() && in_frame.uniform(1 + u64::from(anchor.index)) >= POINT_DROPOUT
            })
            .map(|(anchor, ((position_px, confidence), error))| Landmark {
                index: anchor.index,
                position_px: (*position_px + *error).to_array(),
                weight: *confidence,
            })
            .chain(irises(scene, &poses[number], &errors[count..]))
            .collect();
        seen.push(Some(landmarks));
    }
    let size = options.size;
    Ok(Observations::new(size, size, times_seconds.to_vec(), seen)?)
}

/// The irises' centres that no lid hides.
fn irises<'a>(scene: &'a Scene, pose: &'a FramePose, errors: &'a [Vec2]) -> impl Iterator<Item = Landmark> + 'a {
    scene.head.irises(pose).into_iter().enumerate().filter_map(|(eye, iris)| {
        let pixel = scene.camera.project(Vec3::from_array(iris?.centre))? + errors[eye];
        (pose.eyelids[eye] <= HIDDEN).then(|| Landmark {
            index: IRISES[eye],
            position_px: pixel.to_array(),
            weight: 1.0 - pose.eyelids[eye],
        })
    })
}

/// A first-order autoregression of unit memory [`CORRELATION`], started in its stationary state.
fn next_errors(before: &[Vec2], count: usize, options: &SyntheticOptions, frame: usize) -> Vec<Vec2> {
    let random = Random::new(options.seed, Stream::Landmarks).substream(frame as u64);
    let fresh =
        options.landmark_noise_px * if before.is_empty() { 1.0 } else { (1.0 - CORRELATION * CORRELATION).sqrt() };
    (0..count)
        .map(|landmark| {
            let draw = |axis: u64| (fresh * random.normal(2 * landmark as u64 + axis)) as f32;
            let old = before.get(landmark).copied().unwrap_or(Vec2::ZERO);
            old * CORRELATION as f32 + Vec2::new(draw(0), draw(1))
        })
        .collect()
}

/// Mean distance between the outer eye corners, pixels; 0 when the model does not anchor them.
pub(crate) fn mean_interocular_px(scene: &Scene, frames: &[Frame]) -> f64 {
    let position = |index: u32| scene.head.landmarks.iter().position(|anchor| anchor.index == index);
    let [Some(right), Some(left)] = EYE_CORNERS.map(position) else {
        return 0.0;
    };
    let sum: f64 = frames.iter().map(|f| f64::from(f.landmarks[right].0.distance(f.landmarks[left].0))).sum();
    sum / frames.len().max(1) as f64
}
