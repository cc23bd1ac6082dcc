//! A turntable: the head turned from side to side before a still camera, under the light of the recording or another.
//!
//! The head starts frontal, turns to one side, back through the front to the other and home again, as a sine, so that the
//! clip loops. Everything else is held at one frame of the recording, the motion coefficients too: they are learned over
//! the poses of the recording, and a corrective driven far beyond them would tell more of extrapolation than of the head.

use glam::{DMat3, DQuat, DVec3};
use heartian_space::Clip;
use heartian_splat::Environment;

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::motion::FrameState;
use crate::render::{RenderOptions, render_states};
use crate::rig::rotation;

/// What is turned, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurntableOptions {
    /// Farthest turn to either side, degrees, 0 to 180.
    pub most_degrees: f64,
    /// Length of the clip, seconds, above 0.
    pub seconds: f64,
    /// Frame rate, hertz, above 0.
    pub frames_per_second: f64,
    /// Side of the square picture instead of the recording's size, pixels.
    pub size: Option<usize>,
    /// The frame of the recording whose expression is shown; without, the most frontal and calmest one.
    pub frame: Option<usize>,
}

impl Default for TurntableOptions {
    fn default() -> Self {
        Self { most_degrees: 60.0, seconds: 4.0, frames_per_second: 25.0, size: None, frame: None }
    }
}

/// Most frames of a turntable.
const MOST_FRAMES: f64 = 10_000.0;

/// Renders the turntable, labelled `turntable`.
///
/// # Errors
/// When an option is out of range, or the frame does not exist.
pub fn turntable(
    avatar: &Avatar,
    environment: Option<&Environment>,
    options: &TurntableOptions,
) -> Result<Clip, AvatarError> {
    let TurntableOptions { most_degrees, seconds, frames_per_second, size, frame } = *options;
    let frames = (seconds * frames_per_second).round();
    let in_range = [
        ("most_degrees", most_degrees, 0.0, 180.0, "0 to 180"),
        ("frames_per_second", frames_per_second, 0.1, 1000.0, "0.1 to 1000"),
        ("seconds", frames, 1.0, MOST_FRAMES, "long enough for 1 and short enough for 10000 frames"),
    ];
    for (name, value, low, high, range) in in_range {
        if !(low..=high).contains(&value) {
            return Err(AvatarError::Option { name, value, range });
        }
    }
    let base = match frame {
        None => calmest(avatar)?,
        Some(index) => avatar.states.get(index).ok_or(AvatarError::Index {
            what: "the turntable's frame",
            index,
            count: avatar.states.len(),
        })?,
    };
    let frames = frames as usize;
    let states: Vec<FrameState> = (0..frames)
        .map(|index| {
            let phase = std::f64::consts::TAU * index as f64 / frames as f64;
            turned(base, most_degrees.to_radians() * phase.sin())
        })
        .collect();
    let times: Vec<f64> = (0..frames).map(|index| index as f64 / frames_per_second).collect();
    let states: Vec<&FrameState> = states.iter().collect();
    render_states(
        avatar,
        &states,
        &times,
        &RenderOptions { label: "turntable", environment, size, ..Default::default() },
    )
}

/// The state seen from the front, turned about the vertical through the head's origin.
fn turned(state: &FrameState, radians: f64) -> FrameState {
    let facing = DMat3::from_rotation_y(radians) * frontal(state);
    let (axis, angle) = DQuat::from_mat3(&facing).to_axis_angle();
    // The angle of a unit quaternion is in [0, 2π]; the shorter way round is the one near the identity.
    let angle = if angle > std::f64::consts::PI { angle - std::f64::consts::TAU } else { angle };
    let mut out = state.clone();
    out.pose[..3].copy_from_slice(&(axis * angle).to_array());
    out
}

/// The head's orientation without its turn about the vertical: nod and tilt are kept.
fn frontal(state: &FrameState) -> DMat3 {
    let [x, y, z, ..] = state.pose;
    let orientation = rotation(DVec3::new(x, y, z));
    let forward = orientation * DVec3::Z;
    DMat3::from_rotation_y(-forward.x.atan2(forward.z)) * orientation
}

/// The state with the least turn, jaw and expression, in the units that the clip itself sets.
pub(crate) fn calmest(avatar: &Avatar) -> Result<&FrameState, AvatarError> {
    let unrest = |state: &&FrameState| {
        let [x, y, z, ..] = state.pose;
        let turn = DVec3::new(x, y, z).length_squared() / 0.1f64.powi(2);
        let jaw = (state.pose[9] / 0.05).powi(2);
        let expression: f64 = state.coefficients.iter().map(|c| f64::from(*c).powi(2)).sum();
        turn + jaw + expression / state.coefficients.len().max(1) as f64
    };
    let remedy = "fit the avatar again";
    avatar.states.iter().min_by(|a, b| unrest(a).total_cmp(&unrest(b))).ok_or(AvatarError::TooLittle {
        what: "the avatar has no pose",
        found: 0,
        remedy,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::POSE_SIZE;

    #[test]
    fn a_turn_is_about_the_vertical_from_the_front_and_keeps_the_nod() {
        let nod_and_turn = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(0.2);
        let (axis, angle) = DQuat::from_mat3(&nod_and_turn).to_axis_angle();
        let mut pose = [0.0; POSE_SIZE];
        pose[..3].copy_from_slice(&(axis * angle).to_array());
        pose[5] = -1.0;
        let state = FrameState { pose, coefficients: vec![0.4] };
        for radians in [-2.9, -1.0, 0.0, 0.3, 1.05, 3.0] {
            let out = turned(&state, radians);
            let [x, y, z, ..] = out.pose;
            let expected = DMat3::from_rotation_y(radians) * DMat3::from_rotation_x(0.2);
            assert!(rotation(DVec3::new(x, y, z)).abs_diff_eq(expected, 1e-9), "{radians}");
            assert_eq!((out.pose[3..].to_vec(), &out.coefficients), (pose[3..].to_vec(), &state.coefficients));
        }
    }
}
