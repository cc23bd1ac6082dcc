//! The whole clip at once: every frame's fit and smooth change from frame to frame, a block-tridiagonal system.
//!
//! Smoothness is a random walk: a step between neighbours costs its square over the variance that the time between them
//! allows. Frames without a face have no other term, so they are interpolated between their neighbours.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::frame::{self, EXPRESSION, JAW, Seen, Setting, Shared, State};
use super::linear::{cholesky, solve};

/// Tighter than motion alone would ask: a landmark network errs on the whole face at once, so its landmarks say less than
/// as many independent ones. Standard deviation of the change over a thirtieth of a second: radians of turn, metres across and along the line of
/// sight, radians of jaw, expression units, lid units.
const TURN: f64 = 0.006;
const SHIFT: f64 = 0.0012;
const JAW_CHANGE: f64 = 0.022;
const EXPRESSION_CHANGE: f64 = 0.07;
const LID_CHANGE: f64 = 0.30;

/// Weights of the squared change of each unknown from one frame to the next.
pub fn change_weights(unknowns: usize, seconds: f64, smoothness: f64) -> Vec<f64> {
    let share = smoothness / (seconds * 30.0).max(1e-3);
    (0..unknowns)
        .map(|k| {
            let deviation = match k {
                k if k + 2 >= unknowns => LID_CHANGE,
                k if k >= EXPRESSION => EXPRESSION_CHANGE,
                k if k >= JAW => JAW_CHANGE,
                k if k >= 3 => SHIFT,
                _ => TURN,
            };
            share / (deviation * deviation)
        })
        .collect()
}

/// Change from one state to the next, in the frame's unknowns.
fn change(from: &State, to: &State) -> Vec<f64> {
    let turn = DQuat::from_mat3(&(to.rotation * from.rotation.transpose())).to_scaled_axis();
    let shift = to.translation - from.translation;
    let mut values = to.local();
    values.iter_mut().zip(from.local()).for_each(|(value, before)| *value -= before);
    values[..3].copy_from_slice(&turn.to_array());
    values[3..6].copy_from_slice(&shift.to_array());
    values
}

/// The clip's problem.
pub struct Whole<'a> {
    /// What all frames share.
    pub setting: Setting<'a>,
    /// Landmarks; frames without points are interpolated.
    pub frames: &'a [Seen],
    /// `T−1` rows of weights between neighbours.
    pub weights: Vec<Vec<f64>>,
}

