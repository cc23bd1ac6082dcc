//! Where the eyes look, from the irises' centres, once the head is fitted.
//!
//! Each eye turns about its own centre by pitch and yaw until its iris lies where it was seen. Both eyes turn together but
//! for a difference that is the clip's own (they converge, and a fitted eyeball sits a little off the true one): it is the
//! median of what the eyes show alone. Single frames that disagree with their neighbours are outvoted by a median over a
//! tenth of a second before and after, which keeps the edges of saccades. Behind closed lids eyes turn evenly from what
//! was seen before to what is seen after. Without irises they look straight ahead.

use glam::{DVec2, DVec3};

use super::frame::{Lens, State, robust};
use super::linear::damped_solve;
use super::points::{cross_matrix, rotation};
use crate::irises::EyeBall;
use crate::observations::Observations;

/// Landmark index of the left and of the right iris's centre.
const IRIS: [u32; 2] = [473, 468];
/// A lid closed further than this hides the iris.
const HIDDEN: f64 = 0.5;
/// Weights of the squares of a turn and of what the eyes' difference departs from the clip's own, against squared pixels
/// over the scale: the eyes rarely turn by more than half a radian, and apart by a twentieth.
const PRIOR: f64 = 3.0;
const TOGETHER: f64 = 400.0;
/// Time before and after a frame whose median counts, seconds.
const AROUND_SECONDS: f64 = 0.085;
/// Largest pitch and yaw, radians.
const LIMITS: [f64; 2] = [0.6, 0.8];

/// Pitch and yaw of the left and of the right eye.
type Turns = [f64; 4];

/// Turns of both eyes in every frame, axis-angle in head space; zero everywhere when no iris was seen.
pub fn turns(
    eyeballs: &[Option<EyeBall>; 2],
    observations: &Observations,
    (lens, scale_px): (Lens, f64),
    states: &[State],
) -> Vec<[DVec3; 2]> {
    let seen: Vec<[Option<DVec2>; 2]> =
        states.iter().enumerate().map(|(t, state)| irises(eyeballs, observations, (t, state))).collect();
    let view = View { eyeballs, lens, scale_px };
    let fit = |between: Option<[f64; 2]>| -> Vec<Option<Turns>> {
        states.iter().zip(&seen).map(|(state, seen)| view.turns(seen, state, between)).collect()
    };
    let alone: Vec<Turns> = fit(None)
        .into_iter()
        .zip(&seen)
        .filter(|(_, s)| s.iter().all(Option::is_some))
        .filter_map(|(turns, _)| turns)
        .collect();
    let between = [0, 1].map(|k| median(alone.iter().map(|turns| turns[k] - turns[k + 2]).collect()));
    let steady = steadied(&fit(Some(between)), &observations.times_seconds);
    steady.into_iter().map(|[a, b, c, d]| [DVec3::new(a, b, 0.0), DVec3::new(c, d, 0.0)]).collect()
}

/// The irises of a frame that count.
fn irises(
    eyeballs: &[Option<EyeBall>; 2],
    observations: &Observations,
    (t, state): (usize, &State),
) -> [Option<DVec2>; 2] {
    std::array::from_fn(|eye| {
        let found = observations.frame(t).find(|landmark| landmark.index == IRIS[eye] && landmark.weight > 0.0)?;
        let open = state.eyelids[eye] <= HIDDEN && eyeballs[eye].is_some();
        open.then(|| found.position_px.map(f64::from).into())
    })
}

/// What all frames share.
struct View<'a> {
    eyeballs: &'a [Option<EyeBall>; 2],
    lens: Lens,
    scale_px: f64,
}

impl View<'_> {
    /// Four unknowns, a few Gauss–Newton steps; `None` when no iris was seen. `between` is left less right.
    fn turns(&self, seen: &[Option<DVec2>; 2], state: &State, between: Option<[f64; 2]>) -> Option<Turns> {
        if seen.iter().all(Option::is_none) {
            return None;
        }
        let mut turns = [0.0; 4];
        for _ in 0..6 {
            let (mut matrix, mut gradient) = (vec![0.0; 16], vec![0.0; 4]);
            for eye in 0..2 {
                if let (Some(pixel), Some(ball)) = (seen[eye], &self.eyeballs[eye]) {
                    self.add_eye((pixel, ball), (eye, &turns), state, (&mut matrix, &mut gradient));
                }
            }
            for k in 0..4 {
                matrix[5 * k] += PRIOR;
                gradient[k] += PRIOR * turns[k];
            }
            for k in 0..2 {
                let Some(between) = between else { break };
                let off = TOGETHER * (turns[k] - turns[k + 2] - between[k]);
                for (a, sign) in [(k, 1.0), (k + 2, -1.0)] {
                    gradient[a] += sign * off;
                    matrix[5 * a] += TOGETHER;
                    matrix[4 * a + (a + 2) % 4] -= TOGETHER;
                }
            }
            let step = damped_solve(&matrix, &gradient, 1e-9, &[])?;
            for (k, value) in turns.iter_mut().enumerate() {
                *value = (*value - step[k]).clamp(-LIMITS[k % 2], LIMITS[k % 2]);
            }
        }
        Some(turns)
    }

    fn add_eye(
        &self,
        (pixel, ball): (DVec2, &EyeBall),
        (eye, turns): (usize, &Turns),
        state: &State,
        (matrix, gradient): (&mut [f64], &mut [f64]),
    ) {
        let Lens { focal, centre } = self.lens;
        let arm = rotation(DVec3::new(turns[2 * eye], turns[2 * eye + 1], 0.0)) * DVec3::Z * ball.iris_distance();
        let y = state.rotation * (ball.centre + arm) + state.translation;
        let inverse = -1.0 / y.z;
        let offset = DVec2::new(focal * y.x * inverse, -focal * y.y * inverse);
        let residual = (centre + offset - pixel) / self.scale_px;
        let weight = robust(residual.length_squared()).1;
        // Small turns: the right Jacobian is left out.
        let by_turn = state.rotation * -cross_matrix(arm);
        let rows = [
            DVec3::new(focal * inverse, 0.0, offset.x * inverse) / self.scale_px,
            DVec3::new(0.0, -focal * inverse, offset.y * inverse) / self.scale_px,
        ];
        let slope = [0, 1].map(|axis| DVec2::new(rows[0].dot(by_turn.col(axis)), rows[1].dot(by_turn.col(axis))));
        for a in 0..2 {
            gradient[2 * eye + a] += weight * slope[a].dot(residual);
            for b in 0..2 {
                matrix[4 * (2 * eye + a) + 2 * eye + b] += weight * slope[a].dot(slope[b]);
            }
        }
    }
}

