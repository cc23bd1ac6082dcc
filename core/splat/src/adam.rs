//! Adam (Kingma and Ba 2015), fused over flat slices, chunked over threads: element-wise, so always the same bits.
//!
//! A gradient that is not finite leaves its parameter and moments as they are and is counted. ε is 1e-8 and not 3DGS's
//! 1e-15: with the latter any underflowing gradient makes a full-size step, and hidden Gaussians drift at random.

use crate::error::{SplatError, expect_length};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
use rayon::prelude::*;

/// Elements of a parallel task.
const CHUNK: usize = 16 * 1024;

/// Decay rates and guard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamOptions {
    /// Of the mean gradient.
    pub beta1: f32,
    /// Of the mean squared gradient.
    pub beta2: f32,
    /// Added to the root of the mean squared gradient.
    pub epsilon: f32,
}

impl Default for AdamOptions {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8 }
    }
}

/// Moments of one group of parameters, and how many steps it has taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    options: AdamOptions,
    first: Vec<f32>,
    second: Vec<f32>,
    steps: u32,
}

impl Adam {
    /// Zero moments for `length` parameters.
    pub fn new(length: usize, options: AdamOptions) -> Self {
        Self { options, first: vec![0.0; length], second: vec![0.0; length], steps: 0 }
    }

    /// The optimiser that gave these [`Adam::moments`] and [`Adam::steps`]; nothing when the moments differ in length.
    pub fn from_parts(options: AdamOptions, [first, second]: [Vec<f32>; 2], steps: u32) -> Option<Self> {
        (first.len() == second.len()).then_some(Self { options, first, second, steps })
    }

    /// First and second moments.
    pub fn moments(&self) -> [&[f32]; 2] {
        [&self.first, &self.second]
    }

    /// Steps taken.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.first.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.first.is_empty()
    }

    /// One descent step; returns how many gradients were not finite and were left out.
    ///
    /// # Errors
    /// When the lengths differ.
    pub fn step(&mut self, parameters: &mut [f32], gradients: &[f32], learning_rate: f32) -> Result<usize, SplatError> {
        expect_length("the parameters", self.first.len(), parameters.len())?;
        expect_length("the gradients", self.first.len(), gradients.len())?;
        self.steps = self.steps.saturating_add(1);
        let AdamOptions { beta1, beta2, .. } = self.options;
        let [rate, guard] = corrected_rates(&self.options, self.steps, learning_rate);
        let scales = Scales { beta1, beta2, rate, guard };
        let chunks = parameters.par_chunks_mut(CHUNK).zip(gradients.par_chunks(CHUNK));
        let chunks = chunks.zip(self.first.par_chunks_mut(CHUNK)).zip(self.second.par_chunks_mut(CHUNK));
        Ok(chunks.map(|(((p, g), m), v)| descend(scales, p, g, m, v)).sum())
    }

    /// Rearranges the moments after density control: row `i` of the new moments (rows of `stride` values) is old row
    /// `rows[i]`, or zeros where that is `None` or out of range. The step count stays.
    pub fn rearrange(&mut self, rows: &[Option<u32>], stride: usize) {
        let take = |old: &[f32]| {
            let mut new = vec![0.0; rows.len() * stride];
            for (to, row) in new.chunks_exact_mut(stride.max(1)).zip(rows) {
                if let Some(from) = row.and_then(|r| old.get(r as usize * stride..(r as usize + 1) * stride)) {
                    to.copy_from_slice(from);
                }
            }
            new
        };
        (self.first, self.second) = (take(&self.first), take(&self.second));
    }

    /// Forgets both moments of the rows (of `stride` values) that `forget` marks.
    pub fn forget(&mut self, forget: &[bool], stride: usize) {
        for moments in [&mut self.first, &mut self.second] {
            for (row, _) in moments.chunks_exact_mut(stride.max(1)).zip(forget).filter(|(_, forget)| **forget) {
                row.fill(0.0);
            }
        }
    }
}

/// Learning rate and guard of step number `steps` with the bias corrections in them:
/// `lr·(m/c1)/(√(v/c2) + ε) = (lr·√c2/c1)·m/(√v + ε·√c2)`.
pub(crate) fn corrected_rates(options: &AdamOptions, steps: u32, learning_rate: f32) -> [f32; 2] {
    let corrected = |beta: f32| 1.0 - f64::from(beta).powi(steps.min(1_000_000) as i32);
    let root = corrected(options.beta2).sqrt();
    [(f64::from(learning_rate) * root / corrected(options.beta1)) as f32, (f64::from(options.epsilon) * root) as f32]
}

