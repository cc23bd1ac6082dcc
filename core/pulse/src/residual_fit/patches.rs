//! Compact patches of skin of equal size, so that one Gaussian of each stands for the whole face in a training step.

use crate::numeric::Random;

/// A partition of n Gaussians into patches.
pub(super) struct Patches {
    /// Patch of each Gaussian.
    pub patch_of: Vec<usize>,
    /// Share of all Gaussians in each patch; sums to 1.
    pub share: Vec<f64>,
    members: Vec<Vec<usize>>,
}

impl Patches {
    /// Splits along the longest side at the median until there are `count` patches (at most one a Gaussian). `positions`
    /// holds at least one point.
    pub fn new(positions: &[[f32; 3]], count: usize) -> Self {
        let mut members = vec![(0..positions.len()).collect::<Vec<_>>()];
        while members.len() < count.min(positions.len()) {
            let largest =
                (0..members.len()).fold(0, |best, k| if members[k].len() > members[best].len() { k } else { best });
            let mut patch = std::mem::take(&mut members[largest]);
            let axis = longest_side(positions, &patch);
            patch.sort_by(|&a, &b| positions[a][axis].total_cmp(&positions[b][axis]).then(a.cmp(&b)));
            let upper = patch.split_off(patch.len() / 2);
            members[largest] = patch;
            members.push(upper);
        }
        let mut patch_of = vec![0; positions.len()];
        for (patch, members) in members.iter().enumerate() {
            members.iter().for_each(|&gaussian| patch_of[gaussian] = patch);
        }
        let share = members.iter().map(|members| members.len() as f64 / positions.len() as f64).collect();
        Self { patch_of, share, members }
    }

    pub fn len(&self) -> usize {
        self.members.len()
    }

    /// One Gaussian of each patch.
    pub fn draw(&self, random: &mut Random) -> Vec<usize> {
        self.members.iter().map(|members| members[random.below(members.len())]).collect()
    }
}

fn longest_side(positions: &[[f32; 3]], patch: &[usize]) -> usize {
    let side = |axis: usize| {
        let (low, high) = patch.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &k| {
            (low.min(positions[k][axis]), high.max(positions[k][axis]))
        });
        high - low
    };
    (1..3).fold(0, |best, axis| if side(axis) > side(best) { axis } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_partition_the_skin_evenly() {
        let mut random = Random::new(2);
        let points: Vec<[f32; 3]> = (0..1000).map(|_| std::array::from_fn(|_| random.normal() as f32)).collect();
        let patches = Patches::new(&points, 8);
        assert_eq!(patches.len(), 8);
        assert!(patches.share.iter().all(|share| (share - 0.125).abs() < 0.01));
        for (patch, gaussian) in patches.draw(&mut random).into_iter().enumerate() {
            assert_eq!(patches.patch_of[gaussian], patch);
        }
        assert_eq!(Patches::new(&points[..1], 8).len(), 1);
        assert_eq!(Patches::new(&[[0.0; 3]; 5], 8).len(), 5);
    }
}
