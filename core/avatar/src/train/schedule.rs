//! When what happens in a fit: resolution, shading, rates, density rounds; and in which order frames are seen.

use crate::optimiser::Rates;

/// Rates at the start, in the order of [`crate::Group`]. Lengths are metres per step.
const RATES: Rates = Rates([8e-5, 8e-3, 3e-3, 3e-2, 2e-2, 1e-2, 1e-2, 1e-5, 2e-3]);
/// Share of the steps at half resolution and without shading.
const WARM_UP: f32 = 0.3;
/// Factor that all rates reach at the end, geometrically.
const LAST_FACTOR: f32 = 0.05;
/// Density rounds happen within this share of the steps.
const DENSITY: (f32, f32) = (0.08, 0.7);
/// Number of density rounds.
const ROUNDS: u32 = 12;
/// Poses start to move here.
const REFINE_FROM: f32 = 0.1;

/// A plan of a number of steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Schedule {
    steps: u32,
}

impl Schedule {
    /// A plan of `steps` steps, at least 1.
    pub fn new(steps: u32) -> Self {
        Self { steps: steps.max(1) }
    }

    /// Number of steps.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    fn progress(&self, step: u32) -> f32 {
        step as f32 / self.steps as f32
    }

    /// Whether the step is of the unshaded half-resolution stage.
    pub fn is_warm_up(&self, step: u32) -> bool {
        self.progress(step) < WARM_UP
    }

    /// Factor on all rates.
    pub fn decay(&self, step: u32) -> f32 {
        LAST_FACTOR.powf(self.progress(step))
    }

    /// Rates of the canonical parameters.
    pub fn rates(&self, step: u32) -> Rates {
        RATES.scaled(self.decay(step))
    }

    /// Whether poses move.
    pub fn refines(&self, step: u32) -> bool {
        self.progress(step) >= REFINE_FROM
    }

    /// Whether the fit may end early: density is settled and rates are low.
    pub fn may_stop(&self, step: u32) -> bool {
        self.progress(step) > 0.85
    }

    /// Whether a density round follows the step.
    pub fn controls_density(&self, step: u32) -> bool {
        let (from, to) = DENSITY;
        let interval = ((to - from) * self.steps as f32 / ROUNDS as f32).max(1.0) as u32;
        let (first, last) = ((from * self.steps as f32) as u32, (to * self.steps as f32) as u32);
        step >= first && step < last && (step - first) % interval == interval - 1
    }
}

/// Frames in random order without replacement, again and again; the same seed gives the same order.
#[derive(Clone, Debug)]
pub(crate) struct FrameOrder {
    frames: Vec<usize>,
    next: usize,
    state: u64,
}

impl FrameOrder {
    /// Over frames `0..count`.
    pub fn new(count: usize, seed: u64) -> Self {
        Self { frames: (0..count).collect(), next: count, state: seed }
    }

    /// The order that gave these parts; nothing when it could not have.
    pub fn from_state(frames: Vec<usize>, next: usize, state: u64) -> Option<Self> {
        (next <= frames.len()).then_some(Self { frames, next, state })
    }

    /// Whether it is an order of frames `0..count`.
    pub fn is_over(&self, count: usize) -> bool {
        let mut sorted = self.frames.clone();
        sorted.sort_unstable();
        sorted.into_iter().eq(0..count)
    }

    /// The frames in the order of this round.
    pub fn frames(&self) -> &[usize] {
        &self.frames
    }

    /// Place of the next frame in this round.
    pub fn next(&self) -> usize {
        self.next
    }

    /// State of the random numbers.
    pub fn state(&self) -> u64 {
        self.state
    }

    /// The next frame.
    pub fn draw(&mut self) -> usize {
        if self.next >= self.frames.len() {
            for last in (1..self.frames.len()).rev() {
                let other = (self.random() % (last as u64 + 1)) as usize;
                self.frames.swap(last, other);
            }
            self.next = 0;
        }
        self.next += 1;
        self.frames[self.next - 1]
    }

    /// SplitMix64 (Steele, Lea and Flood 2014).
    fn random(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_once_an_epoch_in_an_order_of_the_seed() {
        let draw = |seed: u64| -> Vec<usize> {
            let mut order = FrameOrder::new(20, seed);
            (0..40).map(|_| order.draw()).collect()
        };
        let order = draw(3);
        for epoch in order.chunks(20) {
            let mut sorted = epoch.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..20).collect::<Vec<_>>());
        }
        assert_ne!(order[..20], order[20..]);
        assert_eq!(order, draw(3));
        assert_ne!(order, draw(4));
    }

    #[test]
    fn rounds_fall_where_they_should() {
        let schedule = Schedule::new(3000);
        let rounds: Vec<u32> = (0..3000).filter(|&s| schedule.controls_density(s)).collect();
        assert!((11..=13).contains(&rounds.len()), "{rounds:?}");
        assert!(rounds.iter().all(|s| (240..2100).contains(s)));
        assert!(schedule.is_warm_up(0) && !schedule.is_warm_up(2999));
        let short = Schedule::new(1);
        assert!(short.is_warm_up(0));
    }
}
