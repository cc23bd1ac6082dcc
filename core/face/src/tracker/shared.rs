//! Identity, and perhaps the focal length, from key frames jointly: each frame's own unknowns are eliminated by a Schur
//! complement, so a step costs one small system per frame and one for what they share.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::frame::{self, JAW, Lens, Seen, Setting, Shared, State};
use super::linear::{cholesky, damped_solve, forward, gram, solve};
use super::points::{Points, Shape};

/// What the key frames share.
#[derive(Clone, Debug)]
pub struct Person {
    /// Identity coefficients.
    pub identity: Vec<f64>,
    /// Camera.
    pub lens: Lens,
}

/// The problem of the joint fit.
pub struct Joint<'a> {
    /// Landmark points.
    pub points: &'a Points,
    /// The key frames' landmarks.
    pub frames: Vec<&'a Seen>,
    /// Pixels that count as one.
    pub scale_px: f64,
    /// Prior of a frame's unknowns.
    pub frame_prior: &'a [f64],
    /// Prior of each identity coefficient's square.
    pub identity_prior: Vec<f64>,
    /// Prior of the squared change of the focal length's logarithm; `None` holds it.
    pub focal_prior: Option<f64>,
    /// The focal length the prior pulls to.
    pub focal_centre: f64,
}

/// What the shared unknowns leave open.
pub struct Openness {
    /// Variance of each of a frame's unknowns that comes from the shared ones, less what it has in common in all frames; a
    /// mean over the key frames.
    pub own: Vec<f64>,
    /// Variance of the focal length's logarithm; 0 where it is held.
    pub focal: f64,
}

/// One frame's part of the reduced system, and what is needed to recover its own step.
struct Eliminated {
    factor: Vec<f64>,
    /// `H_ps` by columns: shared unknown × own unknown.
    coupling: Vec<f64>,
    gradient: Vec<f64>,
    schur: Vec<f64>,
    reduced_gradient: Vec<f64>,
}

impl Joint<'_> {
    fn shared(&self) -> Shared {
        Shared { identity: self.identity_prior.len(), focal: self.focal_prior.is_some() }
    }

    fn prior_cost(&self, person: &Person) -> f64 {
        let identity: f64 = person.identity.iter().zip(&self.identity_prior).map(|(v, w)| w * v * v).sum();
        let change = (person.lens.focal / self.focal_centre).ln();
        identity + self.focal_prior.map_or(0.0, |weight| weight * change * change)
    }

    fn cost(&self, person: &Person, states: &[State]) -> f64 {
        let shape = self.points.shape(&person.identity);
        let setting = self.setting(person, &shape);
        let costs: Vec<f64> =
            self.frames.par_iter().zip(states).map(|(seen, state)| frame::cost(&setting, seen, state)).collect();
        costs.iter().sum::<f64>() + self.prior_cost(person)
    }

    /// Runs up to `iterations` damped Gauss–Newton steps on everything at once.
    pub fn fit(&self, person: &mut Person, states: &mut Vec<State>, iterations: usize) {
        let mut best = self.cost(person, states);
        let mut damping = 1e-3;
        for _ in 0..iterations {
            let mut gain = 0.0;
            for _ in 0..5 {
                let trial = self.step(person, states, damping);
                let trial_cost = trial.as_ref().map_or(f64::INFINITY, |(p, s)| self.cost(p, s));
                if let (Some((next_person, next_states)), true) = (trial, trial_cost < best) {
                    gain = (best - trial_cost) / best.max(1e-12);
                    (*person, *states, best) = (next_person, next_states, trial_cost);
                    damping = (damping * 0.2).max(1e-6);
                    break;
                }
                damping *= 8.0;
            }
            if gain < 1e-4 {
                break;
            }
        }
    }

    /// One trial step; `None` when the system cannot be solved.
    fn step(&self, person: &Person, states: &[State], damping: f64) -> Option<(Person, Vec<State>)> {
        let parts = self.all_eliminated(person, states, damping)?;
        let n = self.shared().count();
        let mut matrix = vec![0.0; n * n];
        let mut gradient = vec![0.0; n];
        for part in &parts {
            matrix.iter_mut().zip(&part.schur).for_each(|(sum, value)| *sum += value);
            gradient.iter_mut().zip(&part.reduced_gradient).for_each(|(sum, value)| *sum += value);
        }
        frame::add_prior(&mut matrix, &mut gradient, &self.identity_prior, &person.identity);
        if let Some(weight) = self.focal_prior {
            matrix[n * n - 1] += weight;
            gradient[n - 1] += weight * (person.lens.focal / self.focal_centre).ln();
        }
        let shared_step: Vec<f64> = damped_solve(&matrix, &gradient, damping, &[])?.iter().map(|v| -v).collect();
        let next_states = parts.iter().zip(states).map(|(part, state)| part.recovered(state, &shared_step)).collect();
        let mut next = person.clone();
        for (value, change) in next.identity.iter_mut().zip(&shared_step) {
            *value = (*value + change).clamp(-6.0, 6.0);
        }
        if self.focal_prior.is_some() {
            next.lens.focal *= shared_step[n - 1].clamp(-0.5, 0.5).exp();
        }
        Some((next, next_states))
    }

    /// How far the shared unknowns are open, and what follows for the frames, where squared residuals count `trust` and the
    /// shared unknowns' squares one. `None` when a landmark falls behind the camera or nothing is determined.
    pub fn openness(&self, person: &Person, states: &[State], trust: f64) -> Option<Openness> {
        let (parts, n) = (self.all_eliminated(person, states, 0.0)?, self.shared().count());
        let mut factor = vec![0.0; n * n];
        for part in &parts {
            factor.iter_mut().zip(&part.schur).for_each(|(sum, value)| *sum += trust * value);
        }
        (0..self.identity_prior.len()).for_each(|k| factor[k * n + k] += 1.0);
        if let Some(weight) = self.focal_prior {
            factor[n * n - 1] += weight;
        }
        if n == 0 || !cholesky(&mut factor, n) {
            return None;
        }
        let mut last = vec![0.0; n];
        last[n - 1] = 1.0;
        forward(&factor, n, &mut last);
        let focal = self.focal_prior.map_or(0.0, |_| last[n - 1] * last[n - 1]);
        Some(Openness { own: own_variances(&parts, states, &factor), focal })
    }

    /// Every frame with its own unknowns eliminated; `None` when one cannot be.
    fn all_eliminated(&self, person: &Person, states: &[State], damping: f64) -> Option<Vec<Eliminated>> {
        let shape = self.points.shape(&person.identity);
        let setting = self.setting(person, &shape);
        let frames = self.frames.par_iter().zip(states);
        frames.map(|(seen, state)| self.eliminated(&setting, seen, state, damping)).collect()
    }

    fn setting<'b>(&'b self, person: &Person, shape: &'b Shape) -> Setting<'b> {
        let (lens, scale_px) = (person.lens, self.scale_px);
        Setting { points: self.points, shape, lens, scale_px, prior: self.frame_prior }
    }

    fn eliminated(&self, setting: &Setting, seen: &Seen, state: &State, damping: f64) -> Option<Eliminated> {
        let design = frame::linearised(setting, seen, state, self.shared())?;
        let (matrix, all_gradient) = design.normal();
        let (own, width) = (state.unknowns(), design.width);
        let shared = width - own;
        let mut gradient = all_gradient[..own].to_vec();
        let mut factor: Vec<f64> = matrix.chunks(width).take(own).flat_map(|row| &row[..own]).copied().collect();
        frame::add_beliefs(&mut factor, &mut gradient, self.frame_prior, (seen, state));
        let held = state.held(&gradient);
        for i in 0..own {
            factor[i * own + i] = factor[i * own + i] * (1.0 + damping) + 1e-9;
            if held[i] {
                (0..own).for_each(|j| (factor[i * own + j], factor[j * own + i]) = (0.0, 0.0));
                factor[i * own + i] = 1.0;
                gradient[i] = 0.0;
            }
        }
        if !cholesky(&mut factor, own) {
            return None;
        }
        let mut coupling: Vec<f64> = matrix.chunks(width).skip(own).flat_map(|row| &row[..own]).copied().collect();
        for column in coupling.chunks_mut(own) {
            column.iter_mut().zip(&held).filter(|(_, held)| **held).for_each(|(value, _)| *value = 0.0);
        }
        // Columns of L⁻¹·[H_ps g]: their products are what elimination takes away.
        let mut whitened = coupling.clone();
        whitened.extend(&gradient);
        whitened.chunks_mut(own).for_each(|column| forward(&factor, own, column));
        let taken = gram(&whitened, own);
        let row = |i: usize| &taken[i * (shared + 1)..(i + 1) * (shared + 1)];
        let schur = (0..shared)
            .flat_map(|i| {
                let whole = &matrix[(own + i) * width + own..(own + i + 1) * width];
                whole.iter().zip(row(i)).map(|(value, taken)| value - taken).collect::<Vec<f64>>()
            })
            .collect();
        let reduced_gradient = (0..shared).map(|i| all_gradient[own + i] - row(i)[shared]).collect();
        Some(Eliminated { factor, coupling, gradient, schur, reduced_gradient })
    }
}

