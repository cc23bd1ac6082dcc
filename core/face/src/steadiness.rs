//! How steady a track is: what remains of the head's turning when the head itself is still.

use glam::{DQuat, DVec3};

use crate::track::{FramePose, Track};

/// Half of the time over which a head is judged still, seconds.
const HALF_WINDOW_SECONDS: f64 = 0.25;
/// A still head turns by less than this over the whole window, degrees.
const STILL_DEG: f64 = 0.6;

impl Track {
    /// Root mean square of the second difference of the head's rotation over frames at which the head is still, degrees;
    /// NaN without such a frame. A frame is still when the mean rotations of the quarter seconds before and after it
    /// differ by less than 0.6°; it and its neighbours must have been fitted.
    pub fn jitter_deg_rms(&self) -> f64 {
        let rotations: Vec<DQuat> = self.frames.iter().map(rotation).collect();
        let (mut sum, mut count) = (0.0, 0u64);
        for t in 1..self.frames.len().saturating_sub(1) {
            let fitted = self.frames[t - 1..=t + 1].iter().all(|frame| frame.fitted);
            if fitted && self.is_still(&rotations, t) {
                let step = |a: DQuat, b: DQuat| (b * a.inverse()).to_scaled_axis();
                let second = step(rotations[t], rotations[t + 1]) - step(rotations[t - 1], rotations[t]);
                sum += second.length_squared();
                count += 1;
            }
        }
        (sum / count as f64).sqrt().to_degrees()
    }

    fn is_still(&self, rotations: &[DQuat], t: usize) -> bool {
        let times = &self.times_seconds;
        let from = times.partition_point(|time| *time < times[t] - HALF_WINDOW_SECONDS);
        let to = times.partition_point(|time| *time <= times[t] + HALF_WINDOW_SECONDS);
        if to - from < 3 {
            return false;
        }
        let about = rotations[t];
        let mean = |range: std::ops::Range<usize>| -> DVec3 {
            let count = range.len().max(1) as f64;
            range.map(|k| (rotations[k] * about.inverse()).to_scaled_axis()).sum::<DVec3>() / count
        };
        mean(t + 1..to).distance(mean(from..t)).to_degrees() < STILL_DEG
    }
}

fn rotation(pose: &FramePose) -> DQuat {
    DQuat::from_scaled_axis(DVec3::from_array(pose.rotation.map(f64::from)))
}

#[cfg(test)]
mod tests {
    use heartian_space::Camera;

    use super::*;
    use crate::{HeadModel, TrackSigma};

    fn track(angle: impl Fn(usize) -> f64) -> Track {
        let frames: Vec<FramePose> = (0..120)
            .map(|t| FramePose { rotation: [0.0, angle(t) as f32, 0.0], fitted: true, ..FramePose::rest(0) })
            .collect();
        Track {
            head: HeadModel::procedural(),
            identity: Vec::new(),
            camera: Camera::at_origin(64, 64, 100.0),
            times_seconds: (0..frames.len()).map(|t| t as f64 / 30.0).collect(),
            sigma: TrackSigma::default(),
            frames,
            landmark_rms_px: 0.0,
            interocular_px: 0.0,
        }
    }

    #[test]
    fn a_trembling_head_has_the_jitter_it_was_given_and_a_turning_head_is_left_out() {
        let tremble = track(|t| if t % 2 == 0 { 0.001 } else { -0.001 });
        assert!((tremble.jitter_deg_rms() - 0.004_f64.to_degrees()).abs() < 1e-5, "{}", tremble.jitter_deg_rms());
        let turning = track(|t| 0.02 * t as f64 + if t % 2 == 0 { 0.001 } else { -0.001 });
        assert!(turning.jitter_deg_rms().is_nan());
        assert_eq!(track(|_| 0.3).jitter_deg_rms(), 0.0);
    }
}
