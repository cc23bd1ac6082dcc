//! The backward kernel of one tile, in lane code. Twin of `reference/composite.rs`.
//!
//! It walks front to back over the vectors that the forward kernel visited and repeats its arithmetic, so both take the same
//! decisions bit for bit; what lies behind a splat is the pixel's whole sum less what has been passed.

use super::{
    BATCH, Blocks, Brush, Constants, Plane, RECORD_HEAD, TileJob, VECTORS, blend, for_each_piece, for_each_vector,
    prefetch,
};
use crate::bin::Entry;
use crate::lanes::wide::each;
use crate::lanes::{Lanes, dispatched};

/// Floats of an entry's gradient slot before its feature gradients: six moments of dL/dp, and the blend weight.
pub(crate) const SLOT_HEAD: usize = 7;
/// Opacities from this base-2 logarithm on may be clamped: log2 of 0.99, less what rounding can add.
const LOG2_CLAMPED: f32 = -0.014_51;

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
    let first = job.origin[1] * picture.width + job.origin[0];
    let channels = gradients.iter_mut().zip(&picture.values).zip(&picture.gradients);
    for ((plane, value), gradient) in channels.filter(|((_, value), _)| !value.is_empty()) {
        for_each_piece(
            job.size,
            #[inline(always)]
            |column, row, at, count| {
                let from = first + row * picture.width + column;
                plane.0[at..at + count].copy_from_slice(&gradient[from..from + count]);
                add_products(&mut behind.0[at..], &value[from..], &gradient[from..], count);
            },
        );
    }
    if !picture.on_transmittance.is_empty() {
        for_each_piece(
            job.size,
            #[inline(always)]
            |column, row, at, count| {
                let from = first + row * picture.width + column;
                let (value, gradient) = (&picture.transmittance[from..], &picture.on_transmittance[from..]);
                add_products(&mut behind.0[at..], value, gradient, count);
            },
        );
    }
}

