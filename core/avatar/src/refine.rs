//! Joint refinement of the training frames' poses, smooth in time, and what it teaches about all other frames.
//!
//! Every training frame has an offset to its tracked numbers (pose, then motion coefficients), moved by Adam on the
//! picture's gradient. After each visit the refined number is drawn a little toward the cubic through its four
//! neighbours, so steady motion is untouched and jitter is not: what is left of it would compete with the pulse.
//! Frames outside training get the tracked pose plus what the training offsets say about it (`refine/correct.rs`); their
//! pictures are never used.

mod correct;

use correct::predicted_offsets;

use crate::motion::FrameState;
use crate::rig::POSE_SIZE;

/// Exponential forgetting of Adam's moments; frames are visited a few tens of times only.
const BETA: [f64; 2] = [0.8, 0.95];

/// How far and how smoothly poses may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineOptions {
    /// Step of rotation, translation, neck, jaw and eyes (radians, metres) at the start; 0 keeps the tracked numbers.
    pub pose_rates: [f64; 6],
    /// Step of the motion coefficients at the start.
    pub coefficient_rate: f64,
    /// Share by which a pose number is drawn to its neighbours' cubic at each visit, in [0, 1].
    pub pose_smoothing: f64,
    /// The same for the motion coefficients; less, because lids and lips are quick.
    pub coefficient_smoothing: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            pose_rates: [2e-4, 1e-4, 0.0, 1e-3, 2e-3, 2e-3],
            coefficient_rate: 0.01,
            pose_smoothing: 0.1,
            coefficient_smoothing: 0.03,
        }
    }
}

/// Offsets of the training frames and their moments.
pub(crate) struct Refiner {
    options: RefineOptions,
    /// The tracked numbers of every frame of the clip, `T × D`.
    tracked: Vec<Vec<f64>>,
    /// `training × D`.
    offsets: Vec<Vec<f64>>,
    first: Vec<Vec<f64>>,
    second: Vec<Vec<f64>>,
    visits: Vec<i32>,
}

fn numbers(state: &FrameState) -> Vec<f64> {
    state.pose.iter().copied().chain(state.coefficients.iter().map(|c| f64::from(*c))).collect()
}

fn state(numbers: impl Iterator<Item = f64>) -> FrameState {
    let mut pose = [0.0; POSE_SIZE];
    let mut coefficients = Vec::new();
    for (index, number) in numbers.enumerate() {
        match pose.get_mut(index) {
            Some(slot) => *slot = number,
            None => coefficients.push(number as f32),
        }
    }
    FrameState { pose, coefficients }
}

impl Refiner {
    /// No offsets yet. The first `training` frames of the clip are those that may move.
    pub fn new(states: &[FrameState], training: usize, options: RefineOptions) -> Self {
        let tracked: Vec<Vec<f64>> = states.iter().map(numbers).collect();
        let zeros = vec![vec![0.0; tracked.first().map_or(POSE_SIZE, Vec::len)]; training];
        Self {
            options,
            tracked,
            offsets: zeros.clone(),
            first: zeros.clone(),
            second: zeros,
            visits: vec![0; training],
        }
    }

    /// How far and how smoothly poses may move.
    pub fn options(&self) -> &RefineOptions {
        &self.options
    }

    /// Numbers of a frame.
    pub fn width(&self) -> usize {
        self.offsets.first().map_or(POSE_SIZE, Vec::len)
    }

    /// The tracked numbers of the training frames, row by row.
    pub fn tracked_rows(&self) -> Vec<f32> {
        self.tracked[..self.offsets.len()].iter().flatten().map(|number| *number as f32).collect()
    }

    /// The refined state of a training frame.
    pub fn state(&self, frame: usize) -> FrameState {
        state(self.tracked[frame].iter().zip(&self.offsets[frame]).map(|(a, b)| a + b))
    }

    /// One step for one frame; `gradient` is with respect to the pose and then the coefficients.
    pub fn step(&mut self, frame: usize, gradient: impl Iterator<Item = f64>, decay: f64) {
        self.visits[frame] += 1;
        let correction = BETA.map(|beta| 1.0 / (1.0 - beta.powi(self.visits[frame])));
        for (index, g) in gradient.enumerate() {
            let rate = decay * self.rate(index);
            if rate == 0.0 || !g.is_finite() {
                continue;
            }
            let (m, v) = (&mut self.first[frame][index], &mut self.second[frame][index]);
            *m = BETA[0] * *m + (1.0 - BETA[0]) * g;
            *v = BETA[1] * *v + (1.0 - BETA[1]) * g * g;
            self.offsets[frame][index] -= rate * *m * correction[0] / ((*v * correction[1]).sqrt() + 1e-12);
        }
        self.smooth(frame);
    }