/// One step's constants: decay rates, and learning rate and guard with the bias corrections in them.
#[derive(Clone, Copy)]
struct Scales {
    beta1: f32,
    beta2: f32,
    rate: f32,
    guard: f32,
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn descend_lanes<V: Lanes>(scales: Scales, p: &mut [f32], g: &[f32], m: &mut [f32], v: &mut [f32]) -> usize {
    let n = p.len().min(g.len()).min(m.len()).min(v.len());
    let whole = n / V::N * V::N;
    let mut used = 0;
    for at in (0..whole).step_by(V::N) {
        // SAFETY: all four slices hold N values from `at`; V's features are here by contract.
        let block = unsafe {
            [p.as_mut_ptr().add(at), g.as_ptr().add(at).cast_mut(), m.as_mut_ptr().add(at), v.as_mut_ptr().add(at)]
        };
        // SAFETY: as above; the gradient is only read.
        used += unsafe { descend_block::<V>(scales, block) };
    }
    // The last ones through a padded copy whose padding has zero gradient, and is not counted.
    let mut rest = [[0.0f32; MAX_LANES]; 4];
    for (copy, from) in rest.iter_mut().zip([&*p, g, &*m, &*v]) {
        copy[..n - whole].copy_from_slice(&from[whole..n]);
    }
    // SAFETY: the copies hold MAX_LANES values.
    used += unsafe { descend_block::<V>(scales, rest.each_mut().map(|row| row.as_mut_ptr())) };
    used -= V::N - (n - whole);
    for (copy, to) in [&rest[0], &rest[2], &rest[3]].into_iter().zip([p, m, v]) {
        to[whole..n].copy_from_slice(&copy[..n - whole]);
    }
    n - used
}

/// Steps `N` parameters (parameter, gradient, first and second moment); gives how many gradients were finite.
///
/// # Safety
/// Inside a function with the features of `V`; the pointers give `N` values each, all but the gradient to be written.
#[inline(always)]
unsafe fn descend_block<V: Lanes>(scales: Scales, [p, g, m, v]: [*mut f32; 4]) -> usize {
    // SAFETY: the caller's contract.
    unsafe {
        let gradient = V::load(g);
        let square = gradient.mul(gradient);
        // A square that overflows would stop its parameter for good, so it counts as not finite.
        let usable = V::splat(f32::MAX).ge(square);
        let (old_p, old_m, old_v) = (V::load(p), V::load(m), V::load(v));
        let new_m = gradient.sub(old_m).mul_add(V::splat(1.0 - scales.beta1), old_m);
        let new_v = square.sub(old_v).mul_add(V::splat(1.0 - scales.beta2), old_v);
        let step = V::splat(scales.rate).mul(new_m).div(new_v.sqrt().add(V::splat(scales.guard)));
        V::select(usable, old_p.sub(step), old_p).store(p);
        V::select(usable, new_m, old_m).store(m);
        V::select(usable, new_v, old_v).store(v);
        V::bits(usable).count_ones() as usize
    }
}

dispatched! { fn descend(scales: Scales, p: &mut [f32], g: &[f32], m: &mut [f32], v: &mut [f32]) -> usize = descend_lanes; }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_follow_the_published_algorithm_and_poison_is_left_out() -> Result<(), SplatError> {
        let mut adam = Adam::new(3, AdamOptions::default());
        let mut p = [1.0f32, 2.0, 3.0];
        let (mut m, mut v, mut want) = (0.0f64, 0.0f64, 1.0f64);
        for t in 1..=200 {
            let g = 2.0 * p[0] - 1.0;
            assert_eq!(adam.step(&mut p, &[g, f32::NAN, f32::MAX], 0.02)?, 2);
            let g = 2.0 * want - 1.0;
            m = 0.9 * m + 0.1 * g;
            v = 0.999 * v + 0.001 * g * g;
            want -= 0.02 * (m / (1.0 - 0.9f64.powi(t))) / ((v / (1.0 - 0.999f64.powi(t))).sqrt() + 1e-8);
        }
        assert!((f64::from(p[0]) - want).abs() < 1e-4, "{} {want}", p[0]);
        assert_eq!((p[1], p[2]), (2.0, 3.0));
        assert!(adam.step(&mut p[..2], &[0.0; 3], 0.1).is_err());
        Ok(())
    }

    #[test]
    fn rearranging_keeps_each_row_with_its_owner() -> Result<(), SplatError> {
        let mut adam = Adam::new(4, AdamOptions::default());
        adam.step(&mut [0.0; 4], &[1.0, 2.0, 3.0, 4.0], 0.1)?;
        adam.rearrange(&[Some(1), None, Some(0), Some(9)], 2);
        let near: Vec<f32> = adam.first.iter().map(|m| (m * 10.0).round()).collect();
        assert_eq!(near, [3.0, 4.0, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0]);
        adam.forget(&[true, false, false, false], 2);
        assert_eq!(adam.first[..2], [0.0; 2]);
        Ok(())
    }
}
