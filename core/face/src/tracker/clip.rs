//! The whole clip at once: every frame's fit and smooth change from frame to frame, a block-tridiagonal system.
//!
//! The head's pose moves at a velocity of its own, an unknown of every frame that changes little from one to the next: so
//! second differences of the pose are small and a steady turn costs nothing. Jaw, expression and lids walk at random: their
//! first differences are small. Frames without a face have no other term, so they are interpolated between neighbours.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::frame::{self, EXPRESSION, JAW, Seen, Setting, Shared, State};
use super::linear::{cholesky, congruent, forward, gram, inverse, solve};

/// Tighter than motion alone would ask: a landmark network errs on the whole face at once, so its landmarks say less than
/// as many independent ones. Standard deviations over a thirtieth of a second: change of the turn's and the shift's
/// velocity, how far a step departs from it (radians, metres), radians of jaw, expression units, lid units.
const TURN_CHANGE: f64 = 0.0009;
const SHIFT_CHANGE: f64 = 0.00018;
const TURN_SLACK: f64 = 0.0005;
const SHIFT_SLACK: f64 = 0.00008;
const JAW_CHANGE: f64 = 0.022;
const EXPRESSION_CHANGE: f64 = 0.07;
const LID_CHANGE: f64 = 0.30;
/// Weights of the squared velocity itself, so that no head drifts away where nothing is seen: a turn of 0.05 radians or a
/// shift of a centimetre in a thirtieth of a second is fast.
const TURN_DRAG: f64 = 400.0;
const SHIFT_DRAG: f64 = 1e4;
/// Entries of the velocity.
const VELOCITY: usize = 6;

/// How one frame leads to the next.
pub struct Link {
    /// Thirtieths of a second between them.
    steps: f64,
    /// Weight of each unknown's squared change; for the pose, of its departure from the velocity.
    change: Vec<f64>,
    /// Weight of the velocity's squared change.
    velocity: [f64; VELOCITY],
}

impl Link {
    /// Between frames `seconds` apart, whose states have that many unknowns.
    pub fn new(unknowns: usize, seconds: f64, smoothness: f64) -> Self {
        let steps = (seconds * 30.0).max(1e-3);
        let weight = |deviation: f64| smoothness / (steps * deviation * deviation);
        let deviation = |k: usize| match k {
            k if k + 2 >= unknowns => LID_CHANGE,
            k if k >= EXPRESSION => EXPRESSION_CHANGE,
            k if k >= JAW => JAW_CHANGE,
            k if k >= 3 => SHIFT_SLACK,
            _ => TURN_SLACK,
        };
        Self {
            steps,
            change: (0..unknowns).map(|k| weight(deviation(k))).collect(),
            velocity: std::array::from_fn(|k| weight(if k < 3 { TURN_CHANGE } else { SHIFT_CHANGE })),
        }
    }

    /// The column of the coupling with the frame before that belongs to unknown `k`: its (up to two) entries.
    fn coupling(&self, k: usize) -> [(usize, f64); 2] {
        let n = self.change.len();
        match k.checked_sub(n) {
            Some(v) => [(k, -self.velocity[v]), (k, 0.0)],
            None if k < VELOCITY => [(k, -self.change[k]), (n + k, -self.change[k] * self.steps)],
            None => [(k, -self.change[k]), (k, 0.0)],
        }
    }
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

/// States and velocities (turn, shift; over a thirtieth of a second) of all frames.
#[derive(Clone)]
struct Motion {
    states: Vec<State>,
    velocities: Vec<[f64; VELOCITY]>,
}

/// The clip's problem.
pub struct Whole<'a> {
    /// What all frames share.
    pub setting: Setting<'a>,
    /// Landmarks; frames without points are interpolated.
    pub frames: &'a [Seen],
    /// `T−1` links between neighbours.
    pub links: Vec<Link>,
    /// How much a squared residual counts against the temporal terms and priors: 1 in a fit.
    pub trust: f64,
}

/// Matrix and gradient of one frame.
type System = (Vec<f64>, Vec<f64>);

