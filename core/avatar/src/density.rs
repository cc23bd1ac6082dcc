//! Density control under a budget: Gaussians are taken from where no pixel needs them and put where pixels pull hardest.
//!
//! Between two rounds the projected-centre gradients and the blend weights of the frames drawn are collected. A round
//! drops what contributes least, then splits the Gaussians with the largest mean gradient: a large one into two smaller
//! ones along its longer tangent axis, a small one into two in place. Nothing is random, so equal runs are equal.

use heartian_splat::{SceneGradients, logit, sigmoid};

use crate::canonical::Canonical;

/// A Gaussian whose largest share of any frame is less than this many pixels is dropped.
const LEAST_PIXELS: f32 = 0.02;
/// A Gaussian below this opacity is dropped.
const LEAST_OPACITY: f32 = 0.02;
/// A Gaussian larger than this, pixels, of which no frame showed this part is dropped: it hides behind others, and would
/// float beside the head when that turns.
const LARGE_PX: f32 = 2.0;
const LEAST_SHOWN: f32 = 0.04;
/// At most this part of the Gaussians is split in one round.
const MOST_SPLIT: f32 = 0.06;
/// Children of a split are this much smaller along the split axis, and lie half a standard deviation to either side.
const CHILD_SHRINK: f32 = 1.6;

/// What happened to each Gaussian between two rounds.
#[derive(Clone, Debug, Default)]
pub(crate) struct Statistics {
    pub gradient_sum: Vec<f32>,
    pub frames: Vec<u32>,
    pub most_pixels: Vec<f32>,
}

impl Statistics {
    /// Nothing seen yet of `count` Gaussians.
    pub fn new(count: usize) -> Self {
        Self { gradient_sum: vec![0.0; count], frames: vec![0; count], most_pixels: vec![0.0; count] }
    }

    /// Adds one frame.
    pub fn add(&mut self, gradients: &SceneGradients) {
        for (index, ([gx, gy], weight)) in gradients.means_px.iter().zip(&gradients.weights).enumerate() {
            if *weight > 0.0 && gx.is_finite() && gy.is_finite() {
                self.gradient_sum[index] += gx.hypot(*gy);
                self.frames[index] += 1;
                self.most_pixels[index] = self.most_pixels[index].max(*weight);
            }
        }
    }

    /// Mean gradient over the frames in which the Gaussian was drawn.
    fn pull(&self, index: usize) -> f32 {
        self.gradient_sum[index] / self.frames[index].max(1) as f32
    }
}

/// One round: the new Gaussians and, for each, the old one it comes from, and the one whose moments it keeps.
pub(crate) struct Round {
    pub canonical: Canonical,
    pub parents: Vec<u32>,
    pub kept: Vec<Option<u32>>,
}

/// Prunes and splits; the result has at most `budget` Gaussians and never none if there was one worth keeping.
/// What `keeps` names is not split, and dropped only where pictures made it transparent. `pixels_per_metre` is the size of the head in the pictures.
pub(crate) fn control(
    canonical: &Canonical,
    statistics: &Statistics,
    keeps: impl Fn(usize) -> bool,
    (budget, pixels_per_metre): (usize, f32),
) -> Round {
    let alive: Vec<u32> = (0..canonical.len() as u32)
        .filter(|&index| {
            let i = index as usize;
            let unseen = statistics.frames[i] > 0 && statistics.most_pixels[i] < LEAST_PIXELS;
            let needed = !unseen && !is_hidden(canonical, statistics, i, pixels_per_metre) && statistics.frames[i] > 0;
            (needed || keeps(i)) && canonical.opacity(i) >= LEAST_OPACITY
        })
        .collect();
    let room = budget.saturating_sub(alive.len()).min((MOST_SPLIT * alive.len() as f32) as usize);
    let mut by_pull: Vec<u32> = alive.iter().copied().filter(|&index| !keeps(index as usize)).collect();
    by_pull.sort_by(|&a, &b| statistics.pull(b as usize).total_cmp(&statistics.pull(a as usize)).then(a.cmp(&b)));
    by_pull.truncate(room);
    let mut next = canonical.gather(&alive);
    let mut kept: Vec<Option<u32>> = alive.iter().map(|&index| Some(index)).collect();
    let mut parents = alive.clone();
    for parent in by_pull {
        let Ok(row) = alive.binary_search(&parent) else { continue };
        let child = split(&mut next, row);
        append(&mut next, &child);
        kept[row] = None;
        kept.push(None);
        parents.push(parent);
    }
    Round { canonical: next, parents, kept }
}

/// Whether a large Gaussian never showed more than a small part of itself.
fn is_hidden(canonical: &Canonical, statistics: &Statistics, index: usize, pixels_per_metre: f32) -> bool {
    let [a, b] = [0, 1].map(|axis| canonical.log_scales[3 * index + axis].exp() * pixels_per_metre);
    let whole = std::f32::consts::TAU * a * b * canonical.opacity(index);
    a.max(b) > LARGE_PX && statistics.most_pixels[index] < LEAST_SHOWN * whole
}

