//! Adam over the canonical parameters, one rate a group, with the guards that keep every parameter finite and in range.
//!
//! A gradient that is not finite is skipped (its moments stay). After each step values are held to the ranges below,
//! so that no later exponential, logarithm or projection can overflow.

use rayon::prelude::*;

use crate::canonical::{Canonical, GROUPS, Group};

/// Exponential forgetting of the first and the second moment.
const BETA: [f32; 2] = [0.9, 0.99];
/// Added to the root of the second moment. Gradients are per mean absolute error of the picture and of order 1e-6.
const EPSILON: f32 = 1e-11;
/// Values handled by one task.
const CHUNK: usize = 8192;

/// Ranges of the groups: (least, most).
const RANGES: [(f32, f32); GROUPS] = [
    // Positions, metres in head space.
    (-1.5, 1.5),
    // Log-scales: 0.05 mm to 30 mm.
    (-9.9, -3.5),
    // Quaternions: any scale of order 1.
    (-8.0, 8.0),
    // Opacity logits.
    (-9.0, 9.0),
    // Albedo logits: 0.0025 to 0.9975.
    (-6.0, 6.0),
    (-8.0, 8.0),
    (-8.0, 8.0),
    // Displacement per unit coefficient, metres.
    (-0.1, 0.1),
    // Skinning weights.
    (-0.5, 1.5),
];

/// Learning rate of each group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates(pub [f32; GROUPS]);

impl Rates {
    /// All rates times a factor.
    pub fn scaled(self, factor: f32) -> Self {
        Self(self.0.map(|rate| rate * factor))
    }

    /// The rate of one group replaced.
    pub fn with(mut self, group: Group, rate: f32) -> Self {
        self.0[group as usize] = rate;
        self
    }
}

/// First and second moments of every parameter.
#[derive(Clone, Debug)]
pub struct Optimiser {
    first: Canonical,
    second: Canonical,
    steps: i32,
}

impl Optimiser {
    /// Moments of zero for the given parameters.
    pub fn new(parameters: &Canonical) -> Self {
        let zeros = Canonical::zeros(parameters.len(), parameters.modes);
        Self { first: zeros.clone(), second: zeros, steps: 0 }
    }

    /// One step down the gradient. Groups with rate 0 are left alone.
    pub fn step(&mut self, parameters: &mut Canonical, gradient: &Canonical, rates: &Rates) {
        self.steps = self.steps.saturating_add(1);
        let correction = BETA.map(|beta| 1.0 / (1.0 - beta.powi(self.steps)));
        let groups = parameters.groups_mut().into_iter().zip(gradient.groups());
        let moments = self.first.groups_mut().into_iter().zip(self.second.groups_mut());
        for (((values, gradients), (first, second)), (rate, range)) in
            groups.zip(moments).zip(rates.0.iter().zip(RANGES))
        {
            if *rate == 0.0 {
                continue;
            }
            values
                .par_chunks_mut(CHUNK)
                .zip(gradients.par_chunks(CHUNK))
                .zip(first.par_chunks_mut(CHUNK).zip(second.par_chunks_mut(CHUNK)))
                .for_each(|((values, gradients), (first, second))| {
                    for (((value, g), m), v) in values.iter_mut().zip(gradients).zip(first).zip(second) {
                        *value = updated(*value, *g, (m, v), (*rate, correction)).clamp(range.0, range.1);
                    }
                });
        }
    }

    /// Keeps the moments of the Gaussians that `from` names; `None` is a new one, with moments of zero.
    pub fn regroup(&mut self, from: &[Option<u32>]) {
        let indices: Vec<u32> = from.iter().map(|index| index.unwrap_or(0)).collect();
        for moments in [&mut self.first, &mut self.second] {
            let mut gathered = moments.gather(&indices);
            let widths = gathered.widths();
            for (group, width) in gathered.groups_mut().into_iter().zip(widths) {
                for (row, _) in from.iter().enumerate().filter(|(_, index)| index.is_none()) {
                    group[row * width..(row + 1) * width].fill(0.0);
                }
            }
            *moments = gathered;
        }
    }
}

/// Adam's update of one value; `(m, v)` are its moments.
#[inline(always)]
fn updated(value: f32, g: f32, (m, v): (&mut f32, &mut f32), (rate, correction): (f32, [f32; 2])) -> f32 {
    // Branch-free: a gradient that is not finite, or so large that its square is not, counts as none.
    let usable = g.abs() < 1e18;
    let g = if usable { g } else { 0.0 };
    *m = BETA[0] * *m + (1.0 - BETA[0]) * g;
    *v = BETA[1] * *v + (1.0 - BETA[1]) * g * g;
    value - rate * (*m * correction[0]) / ((*v * correction[1]).sqrt() + EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(count: usize, value: f32) -> Canonical {
        let mut canonical = Canonical::zeros(count, 1);
        canonical.groups_mut().into_iter().for_each(|group| group.fill(value));
        canonical
    }

    #[test]
    fn a_poisoned_gradient_moves_nothing_out_of_range() {
        for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e-45] {
            let mut parameters = filled(3, 0.0);
            parameters.log_scales.fill(-6.0);
            let mut optimiser = Optimiser::new(&parameters);
            for _ in 0..3 {
                optimiser.step(&mut parameters, &filled(3, poison), &Rates([0.1; GROUPS]));
            }
            optimiser.step(&mut parameters, &filled(3, 1.0), &Rates([0.1; GROUPS]));
            assert_eq!(parameters.first_not_finite(), None, "{poison}");
        }
    }

    #[test]
    fn it_descends_and_regrouping_keeps_the_right_moments() {
        let mut parameters = filled(2, 0.0);
        parameters.log_scales.fill(-6.0);
        let mut optimiser = Optimiser::new(&parameters);
        for _ in 0..300 {
            let mut gradient = filled(2, 0.0);
            for (g, value) in gradient.positions.iter_mut().zip(&parameters.positions) {
                *g = value - 0.7;
            }
            optimiser.step(&mut parameters, &gradient, &Rates([0.02; GROUPS]));
        }
        assert!(parameters.positions.iter().all(|p| (p - 0.7).abs() < 0.01), "{:?}", parameters.positions);
        optimiser.second.positions = vec![1.0, 1.0, 1.0, 2.0, 2.0, 2.0];
        optimiser.regroup(&[Some(1), None, Some(0)]);
        assert_eq!(optimiser.second.positions, [2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
    }
}
