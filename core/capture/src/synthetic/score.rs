//! A track against the truth of a synthetic recording.

use glam::Vec3;
use heartian_face::{FramePose, LandmarkAnchor, Track};

use super::GroundTruth;

/// A lid closed further than this is shut.
const SHUT: f32 = 0.5;
/// Frames by which a blink found may miss the true one.
const SLACK_FRAMES: usize = 1;

/// How near a track came to the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackScores {
    /// Mean angle between the true and the tracked rotation, degrees. Two head models disagree about what facing ahead
    /// means: with another model than the true one, the mean disagreement is taken out first.
    pub rotation_error_deg: f64,
    /// Root mean square distance of the fitted landmarks from the true ones, as a share of the distance between the eyes.
    pub landmark_error_fraction: f64,
    /// Pearson correlation of the jaw's opening; NaN when either jaw never moves.
    pub jaw_correlation: f64,
    /// F1 of blinks: runs of frames with both lids more than half shut that overlap, within one frame; 1 when there is no
    /// blink to find and none found.
    pub blink_f1: f64,
    /// F1 of frames with shut eyes.
    pub blink_frame_f1: f64,
    /// Pearson correlation of the eyes' yaw and pitch in frames with open eyes, their mean; NaN when the eyes found never move.
    pub gaze_correlation: f64,
}

impl GroundTruth {
    /// Scores a track of this recording; frames that one of both lacks are left out, frames without a face count as they
    /// were interpolated.
    pub fn score(&self, track: &Track) -> TrackScores {
        let pairs: Vec<(&FramePose, &FramePose)> = self.track.frames.iter().zip(&track.frames).collect();
        let opening = |pose: &FramePose| f64::from(pose.jaw[0]);
        let jaws: (Vec<f64>, Vec<f64>) = pairs.iter().map(|(a, b)| (opening(a), opening(b))).unzip();
        let shut: Vec<(bool, bool)> = pairs.iter().map(|(a, b)| (is_shut(a), is_shut(b))).collect();
        TrackScores {
            rotation_error_deg: rotation_error_deg(&pairs, self.track.head.name == track.head.name),
            landmark_error_fraction: landmark_error(&self.track, track),
            jaw_correlation: correlation(&jaws.0, &jaws.1),
            blink_f1: blink_f1(&shut),
            blink_frame_f1: {
                let hits = shut.iter().filter(|(a, b)| *a && *b).count();
                let misses = shut.iter().filter(|(a, b)| a != b).count();
                f1(hits, hits, misses)
            },
            gaze_correlation: gaze_correlation(&pairs),
        }
    }
}

/// Of both eyes' mean yaw and mean pitch.
fn gaze_correlation(pairs: &[(&FramePose, &FramePose)]) -> f64 {
    let open: Vec<_> = pairs.iter().filter(|(truth, _)| truth.eyelids[0] < SHUT).collect();
    let axis = |axis: usize| {
        let turn = |pose: &FramePose| f64::from(pose.eyes[0][axis] + pose.eyes[1][axis]);
        let (a, b): (Vec<f64>, Vec<f64>) = open.iter().map(|(truth, found)| (turn(truth), turn(found))).unzip();
        correlation(&a, &b)
    };
    0.5 * (axis(0) + axis(1))
}

fn is_shut(pose: &FramePose) -> bool {
    0.5 * (pose.eyelids[0] + pose.eyelids[1]) > SHUT
}

fn rotation_error_deg(pairs: &[(&FramePose, &FramePose)], same_head: bool) -> f64 {
    let turn = |pose: &FramePose| glam::DQuat::from_scaled_axis(glam::DVec3::from_array(pose.rotation.map(f64::from)));
    let count = pairs.len().max(1) as f64;
    // The tracked head's frame seen from the true one's.
    let offsets: Vec<glam::DVec3> =
        pairs.iter().map(|(truth, found)| (turn(truth).inverse() * turn(found)).to_scaled_axis()).collect();
    let mean = if same_head { glam::DVec3::ZERO } else { offsets.iter().sum::<glam::DVec3>() / count };
    let common = glam::DQuat::from_scaled_axis(mean);
    let error = |offset: &glam::DVec3| {
        (glam::DQuat::from_scaled_axis(*offset) * common.inverse()).to_scaled_axis().length().to_degrees()
    };
    offsets.iter().map(error).sum::<f64>() / count
}

