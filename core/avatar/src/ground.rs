//! What keeps the avatar whole where no training frame saw it well: the back of the head, behind the ears, the sides.
//!
//! Every Gaussian carries a doubt in [0, 1]: 0 where the frames looked at faced its place on the mesh, 1 where none did. In
//! proportion to it the Gaussian is held to what it was laid out as (an opaque disc flat on the mesh that moves with the
//! mesh), at the depth of its neighbours, and its colour and material are spread over the surface from those that were
//! seen: hair into hair, skin into skin. So what was never seen is plain, closed and smooth, and what was seen is untouched.

use rayon::prelude::*;

use crate::canonical::{Canonical, Group};
use crate::coherent::Neighbours;
use crate::density::Round;

/// Shares by which a wholly doubtful Gaussian is drawn to its rest each time, at the start; they fall with the rates, or
/// they would win in the end. Small where pictures are to have the last word wherever they say anything: a Gaussian that
/// sticks out of the outline may shrink and fade.
const POSITION_SHARE: f32 = 0.3;
const SCALE_SHARE: f32 = 0.1;
const OPACITY_SHARE: f32 = 0.02;
const OTHER_SHARE: f32 = 0.5;
/// Sweeps of the last spreading of colours (Gauss and Seidel's, to and fro). Neighbourhood is not mutual, so none overshoots.
const SWEEPS: usize = 200;
/// How much more doubtful than the surest of its kind a Gaussian may be to be one of those seen best.
const SURE: f32 = 0.05;
/// Weight of a Gaussian's own colour against one neighbour's, times its doubt, at little doubt; and the doubt over which it
/// falls by e besides: outlines carry the background's colour.
const OWN_COLOR: f32 = 1.0;
const COLOR_DOUBT: f32 = 0.08;
/// Pixels that a Gaussian makes in some frame from which its own colour is rather kept than replaced in the end.
const SHOWN_PX: f32 = 0.3;
/// Doubt from which a Gaussian is kept whatever it gives to the pictures.
const KEPT: f32 = 0.5;

/// The groups that are held to their rest; positions are held on their own terms.
const HELD: [Group; 5] = [Group::LogScales, Group::Rotations, Group::Opacities, Group::Bases, Group::Weights];
/// The groups that are spread.
const SPREAD: [Group; 3] = [Group::Albedos, Group::Roughness, Group::Reflectances];

/// `Ground` of `ground.wgsl`.
pub(crate) fn constants([count, modes]: [usize; 2], decay: f32) -> [u32; 12] {
    let shares = [decay, OWN_COLOR, COLOR_DOUBT, POSITION_SHARE, SCALE_SHARE, OPACITY_SHARE, OTHER_SHARE];
    let [decay, own, doubt, position, scale, opacity, other] = shares.map(f32::to_bits);
    [count as u32, modes as u32, decay, own, doubt, position, scale, opacity, other, 0, 0, 0]
}

/// Gaussians as they were laid out, and how little is known of each.
#[derive(Clone, Debug)]
pub(crate) struct Ground {
    /// As laid out.
    pub rest: Canonical,
    /// Doubt of each, in [0, 1].
    pub doubt: Vec<f32>,
    /// 1 for hair, 0 for anything else: colours are spread among equals.
    pub kind: Vec<u8>,
}

impl Ground {
    /// Whether density control leaves the Gaussian as it is.
    pub fn keeps(&self, index: usize) -> bool {
        self.doubt.get(index).is_some_and(|doubt| *doubt >= KEPT)
    }

    /// Draws what is doubtful to its rest, `decay` times the full shares.
    pub fn hold(&self, canonical: &mut Canonical, neighbours: &Neighbours, decay: f32) {
        self.hold_positions(canonical, neighbours, decay);
        let widths = canonical.widths();
        let rest = self.rest.groups();
        for (group, values) in canonical.groups_mut().into_iter().enumerate() {
            let Some(held) = HELD.iter().position(|held| *held as usize == group && widths[group] > 0) else {
                continue;
            };
            let share = decay
                * match HELD[held] {
                    Group::LogScales => SCALE_SHARE,
                    Group::Opacities => OPACITY_SHARE,
                    _ => OTHER_SHARE,
                };
            let rows = values.par_chunks_mut(widths[group]).zip(rest[group].par_chunks(widths[group]));
            rows.zip(&self.doubt).filter(|(_, doubt)| **doubt > 0.0).for_each(|((values, rest), doubt)| {
                values.iter_mut().zip(rest).for_each(|(value, rest)| *value += share * doubt * (rest - *value));
            });
        }
        self.spread(canonical, neighbours, decay);
    }

