//! Adam (Kingma and Ba 2015), fused over flat slices, chunked over threads: element-wise, so always the same bits.
//!
//! A gradient that is not finite leaves its parameter and moments as they are and is counted. ε is 1e-8 and not 3DGS's
//! 1e-15: with the latter any underflowing gradient makes a full-size step, and hidden Gaussians drift at random.

use crate::error::{SplatError, expect_length};
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
        let AdamOptions { beta1, beta2, epsilon } = self.options;
        let corrected = |beta: f32| 1.0 - f64::from(beta).powi(self.steps.min(1_000_000) as i32);
        // lr·(m/c1)/(√(v/c2) + ε) = (lr·√c2/c1)·m/(√v + ε·√c2)
        let root = corrected(beta2).sqrt();
        let (rate, guard) =
            ((f64::from(learning_rate) * root / corrected(beta1)) as f32, (f64::from(epsilon) * root) as f32);
        let chunks = parameters.par_chunks_mut(CHUNK).zip(gradients.par_chunks(CHUNK));
        let chunks = chunks.zip(self.first.par_chunks_mut(CHUNK)).zip(self.second.par_chunks_mut(CHUNK));
        Ok(chunks
            .map(|(((p, g), m), v)| {
                let mut left_out = 0;
                for (((p, &g), m), v) in p.iter_mut().zip(g).zip(m).zip(v) {
                    // A square that overflows would stop its parameter for good, so it counts as not finite.
                    let usable = (g * g).is_finite();
                    left_out += usize::from(!usable);
                    let new_m = *m + (1.0 - beta1) * (g - *m);
                    let new_v = *v + (1.0 - beta2) * (g * g - *v);
                    let step = rate * new_m / (new_v.sqrt() + guard);
                    (*m, *v, *p) = if usable { (new_m, new_v, *p - step) } else { (*m, *v, *p) };
                }
                left_out
            })
            .sum())
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
