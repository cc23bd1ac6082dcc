//! Adam over the canonical parameters, one rate a group, with the guards that keep every parameter finite and in range.
//!
//! A gradient that is not finite is skipped (its moments stay). After each step values are held to the ranges below,
//! so that no later exponential, logarithm or projection can overflow.

use heartian_splat::{Adam, AdamOptions};
use rayon::prelude::*;

use crate::AvatarError;
use crate::canonical::{Canonical, GROUPS};

/// A fit has a few thousand steps, so the second moment forgets sooner than usual; gradients are those of a picture's
/// mean error and of order 1e-6, so the guard is smaller than usual.
const ADAM: AdamOptions = AdamOptions { beta1: 0.9, beta2: 0.99, epsilon: 1e-10 };
/// How every group moves.
pub(crate) fn options() -> AdamOptions {
    ADAM
}

/// Ranges of the groups: (least, most).
pub(crate) fn ranges() -> [(f32, f32); GROUPS] {
    RANGES
}

/// Values handled by one task.
const CHUNK: usize = 16 * 1024;

/// Ranges of the groups: (least, most).
const RANGES: [(f32, f32); GROUPS] = [
    // Positions, metres in head space.
    (-1.5, 1.5),
    // Log-scales: 0.05 mm to 12 mm.
    (-9.9, -4.4),
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
}

/// Moments of every parameter.
#[derive(Clone, Debug)]
pub struct Optimiser {
    groups: [Adam; GROUPS],
}

impl Optimiser {
    /// Moments of zero for the given parameters.
    pub fn new(parameters: &Canonical) -> Self {
        Self { groups: parameters.groups().map(|group| Adam::new(group.len(), ADAM)) }
    }

    /// From the moments of each group.
    pub(crate) fn from_groups(groups: [Adam; GROUPS]) -> Self {
        Self { groups }
    }

    /// The moments of each group.
    pub(crate) fn groups(&self) -> &[Adam; GROUPS] {
        &self.groups
    }

    /// One step down the gradient. Groups with rate 0 are left alone.
    ///
    /// # Errors
    /// When parameters and gradient are not of the Gaussians that the moments are of.
    pub fn step(&mut self, parameters: &mut Canonical, gradient: &Canonical, rates: &Rates) -> Result<(), AvatarError> {
        let groups = parameters.groups_mut().into_iter().zip(gradient.groups()).zip(&mut self.groups);
        for (((values, gradients), adam), (rate, (least, most))) in groups.zip(rates.0.iter().zip(RANGES)) {
            if *rate == 0.0 {
                continue;
            }
            adam.step(values, gradients, *rate)?;
            values.par_chunks_mut(CHUNK).for_each(|values| values.iter_mut().for_each(|v| *v = v.clamp(least, most)));
        }
        Ok(())
    }

    /// Keeps the moments of the Gaussians that `from` names; `None` is a new one, with moments of zero.
    pub fn regroup(&mut self, from: &[Option<u32>], widths: [usize; GROUPS]) {
        for (adam, width) in self.groups.iter_mut().zip(widths) {
            if width > 0 {
                adam.rearrange(from, width);
            }
        }
    }
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
    fn a_poisoned_gradient_moves_nothing_out_of_range() -> Result<(), AvatarError> {
        for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e-45] {
            let mut parameters = filled(3, 0.0);
            parameters.log_scales.fill(-6.0);
            let mut optimiser = Optimiser::new(&parameters);
            for _ in 0..3 {
                optimiser.step(&mut parameters, &filled(3, poison), &Rates([0.1; GROUPS]))?;
            }
            optimiser.step(&mut parameters, &filled(3, 1.0), &Rates([0.1; GROUPS]))?;
            assert_eq!(parameters.first_not_finite(), None, "{poison}");
        }
        Ok(())
    }

    #[test]
    fn it_descends_and_regroups() -> Result<(), AvatarError> {
        let mut parameters = filled(2, 0.0);
        parameters.log_scales.fill(-6.0);
        let mut optimiser = Optimiser::new(&parameters);
        for _ in 0..300 {
            let mut gradient = filled(2, 0.0);
            for (g, value) in gradient.positions.iter_mut().zip(&parameters.positions) {
                *g = value - 0.7;
            }
            optimiser.step(&mut parameters, &gradient, &Rates([0.02; GROUPS]))?;
        }
        assert!(parameters.positions.iter().all(|p| (p - 0.7).abs() < 0.01), "{:?}", parameters.positions);
        optimiser.regroup(&[Some(1), None, Some(0)], parameters.widths());
        let mut parameters = parameters.gather(&[1, 1, 0]);
        optimiser.step(&mut parameters, &filled(3, 0.0), &Rates([0.02; GROUPS]))?;
        assert!(optimiser.step(&mut filled(2, 0.0), &filled(2, 0.0), &Rates([0.02; GROUPS])).is_err());
        Ok(())
    }
}