    /// Positions: along the surface to the place of rest, along the normal to the neighbours' displacement.
    fn hold_positions(&self, canonical: &mut Canonical, neighbours: &Neighbours, decay: f32) {
        let rest = &self.rest;
        let along = |canonical: &Canonical, index: usize, normal: [f32; 3]| -> f32 {
            let start = 3 * index;
            (0..3).map(|k| normal[k] * (canonical.positions[start + k] - rest.positions[start + k])).sum()
        };
        let share = POSITION_SHARE * decay;
        let moved: Vec<[f32; 3]> = (0..canonical.len())
            .into_par_iter()
            .map(|index| {
                let (here, doubt) = (canonical.position(index), self.doubt[index]);
                if doubt == 0.0 {
                    return here;
                }
                let normal = rest.normal(index);
                let (sum, count) = neighbours.of(index).fold((0.0, 0.0), |(sum, count), other| {
                    (sum + along(canonical, other, rest.normal(other)), count + 1.0)
                });
                let height = if count > 0.0 { sum / count } else { 0.0 };
                let home = rest.position(index);
                std::array::from_fn(|k| here[k] + share * doubt * (home[k] + height * normal[k] - here[k]))
            })
            .collect();
        canonical.positions.copy_from_slice(moved.as_flattened());
    }

    /// Spreads colours and materials by a share of one step into what is doubtful.
    fn spread(&self, canonical: &mut Canonical, neighbours: &Neighbours, share: f32) {
        let widths = canonical.widths();
        for group in SPREAD {
            let (width, values) = (widths[group as usize], &mut *canonical.groups_mut()[group as usize]);
            let before = values.clone();
            values.par_chunks_mut(width).enumerate().for_each(|(index, values)| {
                let doubt = self.doubt[index];
                for (k, value) in values.iter_mut().enumerate().filter(|_| doubt > 0.0) {
                    *value += share * doubt * (self.drawn(&before, *value, neighbours, (index, k, width)) - *value);
                }
            });
        }
    }

    /// A number between a Gaussian's own and its equals' around it, as its doubt has it. `k` of `width` numbers of `index`.
    fn drawn(
        &self,
        values: &[f32],
        own: f32,
        neighbours: &Neighbours,
        (index, k, width): (usize, usize, usize),
    ) -> f32 {
        let doubt = self.doubt[index];
        let weight = OWN_COLOR / doubt.max(1e-6) * (-doubt / COLOR_DOUBT).exp();
        let near = neighbours.of(index).filter(|&other| self.kind[other] == self.kind[index]);
        let (sum, count) = near.fold((0.0, 0.0), |(sum, count), other| (sum + values[width * other + k], count + 1.0));
        (weight * own + sum) / (weight + count).max(1e-12)
    }

    /// The last word: what no picture shows takes the colours and materials that spread over the surface from what was
    /// surely seen; what pictures do show keeps its own in proportion to the pixels that it makes at most (`shown`).
    pub fn finish(&self, canonical: &mut Canonical, neighbours: &Neighbours, shown: &[f32]) {
        let widths = canonical.widths();
        for group in SPREAD {
            let (width, values) = (widths[group as usize], &mut *canonical.groups_mut()[group as usize]);
            let mut spread = self.outset(values, width);
            for sweep in 0..SWEEPS {
                for step in 0..self.doubt.len() {
                    let index = if sweep % 2 == 0 { step } else { self.doubt.len() - 1 - step };
                    if self.doubt[index] > 0.0 {
                        for k in 0..width {
                            let (at, place) = (width * index + k, (index, k, width));
                            spread[at] = self.drawn(&spread, values[at], neighbours, place);
                        }
                    }
                }
            }
            let rows = values.chunks_mut(width).zip(spread.chunks(width));
            for (((values, spread), doubt), shown) in rows.zip(&self.doubt).zip(shown) {
                let share = doubt.sqrt() / (1.0 + (shown / SHOWN_PX).powi(2));
                values.iter_mut().zip(spread).for_each(|(value, spread)| *value += share * (spread - *value));
            }
        }
    }

    /// What the last spreading starts from: the doubtful as the mean of what was seen best of their kind.
    fn outset(&self, values: &[f32], width: usize) -> Vec<f32> {
        let mut out = values.to_vec();
        for kind in [0, 1] {
            let of_kind = |index: &usize| self.kind[*index] == kind;
            let of_all: Vec<usize> = (0..self.doubt.len()).filter(of_kind).collect();
            let least = of_all.iter().map(|&i| self.doubt[i]).fold(1.0, f32::min);
            let sure: Vec<usize> = of_all.into_iter().filter(|&i| self.doubt[i] <= least + SURE).collect();
            let mean =
                |k: usize| sure.iter().map(|i| f64::from(values[width * i + k])).sum::<f64>() / sure.len() as f64;
            let means: Vec<f32> = (0..width).map(|k| mean(k) as f32).collect();
            for index in (0..self.doubt.len()).filter(of_kind).filter(|&i| !sure.is_empty() && self.keeps(i)) {
                out[width * index..width * (index + 1)].copy_from_slice(&means);
            }
        }
        out
    }