    /// All that steps change: offsets and both moments, one after the other and row by row, and the visits.
    pub fn state_rows(&self) -> (Vec<f64>, &[i32]) {
        let rows = [&self.offsets, &self.first, &self.second].into_iter().flatten();
        (rows.flatten().copied().collect(), &self.visits)
    }

    /// Takes what [`Self::state_rows`] gave; refuses, unchanged, what is not of these frames.
    pub fn restore(&mut self, rows: &[f64], visits: &[i32]) -> bool {
        let width = self.offsets.first().map_or(0, Vec::len);
        if visits.len() != self.visits.len() || rows.len() != 3 * width * visits.len() {
            return false;
        }
        let parts = [&mut self.offsets, &mut self.first, &mut self.second].into_iter().flatten();
        for (row, values) in parts.zip(rows.chunks_exact(width.max(1))) {
            row.copy_from_slice(values);
        }
        self.visits.copy_from_slice(visits);
        true
    }

    fn rate(&self, index: usize) -> f64 {
        if index < POSE_SIZE { self.options.pose_rates[index / 3] } else { self.options.coefficient_rate }
    }

    /// Draws the frame toward the cubic through two neighbours on either side.
    fn smooth(&mut self, frame: usize) {
        if frame < 2 || frame + 2 >= self.offsets.len() {
            return;
        }
        for index in 0..self.offsets[frame].len() {
            let share =
                if index < POSE_SIZE { self.options.pose_smoothing } else { self.options.coefficient_smoothing };
            if self.rate(index) == 0.0 || share == 0.0 {
                continue;
            }
            let at = |t: usize| self.tracked[t][index] + self.offsets[t][index];
            let cubic = (4.0 * (at(frame - 1) + at(frame + 1)) - at(frame - 2) - at(frame + 2)) / 6.0;
            self.offsets[frame][index] += share * (cubic - at(frame));
        }
    }

    /// States of every frame of the clip: refined ones, and tracked ones with the offsets that those predict.
    pub fn all_states(&self) -> Vec<FrameState> {
        let predicted = predicted_offsets(&self.tracked, &self.offsets);
        let offsets = self.offsets.iter().chain(&predicted);
        self.tracked
            .iter()
            .zip(offsets)
            .map(|(row, offsets)| state(row.iter().zip(offsets).map(|(a, b)| a + b)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clip whose tracked translation carries jitter and a constant bias against the truth.
    fn shaky(count: usize) -> (Vec<FrameState>, Vec<f64>) {
        let truth: Vec<f64> = (0..count).map(|t| 0.02 * (t as f64 * 0.15).sin()).collect();
        let states = truth
            .iter()
            .enumerate()
            .map(|(t, x)| {
                let mut pose = [0.0; POSE_SIZE];
                pose[3] = x + 8e-4 + 4e-4 * ((t * 7919 % 13) as f64 / 6.0 - 1.0);
                FrameState { pose, coefficients: vec![0.0] }
            })
            .collect();
        (states, truth)
    }

    #[test]
    fn refinement_removes_bias_and_jitter_and_carries_the_bias_to_frames_it_never_saw() {
        let (states, truth) = shaky(120);
        let mut refiner = Refiner::new(&states, 100, RefineOptions::default());
        for visit in 0..6000 {
            let frame = visit * 37 % 100;
            let error = refiner.state(frame).pose[3] - truth[frame];
            let gradient = (0..POSE_SIZE + 1).map(|i| if i == 3 { error } else { 0.0 });
            refiner.step(frame, gradient, 0.02f64.powf(visit as f64 / 6000.0));
        }
        let refined = refiner.all_states();
        let error = |t: usize| refined[t].pose[3] - truth[t];
        assert!((2..98).all(|t| error(t).abs() < 1e-4), "trained");
        let bias = (100..120).map(error).sum::<f64>() / 20.0;
        assert!(bias.abs() < 2e-4, "not trained: a bias of 0.8 mm became {bias}");
        let jitter = |x: &dyn Fn(usize) -> f64| -> f64 {
            (3..97).map(|t| (x(t - 1) - 2.0 * x(t) + x(t + 1)).powi(2)).sum::<f64>().sqrt()
        };
        assert!(jitter(&error) < 0.2 * jitter(&|t| states[t].pose[3] - truth[t]));
    }

    #[test]
    fn a_poisoned_gradient_changes_nothing() {
        let (states, _) = shaky(10);
        let mut refiner = Refiner::new(&states, 10, RefineOptions::default());
        for t in 0..10 {
            refiner.step(t, [f64::NAN, f64::INFINITY].into_iter().cycle().take(POSE_SIZE + 1), 1.0);
        }
        assert!(refiner.all_states().iter().all(|s| s.pose.iter().all(|v| v.is_finite())));
    }
}