/// Variance of the frames' unknowns from that of the shared ones (given the factor of its inverse), less the frames' mean;
/// turns are compared in the head's own frame.
fn own_variances(parts: &[Eliminated], states: &[State], factor: &[f64]) -> Vec<f64> {
    let own = parts.first().map_or(0, |part| part.gradient.len());
    let shared = parts.first().map_or(0, |part| part.coupling.len().checked_div(own).unwrap_or(0));
    let mut responses: Vec<Vec<f64>> =
        parts.iter().zip(states).map(|(part, state)| part.response(state.rotation)).collect();
    let mut mean = vec![0.0; own * shared];
    for response in &responses {
        mean.iter_mut().zip(response).for_each(|(sum, value)| *sum += value / parts.len() as f64);
    }
    let mut variances = vec![0.0; own];
    for response in &mut responses {
        response.iter_mut().zip(&mean).for_each(|(value, mean)| *value -= mean);
        for (k, variance) in variances.iter_mut().enumerate() {
            let mut row: Vec<f64> = response.chunks(own).map(|column| column[k]).collect();
            forward(factor, shared, &mut row);
            *variance += row.iter().map(|value| value * value).sum::<f64>() / parts.len() as f64;
        }
    }
    variances
}

impl Eliminated {
    /// How the frame's unknowns follow the shared ones: a column for each of those; the turn in the head's frame.
    fn response(&self, rotation: DMat3) -> Vec<f64> {
        let own = self.gradient.len();
        let mut columns = self.coupling.clone();
        for column in columns.chunks_mut(own) {
            solve(&self.factor, own, column);
            let turn = rotation.transpose() * DVec3::from_slice(column);
            column[..JAW / 2].copy_from_slice(&turn.to_array());
        }
        columns
    }

    fn recovered(&self, state: &State, shared_step: &[f64]) -> State {
        let own = self.gradient.len();
        let mut right: Vec<f64> = self.gradient.iter().map(|value| -value).collect();
        for (column, change) in self.coupling.chunks(own).zip(shared_step) {
            right.iter_mut().zip(column).for_each(|(value, coupling)| *value -= coupling * change);
        }
        solve(&self.factor, own, &mut right);
        state.stepped(&right)
    }
}