/// Root mean square distance between fitted and true landmarks that both heads know, as a share of the distance between
/// the outer eye corners.
fn landmark_error(truth: &Track, found: &Track) -> f64 {
    let heads = [truth.baked_head(), found.baked_head()];
    let (mut sum, mut count) = (0.0, 0u64);
    for (a, b) in truth.frames.iter().zip(&found.frames) {
        let vertices = [heads[0].pose(a), heads[1].pose(b)];
        for one in &heads[0].landmarks {
            let Ok(k) = heads[1].landmarks.binary_search_by_key(&one.index, |anchor| anchor.index) else { continue };
            let other = &heads[1].landmarks[k];
            let pixel = |side: usize, track: &Track, anchor: &LandmarkAnchor| {
                track.camera.project(Vec3::from_array(heads[side].landmark_position(anchor, &vertices[side])))
            };
            if let (Some(p), Some(q)) = (pixel(0, truth, one), pixel(1, found, other)) {
                sum += f64::from(p.distance_squared(q));
                count += 1;
            }
        }
    }
    (sum / count.max(1) as f64).sqrt() / truth.interocular_px
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len().max(1) as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(x, y)| f(x - mean_a, y - mean_b)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

/// Blinks as frame ranges; true and found ones that overlap are hits.
fn blink_f1(shut: &[(bool, bool)]) -> f64 {
    let truth = runs(shut.iter().map(|pair| pair.0));
    let found = runs(shut.iter().map(|pair| pair.1));
    let overlap = |a: &[usize; 2], b: &[usize; 2]| a[0] <= b[1] + SLACK_FRAMES && b[0] <= a[1] + SLACK_FRAMES;
    let seen = truth.iter().filter(|blink| found.iter().any(|other| overlap(blink, other))).count();
    let right = found.iter().filter(|blink| truth.iter().any(|other| overlap(blink, other))).count();
    f1(seen, right, truth.len() - seen + found.len() - right)
}

/// `2·hits / (2·hits + misses)` with the hits counted from both sides.
fn f1(seen: usize, right: usize, wrong: usize) -> f64 {
    let hits = seen + right;
    if hits + wrong == 0 { 1.0 } else { hits as f64 / (hits + wrong) as f64 }
}

/// First and last index of every run of `true`.
fn runs(values: impl Iterator<Item = bool>) -> Vec<[usize; 2]> {
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for (index, _) in values.enumerate().filter(|(_, value)| *value) {
        match runs.last_mut() {
            Some(run) if run[1] + 1 == index => run[1] = index,
            _ => runs.push([index, index]),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blinks_are_counted_as_events_and_none_at_all_is_right() {
        let blinks = |found: &[usize]| {
            let shut: Vec<(bool, bool)> = (0..40).map(|t| ([5, 6, 20, 21].contains(&t), found.contains(&t))).collect();
            blink_f1(&shut)
        };
        assert_eq!(blinks(&[5, 6, 20, 21]), 1.0);
        assert_eq!(blinks(&[7, 21]), 1.0, "one frame late is the same blink");
        assert_eq!(blinks(&[5, 6]), 2.0 / 3.0);
        assert_eq!(blinks(&[5, 20, 30]), 0.8);
        assert_eq!(blink_f1(&[(false, false); 9]), 1.0);
    }

    #[test]
    fn correlation_is_one_for_any_scale_and_undefined_for_a_still_jaw() {
        assert!((correlation(&[0.0, 1.0, 3.0], &[5.0, 7.0, 11.0]) - 1.0).abs() < 1e-12);
        assert!(correlation(&[1.0, 1.0], &[0.0, 2.0]).is_nan());
    }

    #[test]
    fn a_constant_offset_counts_only_between_equal_heads() {
        let pose = |y: f32| FramePose { rotation: [0.0, y, 0.0], ..FramePose::rest(0) };
        let poses: Vec<(FramePose, FramePose)> =
            (0..9).map(|t| (pose(0.1 * t as f32), pose(0.1 * t as f32 + 0.05))).collect();
        let pairs: Vec<(&FramePose, &FramePose)> = poses.iter().map(|(a, b)| (a, b)).collect();
        assert!((rotation_error_deg(&pairs, true) - 0.05_f64.to_degrees()).abs() < 1e-3);
        assert!(rotation_error_deg(&pairs, false) < 1e-3);
    }
}
