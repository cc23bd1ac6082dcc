//! Adam with a learning rate per group and exponential decay (paper, Implementation Details). Bias-corrected,
//! β₁ = 0.9, β₂ = 0.999, ε = 1e-8, the PyTorch defaults the paper keeps.

/// β₁, β₂ and ε.
const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// A learning rate that decays exponentially from `first` to `last` over `steps`, then stays.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Schedule {
    /// Rate at step 0.
    pub first: f64,
    /// Rate at step `steps` and after.
    pub last: f64,
    /// Length of the decay; 0 means `last` at once.
    pub steps: f64,
}

impl Schedule {
    /// The same rate for ever.
    pub const fn fixed(rate: f64) -> Self {
        Self { first: rate, last: rate, steps: 1.0 }
    }

    /// The rate at a step (fractional steps allowed).
    pub fn at(&self, step: f64) -> f64 {
        let fraction = if self.steps > 0.0 { (step / self.steps).clamp(0.0, 1.0) } else { 1.0 };
        self.first * (self.last / self.first).powf(fraction)
    }
}

/// First and second moments of one group of f64 parameters.
#[derive(Clone, Debug)]
pub struct Adam {
    mean: Vec<f64>,
    square: Vec<f64>,
    step: i32,
}

impl Adam {
    /// For a group of `count` parameters.
    pub fn new(count: usize) -> Self {
        Self { mean: vec![0.0; count], square: vec![0.0; count], step: 0 }
    }

    /// One step with a rate for each parameter. A gradient that is not finite leaves its parameter alone.
    pub fn step(&mut self, parameters: &mut [f64], gradient: &[f64], rate: impl Fn(usize) -> f64) {
        self.step = self.step.saturating_add(1);
        let correct1 = 1.0 / (1.0 - BETA1.powi(self.step));
        let correct2 = 1.0 / (1.0 - BETA2.powi(self.step));
        for (k, (parameter, &gradient)) in parameters.iter_mut().zip(gradient).enumerate() {
            if !gradient.is_finite() {
                continue;
            }
            self.mean[k] = BETA1 * self.mean[k] + (1.0 - BETA1) * gradient;
            self.square[k] = BETA2 * self.square[k] + (1.0 - BETA2) * gradient * gradient;
            *parameter -= rate(k) * self.mean[k] * correct1 / ((self.square[k] * correct2).sqrt() + EPSILON);
        }
    }
}

/// The same for f32 parameters, as the network holds them; the moments are f32 too.
#[derive(Clone, Debug)]
pub struct AdamF32 {
    mean: Vec<f32>,
    square: Vec<f32>,
    step: i32,
}

impl AdamF32 {
    /// For a group of `count` parameters.
    pub fn new(count: usize) -> Self {
        Self { mean: vec![0.0; count], square: vec![0.0; count], step: 0 }
    }

    /// One step. A gradient that is not finite leaves its parameter alone.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], rate: f64) {
        self.step = self.step.saturating_add(1);
        let (b1, b2) = (BETA1 as f32, BETA2 as f32);
        let rate = (rate / (1.0 - BETA1.powi(self.step))) as f32;
        let correct2 = (1.0 / (1.0 - BETA2.powi(self.step))) as f32;
        for (((parameter, &gradient), mean), square) in
            parameters.iter_mut().zip(gradient).zip(&mut self.mean).zip(&mut self.square)
        {
            if gradient.is_finite() {
                *mean = b1 * *mean + (1.0 - b1) * gradient;
                *square = b2 * *square + (1.0 - b2) * gradient * gradient;
                *parameter -= rate * *mean / ((*square * correct2).sqrt() + EPSILON as f32);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_schedule_runs_from_first_to_last() {
        let schedule = Schedule { first: 9e-3, last: 3e-4, steps: 60_000.0 };
        assert_eq!(schedule.at(0.0), 9e-3);
        assert!((schedule.at(60_000.0) - 3e-4).abs() < 1e-12 && (schedule.at(1e9) - 3e-4).abs() < 1e-12);
        assert!((schedule.at(30_000.0) - (9e-3f64 * 3e-4).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_bowl_is_descended_and_poison_is_ignored() {
        let (mut p, mut adam) = ([3.0, -2.0, 5.0], Adam::new(3));
        for _ in 0..3000 {
            let gradient = [2.0 * (p[0] - 1.0), 8.0 * (p[1] - 1.0), f64::NAN];
            adam.step(&mut p, &gradient, |_| 1e-2);
        }
        assert!((p[0] - 1.0).abs() < 1e-3 && (p[1] - 1.0).abs() < 1e-3 && p[2] == 5.0, "{p:?}");
    }
}
