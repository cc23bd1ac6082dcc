//! The canonical Gaussians of one person: flat arrays in the neutral head's space, identity baked in.
//!
//! Always holds: all arrays describe the same `N` Gaussians, row-major with the widths of [`Canonical::widths`]. Lengths
//! are metres (log-scales: natural logarithm of metres), quaternions (w, x, y, z) need not be normalised, opacity,
//! albedo, roughness and reflectance are logits. The third axis of a Gaussian is its surface normal: Gaussians start
//! flat along it. (Differs from the baseline, which takes the shortest axis and so lets the normal jump when two scales
//! cross.) The same struct holds gradients and optimiser moments.

use heartian_splat::sigmoid;
use rayon::prelude::*;

use crate::rig::JOINTS;

/// Number of parameter groups.
pub const GROUPS: usize = 9;

/// The groups in the order of [`Canonical::groups`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// `N×3` centres, metres.
    Positions = 0,
    /// `N×3` log-scales.
    LogScales = 1,
    /// `N×4` quaternions.
    Rotations = 2,
    /// `N` opacity logits.
    Opacities = 3,
    /// `N×3` logits of linear albedo.
    Albedos = 4,
    /// `N` roughness logits.
    Roughness = 5,
    /// `N` reflectance logits.
    Reflectances = 6,
    /// `N×K×3` displacement per unit of each motion coefficient, metres.
    Bases = 7,
    /// `N×5` skinning weights before clamping at 0 and normalisation.
    Weights = 8,
}

/// Canonical Gaussians, or anything shaped like them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Canonical {
    /// Motion coefficients a basis row answers to, `K`.
    pub modes: usize,
    /// See [`Group::Positions`].
    pub positions: Vec<f32>,
    /// See [`Group::LogScales`].
    pub log_scales: Vec<f32>,
    /// See [`Group::Rotations`].
    pub rotations: Vec<f32>,
    /// See [`Group::Opacities`].
    pub opacity_logits: Vec<f32>,
    /// See [`Group::Albedos`].
    pub albedo_logits: Vec<f32>,
    /// See [`Group::Roughness`].
    pub roughness_logits: Vec<f32>,
    /// See [`Group::Reflectances`].
    pub reflectance_logits: Vec<f32>,
    /// See [`Group::Bases`].
    pub bases: Vec<f32>,
    /// See [`Group::Weights`].
    pub weights: Vec<f32>,
}

impl Canonical {
    /// `count` rows of zeros.
    pub fn zeros(count: usize, modes: usize) -> Self {
        let mut out = Self { modes, ..Self::default() };
        let widths = out.widths();
        for (group, width) in out.groups_mut().into_iter().zip(widths) {
            *group = vec![0.0; count * width];
        }
        out
    }

    /// Sets every value to 0.
    pub fn clear(&mut self) {
        const CHUNK: usize = 64 * 1024;
        for group in self.groups_mut() {
            group.par_chunks_mut(CHUNK).for_each(|values| values.fill(0.0));
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.opacity_logits.is_empty()
    }

    /// Values per Gaussian in each group.
    pub fn widths(&self) -> [usize; GROUPS] {
        [3, 3, 4, 1, 3, 1, 1, 3 * self.modes, JOINTS]
    }

    /// The groups, in the order of [`Group`].
    pub fn groups(&self) -> [&Vec<f32>; GROUPS] {
        [
            &self.positions,
            &self.log_scales,
            &self.rotations,
            &self.opacity_logits,
            &self.albedo_logits,
            &self.roughness_logits,
            &self.reflectance_logits,
            &self.bases,
            &self.weights,
        ]
    }

    /// The groups, mutable.
    pub fn groups_mut(&mut self) -> [&mut Vec<f32>; GROUPS] {
        [
            &mut self.positions,
            &mut self.log_scales,
            &mut self.rotations,
            &mut self.opacity_logits,
            &mut self.albedo_logits,
            &mut self.roughness_logits,
            &mut self.reflectance_logits,
            &mut self.bases,
            &mut self.weights,
        ]
    }

    /// The rows at `indices`, in that order; a row may be taken more than once.
    pub fn gather(&self, indices: &[u32]) -> Self {
        let mut out = Self { modes: self.modes, ..Self::default() };
        let widths = self.widths();
        for ((to, from), width) in out.groups_mut().into_iter().zip(self.groups()).zip(widths) {
            to.reserve(indices.len() * width);
            for &index in indices {
                let start = index as usize * width;
                to.extend_from_slice(&from[start..start + width]);
            }
        }
        out
    }

    /// Whether every group has the rows of `N` Gaussians.
    pub fn is_consistent(&self) -> bool {
        let count = self.len();
        self.groups().iter().zip(self.widths()).all(|(group, width)| group.len() == count * width)
    }

    /// Index of the first Gaussian with a value that is not finite.
    pub fn first_not_finite(&self) -> Option<usize> {
        let widths = self.widths();
        let in_group = |(group, width): (&Vec<f32>, usize)| {
            group.par_iter().position_first(|value| !value.is_finite()).map(|index| index / width.max(1))
        };
        self.groups().into_iter().zip(widths).filter_map(in_group).min()
    }

    /// One Gaussian's position.
    pub fn position(&self, index: usize) -> [f32; 3] {
        std::array::from_fn(|axis| self.positions[3 * index + axis])
    }

    /// Linear albedo of one Gaussian, each channel in (0, 1).
    pub fn albedo(&self, index: usize) -> [f32; 3] {
        std::array::from_fn(|channel| sigmoid(self.albedo_logits[3 * index + channel]))
    }

    /// Opacity of one Gaussian in (0, 1).
    pub fn opacity(&self, index: usize) -> f32 {
        sigmoid(self.opacity_logits[index])
    }

    /// Unit normal in canonical space: the third axis of the rotation.
    pub fn normal(&self, index: usize) -> [f32; 3] {
        let q: [f32; 4] = std::array::from_fn(|i| self.rotations[4 * index + i]);
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
        let [w, x, y, z] = q.map(|v| v / length);
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_travel_together() {
        let mut canonical = Canonical::zeros(3, 2);
        for (index, value) in canonical.bases.iter_mut().enumerate() {
            *value = index as f32;
        }
        canonical.opacity_logits = vec![7.0, 8.0, 9.0];
        let picked = canonical.gather(&[2, 0, 2]);
        assert!(picked.is_consistent());
        assert_eq!(picked.opacity_logits, [9.0, 7.0, 9.0]);
        assert_eq!(picked.bases[..6], canonical.bases[12..18]);
        assert_eq!(canonical.first_not_finite(), None);
        canonical.weights[6] = f32::NAN;
        assert_eq!(canonical.first_not_finite(), Some(1));
    }
}
