//! The naive f64 texts: the specification that the fast kernels are held against. No cleverness, no threads.
//!
//! Forward texts are written from the definitions; backward texts by the plainest chain rule, and both are held against
//! each other by finite differences. A scene here may hold no poison: that is the fast path's contract.

pub mod composite;
pub mod harmonics;
pub mod loss;
pub mod project;
pub mod shade;
pub mod tiled;

use crate::gaussians::Gaussians;

/// A scene in f64; see [`Gaussians`] for units.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// `N` centres.
    pub means: Vec<[f64; 3]>,
    /// `N` standard deviations.
    pub scales: Vec<[f64; 3]>,
    /// `N` quaternions (w, x, y, z), not normalised.
    pub rotations: Vec<[f64; 4]>,
    /// `N` opacities.
    pub opacities: Vec<f64>,
    /// `N × channels`.
    pub features: Vec<f64>,
    /// Number of features of each Gaussian.
    pub channels: usize,
}

impl Scene {
    /// The same scene in f64.
    pub fn new(gaussians: &Gaussians) -> Self {
        Self {
            means: gaussians.means.iter().map(|m| m.map(f64::from)).collect(),
            scales: gaussians.scales.iter().map(|s| s.map(f64::from)).collect(),
            rotations: gaussians.rotations.iter().map(|q| q.map(f64::from)).collect(),
            opacities: gaussians.opacities.iter().map(|&o| f64::from(o)).collect(),
            features: gaussians.features.iter().map(|&f| f64::from(f)).collect(),
            channels: gaussians.channels,
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }
}