/// Adds the products of the first `count` values.
#[inline(always)]
fn add_products(sums: &mut [f32], values: &[f32], gradients: &[f32], count: usize) {
    for ((sum, value), gradient) in sums[..count].iter_mut().zip(&values[..count]).zip(&gradients[..count]) {
        *sum += value * gradient;
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

impl<V: Lanes, const C: usize> Sums<V, C> {
    /// The `k`-th of a slot's values.
    #[inline(always)]
    fn get(&self, k: usize) -> V {
        if k < SLOT_HEAD { self.moments[k] } else { self.on_features[k - SLOT_HEAD] }
    }
}

/// What is known of a vector of pixels before it is passed.
#[derive(Clone, Copy)]
pub(super) struct Seen<V: Lanes> {
    /// 0 below the cut.
    alpha: V,
    /// Offset from the row's centre.
    u: V,
}

impl<V: Lanes> Seen<V> {
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    pub unsafe fn none() -> Self {
        // SAFETY: the caller's contract.
        unsafe { Self { alpha: V::zero(), u: V::zero() } }
    }

    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn new<const CLAMPED: bool, const C: usize>(brush: &Brush<V, C>, at: usize) -> Self {
        // SAFETY: the caller's contract.
        unsafe {
            let offset = brush.ellipse.offset(at);
            Self { alpha: brush.alpha::<CLAMPED>(&offset), u: offset.u }
        }
    }
}

impl<const C: usize> State<C> {
    /// Passes a splat in all vectors of pixels that it visits.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    pub unsafe fn pass<V: Lanes, const CLAMPED: bool>(
        &mut self,
        brush: &Brush<V, C>,
        visited: Blocks,
        seen: &mut [Seen<V>; VECTORS],
        sums: &mut Sums<V, C>,
    ) {
        // SAFETY: the caller's contract.
        unsafe {
            for_each_vector(
                visited,
                #[inline(always)]
                |k, at| seen[k] = Seen::new::<CLAMPED, C>(brush, at),
            );
            for_each_vector(
                visited,
                #[inline(always)]
                |k, at| self.step::<V, CLAMPED>(brush, (at, seen[k]), sums),
            );
        }
    }

    /// Passes a splat in the pixels at `at`.
    ///
    /// # Safety
    /// Inside a function with the features of `V`; `at + V::N` pixels are a tile's.
    #[inline(always)]
    unsafe fn step<V: Lanes, const CLAMPED: bool>(
        &mut self,
        brush: &Brush<V, C>,
        (at, seen): (usize, Seen<V>),
        sums: &mut Sums<V, C>,
    ) {
        // SAFETY: the caller's contract.
        unsafe {
            let Sums { moments, on_features } = sums;
            let t = self.transmittance.0.as_mut_ptr().add(at);
            let (u, dy) = (seen.u, brush.ellipse.dy(at));
            let step = blend(seen.alpha, V::load(t), brush.constants);
            // Nobody asks what a finished pixel had left.
            step.next.keep(step.drawn).store(t);
            let mut towards = V::zero();
            for c in 0..C {
                let g = V::load(self.gradients[c].0.as_ptr().add(at));
                let feature = brush.features[c];
                towards = if c == 0 { g.mul(feature) } else { g.mul_add(feature, towards) };
                on_features[c] = step.weight.mul_add(g, on_features[c]);
            }
            let behind = self.behind.0.as_mut_ptr().add(at);
            let own = step.weight.mul(towards);
            let rest = V::load(behind).sub(own);
            rest.store(behind);
            // α·dL/dα = α·T·(f·g) − α/(1−α)·(what lies behind); nothing flows where α was clamped.
            let share = step.alpha.div(V::splat(1.0).sub(step.alpha));
            let mut dp = share.neg_mul_add(rest, own);
            if CLAMPED {
                dp = dp.keep(seen.alpha.lt(brush.constants.alpha_max));
            }
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
/// `Σ dp·{1, u, u², dy, u·dy, dy²}`, `Σ α·T`, and `Σ α·T·g` for each channel, where `dp` is the gradient of the
/// exponent, `u` the offset from the row's centre and `g` the loss's gradient.
///
/// # Safety
/// Inside a function with the features of `V`; `visited` is what the forward kernel noted; the slots hold those of the tile's
/// entries, which no other thread touches.
#[inline(always)]
unsafe fn backward_tile<V: Lanes, const C: usize>(
    job: &TileJob,
    visited: &[Blocks],
    picture: &PlaneGradients<C>,
    slots: Slots,
) {
    let mut state = State { transmittance: Plane::open(job.size), behind: Plane::ZERO, gradients: [Plane::ZERO; C] };
    load_gradients(job, picture, &mut state.gradients, &mut state.behind);
    let slot = |entry: Entry| slots.0.wrapping_add(entry.slot as usize * (SLOT_HEAD + C));
    // SAFETY: as in `forward_tile`; a slot is one of the tile's own.
    unsafe {
        let (constants, mut seen) = (Constants::<V>::new(), [Seen::none(); VECTORS]);
        for (k, (&entry, &visited)) in job.entries.iter().zip(visited).enumerate() {
            if let Some(&ahead) = job.entries.get(k + BATCH) {
                prefetch::<V>(job.record::<C>(ahead), RECORD_HEAD + C);
                // Slots lie far apart: without this every store behind one waits until its cache line has come.
                prefetch::<V>(slot(ahead), SLOT_HEAD + C);
            }
            if visited == 0 {
                slot(entry).write_bytes(0, SLOT_HEAD + C);
                continue;
            }
            let brush = &Brush::new(job.record::<C>(entry), job.origin, &constants);
            let mut sums = Sums { moments: [V::zero(); SLOT_HEAD], on_features: [V::zero(); C] };
            match *job.record::<C>(entry).add(7) < LOG2_CLAMPED {
                true => state.pass::<V, false>(brush, visited, &mut seen, &mut sums),
                false => state.pass::<V, true>(brush, visited, &mut seen, &mut sums),
            }
            write_sums(&sums, slot(entry));
        }
    }
}

/// Sums over lanes into a slot, eight vectors at a time.
///
/// # Safety
/// Inside a function with the features of `V`; the slot holds `SLOT_HEAD + C` values.
#[inline(always)]
unsafe fn write_sums<V: Lanes, const C: usize>(sums: &Sums<V, C>, slot: *mut f32) {
    // SAFETY: the caller's contract.
    unsafe {
        let (mut k, count) = (0, SLOT_HEAD + C);
        while k + 4 < count {
            // The last eight may be cut short: what is missing repeats and is not written.
            let last = count - 1;
            let eight = V::sum_eight(each(
                #[inline(always)]
                |i| sums.get((k + i).min(last)),
            ));
            slot.add(k).copy_from_nonoverlapping(eight.as_ptr(), 8.min(count - k));
            k += 8;
        }
        while k < count {
            slot.add(k).write(sums.get(k).sum());
            k += 1;
        }
    }
}

dispatched! {
    /// [`backward_tile`] at the machine's level.
    ///
    /// Its contract: the slots hold those of the tile's entries, which no other tile's kernel shares.
    pub(crate) fn backward[const C: usize](job: &TileJob, visited: &[Blocks], picture: &PlaneGradients<C>, slots: Slots) =
        backward_tile;
}