impl Whole<'_> {
    /// Cost of the clip: every frame's and every change's.
    pub fn cost(&self, states: &[State]) -> f64 {
        let own: Vec<f64> = self
            .frames
            .par_iter()
            .zip(states)
            .map(|(seen, state)| if seen.points.is_empty() { 0.0 } else { frame::cost(&self.setting, seen, state) })
            .collect();
        let changes: f64 = states
            .windows(2)
            .zip(&self.weights)
            .map(|(pair, weights)| {
                change(&pair[0], &pair[1])
                    .iter()
                    .zip(weights)
                    .map(|(value, weight)| weight * value * value)
                    .sum::<f64>()
            })
            .sum();
        own.iter().sum::<f64>() + changes
    }

    /// Runs up to `iterations` damped steps.
    pub fn fit(&self, states: &mut Vec<State>, iterations: usize) {
        let mut best = self.cost(states);
        let mut damping = 1e-4;
        for _ in 0..iterations {
            let mut gain = 0.0;
            let Some(systems) = self.systems(states) else { return };
            for _ in 0..5 {
                let trial = self.step(&systems, states, damping);
                let trial_cost = trial.as_ref().map_or(f64::INFINITY, |trial| self.cost(trial));
                if let (Some(trial), true) = (trial, trial_cost < best) {
                    gain = (best - trial_cost) / best.max(1e-12);
                    (*states, best) = (trial, trial_cost);
                    damping = (damping * 0.2).max(1e-8);
                    break;
                }
                damping = damping.max(1e-5) * 10.0;
            }
            if gain < 1e-5 {
                break;
            }
        }
    }

    /// Normal equations of every frame, changes included: matrix and gradient.
    fn systems(&self, states: &[State]) -> Option<Vec<(Vec<f64>, Vec<f64>)>> {
        let own: Option<Vec<(Vec<f64>, Vec<f64>)>> = self
            .frames
            .par_iter()
            .zip(states)
            .map(|(seen, state)| {
                let n = state.unknowns();
                if seen.points.is_empty() {
                    return Some((vec![0.0; n * n], vec![0.0; n]));
                }
                let design = frame::linearised(&self.setting, seen, state, Shared::default())?;
                let (mut matrix, mut gradient) = design.normal();
                frame::add_prior(&mut matrix, &mut gradient, self.setting.prior, &state.local());
                Some((matrix, gradient))
            })
            .collect();
        let mut systems = own?;
        for (t, weights) in self.weights.iter().enumerate() {
            let change = change(&states[t], &states[t + 1]);
            let n = change.len();
            for k in 0..n {
                let pull = weights[k] * change[k];
                systems[t].0[k * n + k] += weights[k];
                systems[t].1[k] -= pull;
                systems[t + 1].0[k * n + k] += weights[k];
                systems[t + 1].1[k] += pull;
            }
        }
        Some(systems)
    }

    /// Block Thomas: forward elimination with the diagonal couplings, then back substitution.
    fn step(&self, systems: &[(Vec<f64>, Vec<f64>)], states: &[State], damping: f64) -> Option<Vec<State>> {
        let n = states.first()?.unknowns();
        let mut factors: Vec<Vec<f64>> = Vec::with_capacity(states.len());
        let mut rights: Vec<Vec<f64>> = Vec::with_capacity(states.len());
        let mut held_all: Vec<Vec<bool>> = Vec::with_capacity(states.len());
        for (t, state) in states.iter().enumerate() {
            let (mut matrix, mut right) = (systems[t].0.clone(), systems[t].1.iter().map(|g| -g).collect::<Vec<f64>>());
            let held = state.held(&systems[t].1);
            (0..n).for_each(|k| matrix[k * n + k] = matrix[k * n + k] * (1.0 + damping) + 1e-9);
            if t > 0 {
                self.eliminate_before(t, (&factors[t - 1], &rights[t - 1], &held_all[t - 1]), &mut matrix, &mut right);
            }
            for k in (0..n).filter(|k| held[*k]) {
                (0..n).for_each(|j| (matrix[k * n + j], matrix[j * n + k]) = (0.0, 0.0));
                matrix[k * n + k] = 1.0;
                right[k] = 0.0;
            }
            if !cholesky(&mut matrix, n) {
                return None;
            }
            factors.push(matrix);
            rights.push(right);
            held_all.push(held);
        }
        let mut steps: Vec<Vec<f64>> = vec![Vec::new(); states.len()];
        for t in (0..states.len()).rev() {
            let mut right = rights[t].clone();
            if let Some(after) = steps.get(t + 1) {
                for k in (0..n).filter(|k| !held_all[t][*k]) {
                    right[k] += self.weights[t][k] * after[k];
                }
            }
            solve(&factors[t], n, &mut right);
            steps[t] = right;
        }
        Some(states.iter().zip(&steps).map(|(state, step)| state.stepped(step)).collect())
    }

    /// Subtracts what the frame before, already factored, contributes to this frame's system.
    fn eliminate_before(
        &self,
        t: usize,
        (factor, right_before, held): (&[f64], &[f64], &[bool]),
        matrix: &mut [f64],
        right: &mut [f64],
    ) {
        let (n, weights) = (right.len(), &self.weights[t - 1]);
        let mut before = right_before.to_vec();
        solve(factor, n, &mut before);
        for k in (0..n).filter(|k| !held[*k]) {
            right[k] += weights[k] * before[k];
            let mut unit = vec![0.0; n];
            unit[k] = weights[k];
            solve(factor, n, &mut unit);
            for j in (0..n).filter(|j| !held[*j]) {
                matrix[j * n + k] -= weights[j] * unit[j];
            }
        }
    }
}

/// Fills the states of frames without a face from their neighbours in time; ends are held.
pub fn interpolate_missing(states: &mut [State], frames: &[Seen], times: &[f64]) {
    let known: Vec<usize> = (0..frames.len()).filter(|&t| !frames[t].points.is_empty()).collect();
    for t in (0..frames.len()).filter(|&t| frames[t].points.is_empty()) {
        let after = known.partition_point(|&k| k < t);
        let (before, after) = (after.checked_sub(1).map(|k| known[k]), known.get(after).copied());
        states[t] = match (before, after) {
            (Some(a), Some(b)) => between(&states[a], &states[b], (times[t] - times[a]) / (times[b] - times[a])),
            (Some(only), None) | (None, Some(only)) => states[only].clone(),
            (None, None) => continue,
        };
    }
}

fn between(a: &State, b: &State, share: f64) -> State {
    let step: Vec<f64> = change(a, b).iter().map(|value| value * share).collect();
    let mut state = a.stepped(&step);
    state.translation = a.translation + (b.translation - a.translation) * share;
    debug_assert!(state.translation.distance(a.translation + DVec3::from_slice(&step[3..])) < 1e-9);
    state
}