/// The eliminated systems: factors, right sides, and unknowns held at their bounds.
struct Eliminated {
    factors: Vec<Vec<f64>>,
    rights: Vec<Vec<f64>>,
    held: Vec<Vec<bool>>,
}

impl Whole<'_> {
    /// Cost of the clip: every frame's and every change's.
    fn cost(&self, motion: &Motion) -> f64 {
        let own: Vec<f64> = self
            .frames
            .par_iter()
            .zip(&motion.states)
            .map(|(seen, state)| if seen.points.is_empty() { 0.0 } else { frame::cost(&self.setting, seen, state) })
            .collect();
        let changes: f64 = (0..self.links.len()).map(|t| self.link_cost(motion, t)).sum();
        let drags: f64 = motion.velocities.iter().flat_map(|v| (0..VELOCITY).map(|k| drag(k) * v[k] * v[k])).sum();
        own.iter().sum::<f64>() + changes + drags
    }

    fn link_cost(&self, motion: &Motion, t: usize) -> f64 {
        let (residuals, turns) = self.residuals(motion, t);
        let link = &self.links[t];
        let cost = |values: &[f64], weights: &[f64]| values.iter().zip(weights).map(|(v, w)| w * v * v).sum::<f64>();
        cost(&residuals, &link.change) + cost(&turns, &link.velocity)
    }

    /// What a link weighs: changes (the pose's less its velocity), and the velocity's change.
    fn residuals(&self, motion: &Motion, t: usize) -> (Vec<f64>, [f64; VELOCITY]) {
        let mut values = change(&motion.states[t], &motion.states[t + 1]);
        let (now, next) = (motion.velocities[t], motion.velocities[t + 1]);
        (0..VELOCITY).for_each(|k| values[k] -= now[k] * self.links[t].steps);
        (values, std::array::from_fn(|k| next[k] - now[k]))
    }

    /// Velocities as the states change, averaged over a few frames.
    fn velocities(&self, states: &[State]) -> Vec<[f64; VELOCITY]> {
        let last = states.len() - 1;
        (0..states.len())
            .map(|t| {
                let (from, to) = (t.saturating_sub(2), (t + 2).min(last));
                let steps: f64 = self.links[from..to].iter().map(|link| link.steps).sum();
                let moved = if from < to { change(&states[from], &states[to]) } else { vec![0.0; VELOCITY] };
                std::array::from_fn(|k| moved[k] / steps.max(1e-3))
            })
            .collect()
    }

    /// Variances of every frame's unknowns, velocity last, by the recursion of the selected inverse: the covariance is the
    /// inverse of the clip's matrix at `states`, of which only the diagonal blocks are made, from the last to the first. Bounds
    /// of unknowns are left out of account. `None` when a landmark falls behind the camera or the matrix is singular.
    pub fn variances(&self, states: &[State]) -> Option<Vec<Vec<f64>>> {
        let motion = Motion { states: states.to_vec(), velocities: vec![[0.0; VELOCITY]; states.len()] };
        let mut systems = self.systems(&motion)?;
        systems.iter_mut().for_each(|(_, gradient)| gradient.fill(0.0));
        let Eliminated { factors, .. } = self.eliminated(&systems, &motion, 0.0)?;
        let mut found = vec![Vec::new(); states.len()];
        let mut after: Option<Vec<f64>> = None;
        for t in (0..states.len()).rev() {
            let m = states[t].unknowns() + VELOCITY;
            let mut block = inverse(&factors[t], m);
            if let Some(after) = after {
                // What the frames behind leave open comes on top: G·Σ·Gᵀ with G = D⁻¹·coupling.
                let mut gain = vec![0.0; m * m];
                for k in 0..m {
                    for (row, value) in self.links[t].coupling(k) {
                        (0..m).for_each(|i| gain[i * m + k] += block[i * m + row] * value);
                    }
                }
                block.iter_mut().zip(congruent(&gain, &after, m)).for_each(|(value, more)| *value += more);
            }
            found[t] = (0..m).map(|k| block[k * m + k]).collect();
            after = Some(block);
        }
        Some(found)
    }

    /// The same of one frame as if it stood alone, without its velocity.
    pub fn variances_alone(&self, t: usize, state: &State) -> Option<Vec<f64>> {
        let (mut matrix, gradient) = self.own_system(&self.frames[t], state, &[0.0; VELOCITY])?;
        let m = gradient.len();
        (0..m).for_each(|k| matrix[k * m + k] += 1e-9);
        let inverse = cholesky(&mut matrix, m).then(|| inverse(&matrix, m))?;
        Some((0..state.unknowns()).map(|k| inverse[k * m + k]).collect())
    }

    /// Runs up to `iterations` damped steps.
    pub fn fit(&self, states: &mut Vec<State>, iterations: usize) {
        if states.is_empty() {
            return;
        }
        let mut motion = Motion { velocities: self.velocities(states), states: std::mem::take(states) };
        let mut best = self.cost(&motion);
        let mut damping = 1e-6;
        for _ in 0..iterations {
            let mut gain = 0.0;
            let Some(systems) = self.systems(&motion) else { break };
            for _ in 0..5 {
                let trial = self.step(&systems, &motion, damping);
                let trial_cost = trial.as_ref().map_or(f64::INFINITY, |trial| self.cost(trial));
                if let (Some(trial), true) = (trial, trial_cost < best) {
                    gain = (best - trial_cost) / best.max(1e-12);
                    (motion, best) = (trial, trial_cost);
                    damping = (damping * 0.2).max(1e-9);
                    break;
                }
                damping = damping.max(1e-6) * 10.0;
            }
            if gain < 1e-5 {
                break;
            }
        }
        *states = motion.states;
    }

    /// Normal equations of every frame, changes included: matrix and gradient.
    fn systems(&self, motion: &Motion) -> Option<Vec<System>> {
        let own: Option<Vec<System>> = self
            .frames
            .par_iter()
            .zip(motion.states.par_iter().zip(&motion.velocities))
            .map(|(seen, (state, velocity))| self.own_system(seen, state, velocity))
            .collect();
        let mut systems = own?;
        for t in 0..self.links.len() {
            self.add_link(t, self.residuals(motion, t), &mut systems);
        }
        Some(systems)
    }

    /// One frame's system without its neighbours, its velocity behind its unknowns.
    fn own_system(&self, seen: &Seen, state: &State, velocity: &[f64; VELOCITY]) -> Option<System> {
        let n = state.unknowns();
        let m = n + VELOCITY;
        let (mut matrix, mut gradient) = (vec![0.0; m * m], vec![0.0; m]);
        if !seen.points.is_empty() {
            let design = frame::linearised(&self.setting, seen, state, Shared::default())?;
            let (mut own, mut own_gradient) = design.normal();
            own.iter_mut().chain(&mut own_gradient).for_each(|value| *value *= self.trust);
            frame::add_beliefs(&mut own, &mut own_gradient, self.setting.prior, (seen, state));
            matrix.chunks_mut(m).zip(own.chunks(n)).for_each(|(row, own)| row[..n].copy_from_slice(own));
            gradient[..n].copy_from_slice(&own_gradient);
        }
        for k in 0..VELOCITY {
            matrix[(n + k) * m + n + k] += drag(k);
            gradient[n + k] += drag(k) * velocity[k];
        }
        Some((matrix, gradient))
    }

    /// Adds what a link puts on the diagonal blocks and gradients of its two frames.
    fn add_link(&self, t: usize, (residuals, turns): (Vec<f64>, [f64; VELOCITY]), systems: &mut [System]) {
        let (n, link) = (residuals.len(), &self.links[t]);
        let m = n + VELOCITY;
        let [(before, before_gradient), (after, after_gradient)] = &mut systems[t..t + 2] else { return };
        for k in 0..n {
            let (weight, pull) = (link.change[k], link.change[k] * residuals[k]);
            before[k * m + k] += weight;
            after[k * m + k] += weight;
            before_gradient[k] -= pull;
            after_gradient[k] += pull;
            if k < VELOCITY {
                let v = n + k;
                before[k * m + v] += weight * link.steps;
                before[v * m + k] += weight * link.steps;
                before[v * m + v] += weight * link.steps * link.steps + link.velocity[k];
                after[v * m + v] += link.velocity[k];
                before_gradient[v] -= pull * link.steps + link.velocity[k] * turns[k];
                after_gradient[v] += link.velocity[k] * turns[k];
            }
        }
    }

    /// Block Thomas: forward elimination, then back substitution.
    fn step(&self, systems: &[System], motion: &Motion, damping: f64) -> Option<Motion> {
        let Eliminated { factors, rights, held } = self.eliminated(systems, motion, damping)?;
        let mut next = motion.clone();
        let mut after: Option<Vec<f64>> = None;
        for t in (0..factors.len()).rev() {
            let mut right = rights[t].clone();
            if let Some(after) = &after {
                for (k, value) in after.iter().enumerate() {
                    for (row, coupling) in self.links[t].coupling(k) {
                        right[row] -= if held[t].get(row) == Some(&true) { 0.0 } else { coupling * value };
                    }
                }
            }
            solve(&factors[t], right.len(), &mut right);
            let n = motion.states[t].unknowns();
            next.states[t] = motion.states[t].stepped(&right[..n]);
            next.velocities[t].iter_mut().zip(&right[n..]).for_each(|(value, change)| *value += change);
            after = Some(right);
        }
        Some(next)
    }

    fn eliminated(&self, systems: &[System], motion: &Motion, damping: f64) -> Option<Eliminated> {
        let mut done = Eliminated { factors: Vec::new(), rights: Vec::new(), held: Vec::new() };
        for (t, (state, (matrix, gradient))) in motion.states.iter().zip(systems).enumerate() {
            let (mut matrix, mut right) = (matrix.clone(), gradient.iter().map(|g| -g).collect::<Vec<f64>>());
            let m = right.len();
            let held = state.held(gradient);
            (0..m).for_each(|k| matrix[k * m + k] = matrix[k * m + k] * (1.0 + damping) + 1e-9);
            if t > 0 {
                self.eliminate_before(t, &done, (&mut matrix, &mut right));
            }
            for k in (0..held.len()).filter(|k| held[*k]) {
                (0..m).for_each(|j| (matrix[k * m + j], matrix[j * m + k]) = (0.0, 0.0));
                matrix[k * m + k] = 1.0;
                right[k] = 0.0;
            }
            if !cholesky(&mut matrix, m) {
                return None;
            }
            done.factors.push(matrix);
            done.rights.push(right);
            done.held.push(held);
        }
        Some(done)
    }

    /// Subtracts what the frame before, already factored, contributes to this frame's system.
    fn eliminate_before(&self, t: usize, done: &Eliminated, (matrix, right): (&mut [f64], &mut [f64])) {
        let m = right.len();
        let (factor, held) = (&done.factors[t - 1], &done.held[t - 1]);
        // Columns of L⁻¹·[coupling right]: their products are what elimination takes away.
        let mut columns = vec![0.0; (m + 1) * m];
        for k in 0..m {
            for (row, value) in self.links[t - 1].coupling(k) {
                columns[k * m + row] += if held.get(row) == Some(&true) { 0.0 } else { value };
            }
        }
        columns[m * m..].copy_from_slice(&done.rights[t - 1]);
        columns.chunks_mut(m).for_each(|column| forward(factor, m, column));
        let taken = gram(&columns, m);
        for k in 0..m {
            right[k] -= taken[k * (m + 1) + m];
            matrix[k * m..(k + 1) * m].iter_mut().zip(&taken[k * (m + 1)..]).for_each(|(value, taken)| *value -= taken);
        }
    }
}

fn drag(k: usize) -> f64 {
    if k < 3 { TURN_DRAG } else { SHIFT_DRAG }
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