/// Median over the time around each frame; frames without turn evenly between their neighbours in time.
fn steadied(turns: &[Option<Turns>], times: &[f64]) -> Vec<Turns> {
    let known: Vec<usize> = (0..turns.len()).filter(|&t| turns[t].is_some()).collect();
    let smooth: Vec<Turns> = known
        .iter()
        .map(|&t| {
            let near = |s: &&usize| (times[**s] - times[t]).abs() <= AROUND_SECONDS;
            let around: Vec<Turns> = known.iter().filter(near).filter_map(|&s| turns[s]).collect();
            std::array::from_fn(|k| median(around.iter().map(|turns| turns[k]).collect()))
        })
        .collect();
    (0..turns.len())
        .map(|t| {
            let after = known.partition_point(|&s| s < t);
            let (before, after) = (after.saturating_sub(usize::from(known.get(after) != Some(&t))), after);
            let (Some(from), Some(to)) = (known.get(before), known.get(after.min(known.len().saturating_sub(1))))
            else {
                return [0.0; 4];
            };
            let span = times[*to] - times[*from];
            let share = if span > 0.0 { ((times[t] - times[*from]) / span).clamp(0.0, 1.0) } else { 0.0 };
            let [a, b] = [smooth[before], smooth[after.min(known.len() - 1)]];
            std::array::from_fn(|k| a[k] + share * (b[k] - a[k]))
        })
        .collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::{FaceError, HeadModel, Landmark};

    /// A wandering gaze, blinks, and a left eye that is seen a pixel too far right.
    #[test]
    fn eyes_follow_their_irises_and_closed_ones_are_bridged() -> Result<(), FaceError> {
        let balls = HeadModel::procedural().eyeballs();
        let (lens, frames) = (Lens { focal: 563.2, centre: DVec2::splat(128.0) }, 90);
        let mut state = State::rest(0);
        state.translation.z = -0.8;
        let truth = |t: usize| {
            let wave = |hertz: f64| (TAU * hertz * t as f64 / 30.0).sin();
            DVec3::new(0.08 * wave(0.4), 0.2 * wave(0.3), 0.0)
        };
        let times = (0..frames).map(|t| t as f64 / 30.0).collect();
        let seen = |t: usize| {
            let iris = |eye: usize| {
                let ball = balls[eye]?;
                let y = ball.centre + rotation(truth(t)) * DVec3::Z * ball.iris_distance() + state.translation;
                let pixel = lens.centre + DVec2::new(-y.x / y.z, y.y / y.z) * lens.focal;
                let aside = if eye == 0 { 1.0 } else { 0.0 };
                Some(Landmark {
                    index: IRIS[eye],
                    position_px: [(pixel.x + aside) as f32, pixel.y as f32],
                    weight: 1.0,
                })
            };
            Some((0..2).filter_map(iris).collect())
        };
        let observations = Observations::new(256, 256, times, (0..frames).map(seen).collect())?;
        let mut states = vec![state; frames];
        for blink in [20, 21, 60] {
            states[blink].eyelids = [0.9; 2];
        }
        let found = turns(&balls, &observations, (lens, 0.7), &states);
        for (t, [left, right]) in found.iter().enumerate().take(frames - 3).skip(3) {
            assert!((*right - truth(t)).length() < 0.03, "frame {t}: {right} {}", truth(t));
            assert!((*left - *right).y > 0.05, "frame {t}: the left eye keeps its own difference: {left} {right}");
        }
        states.iter_mut().for_each(|state| state.eyelids = [1.0; 2]);
        assert_eq!(turns(&balls, &observations, (lens, 0.7), &states)[5], [DVec3::ZERO; 2]);
        Ok(())
    }

    #[test]
    fn a_wrong_frame_is_outvoted_a_saccade_stays_sharp_and_gaps_are_bridged() {
        let times: Vec<f64> = (0..12).map(|t| f64::from(t) / 30.0).collect();
        let mut turns: Vec<Option<Turns>> = (0..12).map(|t| Some([if t < 6 { 0.0 } else { 0.2 }; 4])).collect();
        turns[2] = Some([0.7; 4]);
        (turns[9], turns[10]) = (None, None);
        let found = steadied(&turns, &times);
        for (t, turns) in found.iter().enumerate() {
            assert!((turns[1] - if t < 6 { 0.0 } else { 0.2 }).abs() < 1e-9, "{t}: {turns:?}");
        }
        let bridged = steadied(&[Some([0.0; 4]), None, Some([0.4; 4])], &[0.0, 1.0, 2.0]);
        assert!((bridged[1][0] - 0.2).abs() < 1e-9);
        assert_eq!(steadied(&[None, None], &times[..2]), [[0.0; 4]; 2]);
    }
}