/// Shrinks the Gaussian at `row` and moves it half a deviation along its longer tangent axis; returns its twin on the
/// other side. Opacity is shared out so that the pair covers about what the parent did.
fn split(canonical: &mut Canonical, row: usize) -> Canonical {
    let scales: [f32; 3] = std::array::from_fn(|i| canonical.log_scales[3 * row + i]);
    let axis = usize::from(scales[1] > scales[0]);
    let direction = local_axis(canonical, row, axis);
    let offset = 0.5 * scales[axis].exp();
    canonical.log_scales[3 * row + axis] -= CHILD_SHRINK.ln();
    let opacity = sigmoid(canonical.opacity_logits[row]);
    canonical.opacity_logits[row] = logit(1.0 - (1.0 - opacity).powf(0.8));
    let mut twin = canonical.gather(&[row as u32]);
    for i in 0..3 {
        canonical.positions[3 * row + i] += offset * direction[i];
        twin.positions[i] -= offset * direction[i];
    }
    twin
}

/// Column `axis` of the rotation matrix of a Gaussian's quaternion.
fn local_axis(canonical: &Canonical, row: usize, axis: usize) -> [f32; 3] {
    let q: [f32; 4] = std::array::from_fn(|i| canonical.rotations[4 * row + i]);
    let q = glam::Quat::from_xyzw(q[1], q[2], q[3], q[0]);
    let unit = if q.length_squared() > 1e-12 { q.normalize() } else { glam::Quat::IDENTITY };
    (unit * glam::Vec3::AXES[axis]).to_array()
}

fn append(canonical: &mut Canonical, rows: &Canonical) {
    for (to, from) in canonical.groups_mut().into_iter().zip(rows.groups()) {
        to.extend_from_slice(from);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(count: usize) -> Canonical {
        let mut canonical = Canonical::zeros(count, 2);
        canonical.opacity_logits.fill(2.0);
        canonical.log_scales.fill(-6.0);
        canonical.rotations.chunks_mut(4).for_each(|q| q[0] = 1.0);
        for (index, x) in canonical.positions.iter_mut().enumerate() {
            *x = index as f32;
        }
        canonical
    }

    fn seen(pull: &[f32], pixels: &[f32]) -> Statistics {
        let mut statistics = Statistics::new(pull.len());
        statistics.add(&SceneGradients {
            means_px: pull.iter().map(|p| [*p, 0.0]).collect(),
            weights: pixels.to_vec(),
            ..SceneGradients::default()
        });
        statistics
    }

    #[test]
    fn what_no_pixel_needs_goes_and_the_hardest_pulled_splits() {
        let mut canonical = scene(40);
        canonical.opacity_logits[3] = -8.0;
        let mut pull = vec![0.1; 40];
        pull[7] = 5.0;
        pull[9] = f32::NAN;
        let mut pixels = vec![1.0; 40];
        pixels[5] = 0.0;
        pixels[6] = 1e-4;
        let round = control(&canonical, &seen(&pull, &pixels), |_| false, (39, 500.0));
        assert!(round.canonical.is_consistent() && round.canonical.first_not_finite().is_none());
        for gone in [3, 5, 6, 9] {
            assert!(!round.kept.contains(&Some(gone)), "{gone}");
        }
        let kept = control(&canonical, &seen(&pull, &pixels), |i| [3, 5, 7].contains(&i), (39, 500.0)).kept;
        assert!(kept.contains(&Some(5)) && kept.contains(&Some(7)) && !kept.contains(&Some(3)), "not the transparent");
        assert_eq!(round.canonical.len(), round.kept.len());
        assert_eq!(round.kept.iter().filter(|k| k.is_none()).count(), 4, "two parents, two twins");
        let total: f32 = (0..round.canonical.len())
            .filter(|i| round.kept[*i].is_none())
            .map(|i| round.canonical.positions[3 * i])
            .filter(|x| (x - 21.0).abs() < 0.1)
            .sum();
        assert!((total - 42.0).abs() < 1e-3, "the children lie to either side of the parent");
    }

    #[test]
    fn a_large_one_that_hides_behind_others_goes() {
        let mut canonical = scene(10);
        // 3 mm are 3 pixels of standard deviation here: 50 pixels in all at this opacity.
        canonical.log_scales[3 * 4] = 0.003f32.ln();
        canonical.log_scales[3 * 4 + 1] = 0.003f32.ln();
        let gone = |pixels: f32| {
            let mut seen_of = [1.0; 10];
            seen_of[4] = pixels;
            !control(&canonical, &seen(&[0.1; 10], &seen_of), |_| false, (10, 1000.0)).kept.contains(&Some(4))
        };
        assert!(gone(1.5) && !gone(10.0));
    }

    #[test]
    fn the_budget_holds() {
        let canonical = scene(100);
        for budget in [0, 50, 100, 103, 1000] {
            let round = control(&canonical, &seen(&[1.0; 100], &[1.0; 100]), |_| false, (budget, 500.0));
            assert!(round.canonical.len() <= budget.max(100));
        }
    }
}