    /// After a round of density control: a child's rest is its parent's, moved and shrunk as the split did it.
    pub fn regroup(&mut self, round: &Round, before: &Canonical) {
        let mut rest = self.rest.gather(&round.parents);
        let parents = before.gather(&round.parents);
        let shift = |to: &mut [f32], now: &[f32], before: &[f32]| {
            to.iter_mut().zip(now.iter().zip(before)).for_each(|(to, (now, before))| *to += now - before);
        };
        shift(&mut rest.positions, &round.canonical.positions, &parents.positions);
        shift(&mut rest.log_scales, &round.canonical.log_scales, &parents.log_scales);
        self.rest = rest;
        self.doubt = round.parents.iter().map(|&parent| self.doubt[parent as usize]).collect();
        self.kind = round.parents.iter().map(|&parent| self.kind[parent as usize]).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of Gaussians 4 mm apart: the left half surely seen and red, the right half never seen; the last is hair.
    fn strip() -> (Canonical, Ground, Neighbours) {
        let mut canonical = Canonical::zeros(20, 1);
        canonical.rotations.chunks_mut(4).for_each(|q| q[0] = 1.0);
        canonical.positions.iter_mut().step_by(3).enumerate().for_each(|(i, x)| *x = 0.004 * i as f32);
        canonical.opacity_logits.fill(3.0);
        canonical.albedo_logits[..30].as_chunks_mut::<3>().0.fill([2.0, -1.0, -1.0]);
        let doubt = (0..20).map(|i| if i < 10 { 0.0 } else { 1.0 }).collect();
        let kind = (0..20).map(|i| u8::from(i == 19)).collect();
        let ground = Ground { rest: canonical.clone(), doubt, kind };
        let neighbours = Neighbours::new(&canonical);
        (canonical, ground, neighbours)
    }

    #[test]
    fn the_unseen_comes_home_at_its_neighbours_height_and_the_seen_stays() {
        let (mut canonical, ground, neighbours) = strip();
        let moved = |canonical: &mut Canonical, index: usize| {
            (canonical.positions[3 * index + 1], canonical.opacity_logits[index]) = (0.02, -2.0);
        };
        moved(&mut canonical, 3);
        moved(&mut canonical, 15);
        // All stand 5 mm above their rest along the normal.
        canonical.positions.iter_mut().skip(2).step_by(3).for_each(|z| *z += 0.005);
        for _ in 0..400 {
            ground.hold(&mut canonical, &neighbours, 1.0);
        }
        assert_eq!((canonical.positions[3 * 3 + 1], canonical.opacity_logits[3]), (0.02, -2.0));
        assert!(canonical.positions[3 * 15 + 1].abs() < 1e-4 && (canonical.opacity_logits[15] - 3.0).abs() < 0.01);
        assert!((canonical.positions[3 * 15 + 2] - 0.005).abs() < 1e-4, "what all do is not undone");
    }

    #[test]
    fn colours_spread_among_equals_into_what_no_picture_shows() {
        let (mut canonical, ground, neighbours) = strip();
        let mut shown = vec![0.0; 20];
        shown[12] = 50.0;
        ground.finish(&mut canonical, &neighbours, &shown);
        let red = |index: usize| canonical.albedo_logits[3 * index];
        assert_eq!(red(4), 2.0);
        assert!((red(16) - 2.0).abs() < 0.2, "{}", red(16));
        assert!(red(12).abs() < 0.01, "what makes pixels keeps its colour");
        assert_eq!(red(19), 0.0, "hair takes no colour from skin");
    }

    #[test]
    fn children_of_a_split_inherit() {
        let (canonical, mut ground, _) = strip();
        let round = Round { canonical: canonical.gather(&[15, 3, 15]), parents: vec![15, 3, 15], kept: vec![None; 3] };
        let mut round = round;
        round.canonical.positions[0] += 0.001;
        ground.regroup(&round, &canonical);
        assert_eq!((ground.doubt.clone(), ground.kind.clone()), (vec![1.0, 0.0, 1.0], vec![0; 3]));
        assert!((ground.rest.positions[0] - canonical.positions[45] - 0.001).abs() < 1e-7);
        assert!(ground.keeps(0) && !ground.keeps(1) && !ground.keeps(99));
    }
}
