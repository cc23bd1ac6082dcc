//! What is kept coherent between neighbouring Gaussians, because pictures from the front alone do not decide it.
//!
//! Every few steps each Gaussian is drawn a little to the mean of its nearest neighbours: its displacement along its
//! normal (the depth that frontal views hardly see: pimples in profile) and, where it faces away from the viewer, its
//! albedo. The drawing falls with the rates, or it would win in the end. And no Gaussian may be a needle, or thicker than
//! it is wide. Motion bases are left alone: drawn together, too, they lose a decibel on collars and hair.

use rayon::prelude::*;

use crate::canonical::Canonical;

/// Neighbours of a Gaussian.
const NEIGHBOURS: usize = 6;
/// Neighbours are looked for in cells of this size and those around, metres; who has none there has none.
const CELL_METRES: f32 = 0.012;
/// Share by which a displacement along the normal is drawn to its neighbours' mean.
const DEPTH_SHARE: f32 = 0.3;
/// The same for the albedo of a Gaussian seen edge-on or from behind; it falls to 0 where the cosine reaches `FACING`.
const ALBEDO_SHARE: f32 = 0.3;
const FACING: f32 = 0.35;
/// Most of a disc's longer standard deviation over its shorter one.
const MOST_ELONGATION: f32 = 5.0;

/// `Sheet` of `coherent.wgsl`.
pub(crate) fn constants(count: usize, decay: f32) -> [u32; 8] {
    let [elongation, depth, albedo, facing] =
        [MOST_ELONGATION.ln(), DEPTH_SHARE, ALBEDO_SHARE, FACING].map(f32::to_bits);
    [count as u32, decay.to_bits(), elongation, depth, albedo, facing, 0, 0]
}

/// The nearest neighbours of every Gaussian in canonical space.
pub(crate) struct Neighbours(Vec<[u32; NEIGHBOURS]>);

/// Stands for a neighbour that is not there.
const NONE: u32 = u32::MAX;

impl Neighbours {
    /// Finds them.
    pub fn new(canonical: &Canonical) -> Self {
        let positions = canonical.positions.as_chunks::<3>().0;
        let cell = |p: &[f32; 3]| p.map(|x| (x / CELL_METRES).floor() as i32);
        let mut order: Vec<([i32; 3], u32)> =
            positions.iter().enumerate().map(|(index, p)| (cell(p), index as u32)).collect();
        order.sort_unstable();
        let nearest = |index: usize| {
            let here = positions[index];
            let [cx, cy, cz] = cell(&here);
            let mut found = [(f32::INFINITY, NONE); NEIGHBOURS];
            for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                // Cells along z lie one after the other.
                let (low, high) = ([cx + dx, cy + dy, cz - 1], [cx + dx, cy + dy, cz + 1]);
                let from = order.partition_point(|(cell, _)| *cell < low);
                for &(_, other) in order[from..].iter().take_while(|(cell, _)| *cell <= high) {
                    let there = positions[other as usize];
                    let squared: f32 = here.iter().zip(there).map(|(a, b)| (a - b) * (a - b)).sum();
                    insert(&mut found, (squared, other), index);
                }
            }
            found.map(|(_, other)| other)
        };
        Self((0..positions.len()).into_par_iter().map(nearest).collect())
    }

    /// One Gaussian's.
    pub fn of(&self, index: usize) -> impl Iterator<Item = usize> + Clone {
        self.0[index].iter().filter(|&&other| other != NONE).map(|&other| other as usize)
    }

    /// All of them, one Gaussian's together.
    pub fn rows(&self) -> &[u32] {
        self.0.as_flattened()
    }

    /// What [`Self::rows`] gave; nothing when it is not of `count` Gaussians.
    pub fn from_rows(rows: &[u32], count: usize) -> Option<Self> {
        let sound = rows.iter().all(|&row| row == NONE || (row as usize) < count);
        (sound && rows.len() == NEIGHBOURS * count).then(|| Self(rows.as_chunks::<NEIGHBOURS>().0.to_vec()))
    }

    /// Draws displacements from `rest` (`N×3`) along the normals together, and albedos where they are not faced, by `decay`
    /// times the full share.
    pub fn smooth(&self, canonical: &mut Canonical, rest: &[f32], decay: f32) {
        if self.0.len() != canonical.len() || rest.len() != canonical.positions.len() {
            return;
        }
        let of = |values: &[f32], index: usize| -> [f32; 3] { std::array::from_fn(|axis| values[3 * index + axis]) };
        let drawn: Vec<([f32; 3], [f32; 3])> = (0..canonical.len())
            .into_par_iter()
            .map(|index| {
                let (place, albedo) = (of(&canonical.positions, index), of(&canonical.albedo_logits, index));
                let near = self.of(index);
                let count = near.clone().count();
                if count == 0 {
                    return (place, albedo);
                }
                let normal = canonical.normal(index);
                let along = |index: usize| -> f32 {
                    (0..3).map(|k| normal[k] * (canonical.positions[3 * index + k] - rest[3 * index + k])).sum()
                };
                let pull = decay * DEPTH_SHARE * (near.clone().map(along).sum::<f32>() / count as f32 - along(index));
                let share = decay * ALBEDO_SHARE * (1.0 - normal[2].max(0.0) / FACING).max(0.0);
                let mean = |k: usize| near.clone().map(|other| canonical.albedo_logits[3 * other + k]).sum::<f32>();
                (
                    std::array::from_fn(|k| place[k] + pull * normal[k]),
                    std::array::from_fn(|k| albedo[k] + share * (mean(k) / count as f32 - albedo[k])),
                )
            })
            .collect();
        for (index, (place, albedo)) in drawn.into_iter().enumerate() {
            canonical.positions[3 * index..3 * index + 3].copy_from_slice(&place);
            canonical.albedo_logits[3 * index..3 * index + 3].copy_from_slice(&albedo);
        }
    }
}

