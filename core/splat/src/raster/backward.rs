//! The backward kernel of one tile, in lane code. Twin of `reference/composite.rs`.
//!
//! It walks front to back as the forward kernel does and repeats its arithmetic, so both take the same decisions bit for
//! bit; what lies behind a splat is the pixel's whole sum less what has been passed.

use super::{BATCH, Batch, Plane, RECORD_HEAD, TileJob, alive, blend};
use crate::bin::TILE_WIDTH;
use crate::lanes::{Lanes, dispatched};
use crate::project::ALPHA_MAX;

/// Floats of an entry's gradient slot before its feature gradients: six moments of dL/dp, the blend weight, one spare.
pub(crate) const SLOT_HEAD: usize = 8;

/// What the backward kernel reads of the picture and of the loss's gradient; padding channels are empty.
#[derive(Clone, Copy)]
pub(crate) struct PlaneGradients<'a, const C: usize> {
    pub values: [&'a [f32]; C],
    pub gradients: [&'a [f32]; C],
    pub transmittance: &'a [f32],
    /// Gradient with respect to transmittance; may be empty.
    pub on_transmittance: &'a [f32],
    pub width: usize,
}

/// The slots of all entries, stride `SLOT_HEAD + C`, written by tiles.
#[derive(Clone, Copy)]
pub(crate) struct Slots(pub *mut f32);
// SAFETY: an entry's slot is written by its tile only; the owner outlives the parallel loop.
unsafe impl Send for Slots {}
// SAFETY: as above.
unsafe impl Sync for Slots {}

/// Copies a tile's share of the loss's gradient, and forms what lies behind the first splat: `Σ value·gradient`.
#[inline(always)]
fn load_gradients<const C: usize>(
    job: &TileJob,
    picture: &PlaneGradients<C>,
    gradients: &mut [Plane; C],
    behind: &mut Plane,
) {
    for row in 0..job.size[1] {
        let from = (job.origin[1] + row) * picture.width + job.origin[0];
        let (range, at) = (from..from + job.size[0], row * TILE_WIDTH..row * TILE_WIDTH + job.size[0]);
        let behind = &mut behind.0[at.clone()];
        let channels = gradients.iter_mut().zip(&picture.values).zip(&picture.gradients);
        for ((plane, value), gradient) in channels.filter(|((_, value), _)| !value.is_empty()) {
            plane.0[at.clone()].copy_from_slice(&gradient[range.clone()]);
            for ((b, v), g) in behind.iter_mut().zip(&value[range.clone()]).zip(&gradient[range.clone()]) {
                *b += v * g;
            }
        }
        if !picture.on_transmittance.is_empty() {
            let (t, g) = (&picture.transmittance[range.clone()], &picture.on_transmittance[range]);
            for ((b, t), g) in behind.iter_mut().zip(t).zip(g) {
                *b += t * g;
            }
        }
    }
}

/// A tile on the way back: transmittance in front of the next splat, what lies behind it, and the loss's gradient.
pub(super) struct State<const C: usize> {
    pub transmittance: Plane,
    pub behind: Plane,
    pub gradients: [Plane; C],
}

/// An entry's slot before its sums over lanes.
pub(super) struct Sums<V: Lanes, const C: usize> {
    pub moments: [V; SLOT_HEAD],
    pub on_features: [V; C],
}

impl<const C: usize> State<C> {
    /// Passes a splat in the pixels at `at`, which lie `dy` below its centre.
    ///
    /// # Safety
    /// Inside a function with the features of `V`; `at + V::N` pixels are a tile's.
    #[inline(always)]
    pub unsafe fn step<V: Lanes>(
        &mut self,
        (u, falloff, peak): (V, V, V),
        features: &[f32],
        (at, dy): (usize, V),
        sums: &mut Sums<V, C>,
    ) {
        // SAFETY: the caller's contract.
        unsafe {
            let Sums { moments, on_features } = sums;
            let t = self.transmittance.0.as_mut_ptr().add(at);
            let step = blend(u, falloff, peak, V::load(t));
            step.next.store(t);
            let mut towards = V::zero();
            for c in 0..C {
                let g = V::load(self.gradients[c].0.as_ptr().add(at));
                towards = g.mul_add(V::splat(features[c]), towards);
                on_features[c] = step.weight.mul_add(g, on_features[c]);
            }
            let behind = self.behind.0.as_mut_ptr().add(at);
            let own = step.weight.mul(towards);
            let rest = V::load(behind).sub(own);
            rest.store(behind);
            // α·dL/dα = α·T·(f·g) − α/(1−α)·(what lies behind); nothing flows where α was clamped.
            let free = V::both(step.drawn, step.raw.lt(V::splat(ALPHA_MAX)));
            let share = step.alpha.div(V::splat(1.0).sub(step.alpha));
            let dp = share.neg_mul_add(rest, own).keep(free);
            let (dp_u, dp_dy) = (dp.mul(u), dp.mul(dy));
            moments[0] = moments[0].add(dp);
            moments[1] = moments[1].add(dp_u);
            moments[2] = dp_u.mul_add(u, moments[2]);
            moments[3] = moments[3].add(dp_dy);
            moments[4] = dp_u.mul_add(dy, moments[4]);
            moments[5] = dp_dy.mul_add(dy, moments[5]);
            moments[6] = moments[6].add(step.weight);
        }
    }
}

/// Gradients of one tile's entries into their slots; those of entries behind a finished tile are zero. A slot holds
/// `Σ dp·{1, u, u², dy, u·dy, dy²}`, `Σ α·T`, a spare, and `Σ α·T·g` for each channel, where `dp` is the gradient of the
/// exponent, `u` the offset from the row's centre and `g` the loss's gradient.
///
/// # Safety
/// Inside a function with the features of `V`; the slots hold those of the tile's entries, which no other thread touches.
#[inline(always)]
unsafe fn backward_tile<V: Lanes, const C: usize>(job: &TileJob, picture: &PlaneGradients<C>, slots: Slots) {
    let mut state = State { transmittance: Plane::open(job.size), behind: Plane::ZERO, gradients: [Plane::ZERO; C] };
    load_gradients(job, picture, &mut state.gradients, &mut state.behind);
    let (mut batch, mut done) = (Batch::new(), 0);
    // SAFETY: as in `forward_tile`; a slot is one of the tile's own.
    unsafe {
        for from in (0..job.entries.len()).step_by(BATCH) {
            let open = alive::<V>(&state.transmittance);
            if open == 0 {
                break;
            }
            let count = batch.fill::<V, C>(job, from, open);
            done = from + count;
            for k in 0..count {
                let entry = job.entries[from + k];
                let slot = slots.0.add(entry.slot as usize * (SLOT_HEAD + C));
                if batch.vectors[k] == 0 {
                    slot.write_bytes(0, SLOT_HEAD + C);
                    continue;
                }
                let record = job.record::<C>(entry);
                let falloff = V::splat(record[4]);
                let mut sums = Sums { moments: [V::zero(); SLOT_HEAD], on_features: [V::zero(); C] };
                batch.for_each_vector::<V>(
                    k,
                    #[inline(always)]
                    |at, row, u, rows| {
                        let at = (at, V::splat(rows.dy[row]));
                        state.step((u, falloff, V::splat(rows.peak[row])), &record[RECORD_HEAD..], at, &mut sums);
                    },
                );
                write_sums(sums.moments, sums.on_features, slot);
            }
        }
        for entry in &job.entries[done..] {
            slots.0.add(entry.slot as usize * (SLOT_HEAD + C)).write_bytes(0, SLOT_HEAD + C);
        }
    }
}

/// Sums over lanes into a slot, eight vectors at a time.
///
/// # Safety
/// Inside a function with the features of `V`; the slot holds `SLOT_HEAD + C` values.
#[inline(always)]
unsafe fn write_sums<V: Lanes, const C: usize>(moments: [V; SLOT_HEAD], on_features: [V; C], slot: *mut f32) {
    // SAFETY: the caller's contract.
    unsafe {
        slot.cast::<[f32; SLOT_HEAD]>().write_unaligned(V::sum_eight(moments));
        let mut c = 0;
        while c + 4 < C {
            // The last eight may be cut short: what is missing counts as zero and is not written.
            let mut eight = [V::zero(); 8];
            let count = (C - c).min(8);
            eight[..count].copy_from_slice(&on_features[c..c + count]);
            let sums = V::sum_eight(eight);
            std::ptr::copy_nonoverlapping(sums.as_ptr(), slot.add(SLOT_HEAD + c), count);
            c += count;
        }
        for (k, vector) in on_features.into_iter().enumerate().skip(c) {
            slot.add(SLOT_HEAD + k).write(vector.sum());
        }
    }
}

dispatched! {
    /// [`backward_tile`] at the machine's level.
    ///
    /// Its contract: the slots hold those of the tile's entries, which no other tile's kernel shares.
    pub(crate) fn backward[const C: usize](job: &TileJob, picture: &PlaneGradients<C>, slots: Slots) = backward_tile;
}
