//! The frozen renderer without the linear map: every step renders one training frame and pulls its loss back through
//! the rasteriser, as the paper's frame-level iterations do. Slow; it is what the linear map is judged by.
//!
//! Plain data still: whoever owns Gaussians hands in a function of (frame, one offset a skin Gaussian).

use std::cell::RefCell;

use crate::error::{PulseError, check_length};
use crate::numeric::Random;
use crate::render_loss::{BaseLoss, FrozenRenderer};

/// Renders `frame` with `offsets` on its skin's green albedo, one a skin Gaussian, and compares it with the recording:
/// returns L_base of that frame and **adds** its gradient with respect to the offsets. An error is told in words.
pub type RenderFrame<'a> = &'a dyn Fn(usize, &[f32], &mut [f32]) -> Result<f64, String>;

/// A frozen renderer that is asked for one frame a step, all training frames once an epoch in seeded random order.
pub struct FrameByFrame<'a> {
    /// Number of skin Gaussians.
    pub gaussians: usize,
    /// Training frames: 0 up to this.
    pub frames: usize,
    /// 8-bit levels on the picture for one unit of uniform albedo offset.
    pub levels_per_albedo: Option<f64>,
    /// Seed of the order of frames.
    pub seed: u64,
    /// Renders a frame.
    pub render: RenderFrame<'a>,
}

impl FrozenRenderer for FrameByFrame<'_> {
    fn gaussians(&self) -> usize {
        self.gaussians
    }

    fn levels_per_albedo(&self) -> Option<f64> {
        self.levels_per_albedo
    }

    fn base_loss<'a>(&'a self, group_of: &[usize], groups: usize) -> Result<Box<dyn BaseLoss + 'a>, PulseError> {
        check_length("the group of each skin Gaussian", self.gaussians, group_of.len())?;
        let order = RefCell::new(Order { waiting: Vec::new(), random: Random::new(self.seed) });
        Ok(Box::new(Steps { renderer: self, group_of: group_of.to_vec(), groups, order }))
    }
}

/// Frames still to be seen this epoch.
struct Order {
    waiting: Vec<usize>,
    random: Random,
}

impl Order {
    fn next(&mut self, frames: usize) -> usize {
        if self.waiting.is_empty() {
            self.waiting = (0..frames.max(1)).collect();
            for k in (1..self.waiting.len()).rev() {
                self.waiting.swap(k, self.random.below(k + 1));
            }
        }
        self.waiting.pop().unwrap_or(0)
    }
}

struct Steps<'a> {
    renderer: &'a FrameByFrame<'a>,
    group_of: Vec<usize>,
    groups: usize,
    order: RefCell<Order>,
}

impl BaseLoss for Steps<'_> {
    fn evaluate(&self, offsets: &[f64], scale: f64, gradient: &mut [f64]) -> Result<f64, PulseError> {
        let frame = self.order.borrow_mut().next(self.renderer.frames);
        let at = frame * self.groups;
        let Some(shared) = offsets.get(at..at + self.groups) else { return Ok(0.0) };
        let each: Vec<f32> = self.group_of.iter().map(|&group| shared[group] as f32).collect();
        let mut pulled = vec![0.0; each.len()];
        let loss = (self.renderer.render)(frame, &each, &mut pulled).map_err(PulseError::Renderer)?;
        for (&group, pulled) in self.group_of.iter().zip(pulled) {
            gradient[at + group] += scale * f64::from(pulled);
        }
        Ok(loss)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_epoch_sees_every_frame_once_and_pulls_on_its_own_offsets_alone() {
        let seen = RefCell::new(Vec::new());
        let render = |frame: usize, offsets: &[f32], gradient: &mut [f32]| {
            seen.borrow_mut().push(frame);
            gradient.iter_mut().for_each(|g| *g += 0.5);
            Ok(offsets.iter().map(|o| f64::from(*o)).sum())
        };
        let renderer = FrameByFrame { gaussians: 3, frames: 5, levels_per_albedo: None, seed: 4, render: &render };
        let loss = renderer.base_loss(&[0, 1, 1], 2).unwrap();
        let offsets: Vec<f64> = (0..10).map(f64::from).collect();
        let mut gradient = vec![0.0; 10];
        let losses: f64 = (0..5).map(|_| loss.evaluate(&offsets, 2.0, &mut gradient).unwrap()).sum();
        assert_eq!(losses, (0..5).map(|f| f64::from(2 * f + 2 * (2 * f + 1))).sum::<f64>());
        assert_eq!(gradient, [1.0, 2.0].repeat(5));
        let mut order = seen.borrow().clone();
        order.sort_unstable();
        assert_eq!(order, [0, 1, 2, 3, 4]);
        assert!(renderer.base_loss(&[0], 1).is_err());
        let refuses = |_: usize, _: &[f32], _: &mut [f32]| Err("no light".to_owned());
        let broken = FrameByFrame { render: &refuses, ..renderer };
        let error = broken.base_loss(&[0; 3], 1).unwrap().evaluate(&offsets, 1.0, &mut gradient).unwrap_err();
        assert!(error.to_string().contains("no light"));
    }
}