/// Holds every Gaussian to the shape of a disc: not thicker than wide, and no needle.
pub(crate) fn hold_flat(canonical: &mut Canonical) {
    let elongation = MOST_ELONGATION.ln();
    canonical.log_scales.par_chunks_exact_mut(3).for_each(|scales| {
        let least = scales[0].min(scales[1]);
        scales[0] = scales[0].min(least + elongation);
        scales[1] = scales[1].min(least + elongation);
        scales[2] = scales[2].min(least);
    });
}

/// Keeps the nearest, equal ones in the order of their numbers.
fn insert(found: &mut [(f32, u32); NEIGHBOURS], new: (f32, u32), own: usize) {
    if new.1 as usize == own || !(new.0 < f32::INFINITY) {
        return;
    }
    let place = found.iter().position(|old| (new.0, new.1) < *old);
    if let Some(place) = place {
        found[place..].rotate_right(1);
        found[place] = new;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of Gaussians 4 mm apart, and one far away.
    fn sheet() -> Canonical {
        let mut canonical = Canonical::zeros(101, 2);
        for index in 0..100 {
            let place = [0.004 * (index % 10) as f32, 0.004 * (index / 10) as f32, 0.0];
            canonical.positions[3 * index..3 * index + 3].copy_from_slice(&place);
        }
        canonical.positions[300] = 1.0;
        canonical
    }

    #[test]
    fn the_nearest_are_found_and_a_lonely_one_has_none() {
        let neighbours = Neighbours::new(&sheet());
        let mut middle = neighbours.0[55];
        middle[..4].sort_unstable();
        assert_eq!(middle[..4], [45, 54, 56, 65]);
        assert_eq!(neighbours.0[100], [NONE; NEIGHBOURS]);
        assert!(Neighbours::new(&Canonical::zeros(0, 1)).0.is_empty());
    }

    #[test]
    fn a_pimple_goes_down_a_dent_of_all_stays_and_discs_stay_discs() {
        let mut canonical = sheet();
        canonical.rotations.chunks_mut(4).for_each(|q| q[0] = 1.0);
        let rest = canonical.positions.clone();
        canonical.positions.iter_mut().skip(2).step_by(3).for_each(|z| *z = 0.01);
        canonical.positions[3 * 55 + 2] = 0.03;
        let beside = canonical.positions[3 * 55];
        let neighbours = Neighbours::new(&sheet());
        for _ in 0..30 {
            neighbours.smooth(&mut canonical, &rest, 1.0);
        }
        assert!((canonical.positions[3 * 55 + 2] - 0.01).abs() < 2e-3);
        assert_eq!(canonical.positions[3 * 55], beside, "only along the normal");
        assert!((canonical.positions[3 * 5 + 2] - 0.01).abs() < 1e-3, "what all do is not undone");
        canonical.log_scales[..3].copy_from_slice(&[-4.0, -8.0, -3.0]);
        hold_flat(&mut canonical);
        let [a, b, c] = [0, 1, 2].map(|k| canonical.log_scales[k]);
        assert!((a - b - MOST_ELONGATION.ln()).abs() < 1e-6 && b == -8.0 && c == -8.0);
    }

    #[test]
    fn albedo_is_shared_only_where_nobody_looks() {
        let mut canonical = sheet();
        // The left half faces the viewer, the right half away.
        for index in 0..101 {
            canonical.rotations[4 * index + if index % 10 < 5 { 0 } else { 1 }] = 1.0;
        }
        canonical.albedo_logits[3 * 52] = 2.0;
        canonical.albedo_logits[3 * 58] = 2.0;
        let rest = canonical.positions.clone();
        let neighbours = Neighbours::new(&canonical);
        for _ in 0..10 {
            neighbours.smooth(&mut canonical, &rest, 1.0);
        }
        assert_eq!(canonical.albedo_logits[3 * 52], 2.0);
        assert!(canonical.albedo_logits[3 * 58] < 0.7);
    }
}
