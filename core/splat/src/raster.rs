//! The compositing kernels of one tile, in lane code: what both share, and the forward one. Twin of
//! `reference/composite.rs`.
//!
//! Front to back, `C += f·α·T`, `T ← T·(1−α)` with `α = min(0.99, o·e^p)`; alpha below 1/255 is skipped, and a pixel is
//! finished before T falls below 1e-4 (Kerbl et al. 2023). A finished pixel keeps its T with the sign bit set, so
//! that no lane ever branches; pixels outside the picture start finished. A splat visits the blocks of pixels that its
//! region of alpha ≥ 1/255 touches in the tile, less those in which every pixel is finished.

mod backward;
mod blocks;
mod floor;
mod weights;

pub(crate) use blocks::Blocks;
pub use floor::{Floor, floor};
pub(crate) use weights::weights;

pub(crate) use backward::{PlaneGradients, SLOT_HEAD, Slots, backward};

use crate::bin::Entry;
use crate::lanes::{EXP2, Exp2, Lanes, dispatched};
use crate::project::{ALPHA_MAX, ALPHA_MIN, Splat, TRANSMITTANCE_MIN, reach};
use blocks::{
    BATCH, Ellipse, Offset, PIXELS, Plane, VECTORS, alive, fill, for_each_piece, for_each_vector, pixel, prefetch,
};
use std::f32::consts::LOG2_E;
use std::hint::black_box;

/// Floats of a splat's record before its features.
pub(crate) const RECORD_HEAD: usize = 8;
/// Writes the kernel's record of a splat: cell 2, fraction 2, falloff −½·log2(e)/v, shear, precision, log2 of the opacity;
/// then `features`.
#[inline(always)]
pub(crate) fn write_record(splat: &Splat, features: &[f32], record: &mut [f32]) {
    record[..RECORD_HEAD].copy_from_slice(&[
        splat.cell[0],
        splat.cell[1],
        splat.fraction[0],
        splat.fraction[1],
        -0.5 * LOG2_E / splat.variance,
        splat.shear,
        splat.precision_y,
        splat.log2_opacity,
    ]);
    record[RECORD_HEAD..].copy_from_slice(features);
}

/// The splat that a record was written from, its opacity given; `None` where none is drawn. Its depth is not kept.
#[inline(always)]
pub(crate) fn read_record(record: &[f32], opacity: f32) -> Option<Splat> {
    if record[4] >= 0.0 {
        return None;
    }
    Some(Splat {
        cell: [record[0], record[1]],
        fraction: [record[2], record[3]],
        depth: 0.0,
        variance: -0.5 * LOG2_E / record[4],
        shear: record[5],
        precision_y: record[6],
        opacity: opacity.min(1.0),
        log2_opacity: record[7],
        reach: reach(record[7]),
    })
}

/// What a tile's kernel reads.
#[derive(Clone, Copy)]
pub(crate) struct TileJob<'a> {
    /// Records of all Gaussians, stride `RECORD_HEAD + C`; those of the entries are here.
    pub records: &'a [f32],
    /// The tile's Gaussians, front to back.
    pub entries: &'a [Entry],
    /// First pixel of the tile.
    pub origin: [usize; 2],
    /// Pixels of the tile inside the picture.
    pub size: [usize; 2],
}

impl TileJob<'_> {
    /// The record of an entry: `RECORD_HEAD + C` values.
    #[inline(always)]
    fn record<const C: usize>(&self, entry: Entry) -> *const f32 {
        debug_assert!((entry.gaussian as usize + 1) * (RECORD_HEAD + C) <= self.records.len());
        self.records.as_ptr().wrapping_add(entry.gaussian as usize * (RECORD_HEAD + C))
    }
}

/// A picture's planes, written by tiles: pointers to up to `C` planes (null for channels that are only padding) and their
/// row length.
#[derive(Clone, Copy)]
pub(crate) struct PlanePointers<const C: usize> {
    pub planes: [*mut f32; C],
    pub transmittance: *mut f32,
    pub width: usize,
}
// SAFETY: tiles touch disjoint pixels; the owner outlives the parallel loop.
unsafe impl<const C: usize> Send for PlanePointers<C> {}
// SAFETY: as above.
unsafe impl<const C: usize> Sync for PlanePointers<C> {}

impl<const C: usize> PlanePointers<C> {
    /// Writes an empty tile: nothing in any plane, transmittance 1.
    ///
    /// # Safety
    /// The planes hold the tile's pixels, and no other thread touches those.
    pub unsafe fn clear(&self, origin: [usize; 2], size: [usize; 2]) {
        for row in 0..size[1] {
            let to = (origin[1] + row) * self.width + origin[0];
            // SAFETY: the caller's contract.
            unsafe {
                for &plane in self.planes.iter().filter(|plane| !plane.is_null()) {
                    plane.add(to).write_bytes(0, size[0]);
                }
                (0..size[0]).for_each(|x| self.transmittance.add(to + x).write(1.0));
            }
        }
    }
}

/// What blending computes with, in all lanes.
struct Constants<V: Lanes> {
    exp2: Exp2<V>,
    alpha_min: V,
    alpha_max: V,
    transmittance_min: V,
}

impl<V: Lanes> Constants<V> {
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn new() -> Self {
        let [alpha_min, alpha_max, transmittance_min] = black_box([ALPHA_MIN, ALPHA_MAX, TRANSMITTANCE_MIN]);
        // SAFETY: the caller's contract.
        unsafe {
            Self {
                exp2: Exp2::new(black_box(EXP2)),
                alpha_min: V::splat(alpha_min),
                alpha_max: V::splat(alpha_max),
                transmittance_min: V::splat(transmittance_min),
            }
        }
    }
}

/// A splat in a tile, as it is drawn.
struct Brush<'a, V: Lanes, const C: usize> {
    ellipse: Ellipse<V>,
    features: [V; C],
    constants: &'a Constants<V>,
}

impl<'a, V: Lanes, const C: usize> Brush<'a, V, C> {
    /// # Safety
    /// Inside a function with the features of `V`; the record holds `RECORD_HEAD + C` values.
    #[inline(always)]
    unsafe fn new(record: *const f32, origin: [usize; 2], constants: &'a Constants<V>) -> Self {
        // SAFETY: the caller's contract.
        unsafe {
            let mut features = [V::zero(); C];
            for (c, feature) in features.iter_mut().enumerate() {
                *feature = V::splat(*record.add(RECORD_HEAD + c));
            }
            Self { ellipse: Ellipse::new(&*record.cast(), origin), features, constants }
        }
    }

    /// Alpha of pixels, 0 below the cut: there it changes no transmittance and finishes no pixel. `CLAMPED` where it may
    /// exceed [`ALPHA_MAX`].
    ///
    /// A kernel asks for all alphas of an entry before it blends: one chain of dependent instructions after the other would
    /// not fit what a processor looks ahead.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn alpha<const CLAMPED: bool>(&self, offset: &Offset<V>) -> V {
        let by = self.constants;
        // SAFETY: the caller's contract.
        unsafe {
            let raw = offset.exponent.exp2_by(&by.exp2);
            let alpha = if CLAMPED { raw.min(by.alpha_max) } else { raw };
            alpha.keep(alpha.ge(by.alpha_min))
        }
    }
}

/// What a splat does to `N` pixels.
struct Blend<V: Lanes> {
    /// Alpha, 0 where not composited.
    alpha: V,
    /// `α·T` where composited, else 0.
    weight: V,
    /// `T·(1−α)`, where the pixel is not finished.
    next: V,
    /// Where the pixel is not finished.
    drawn: V::Mask,
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn blend<V: Lanes>(alpha: V, transmittance: V, by: &Constants<V>) -> Blend<V> {
    // SAFETY: V's features are here by contract.
    unsafe {
        let next = alpha.neg_mul_add(transmittance, transmittance);
        let drawn = next.ge(by.transmittance_min);
        let alpha = alpha.keep(drawn);
        Blend { alpha, weight: alpha.mul(transmittance), next, drawn }
    }
}

/// Composites a splat of these alphas into the pixels at `at`.
///
/// # Safety
/// Inside a function with the features of `V`; `at + V::N ≤ PIXELS`.
#[inline(always)]
unsafe fn draw<V: Lanes, const C: usize>(
    brush: &Brush<V, C>,
    (at, alpha): (usize, V),
    transmittance: &mut Plane,
    planes: &mut [Plane; C],
) {
    // SAFETY: the caller's contract.
    unsafe {
        let t = transmittance.0.as_mut_ptr().add(at);
        let before = V::load(t);
        let step = blend(alpha, before, brush.constants);
        V::select(step.drawn, step.next, before.negative()).store(t);
        for (plane, &feature) in planes.iter_mut().zip(&brush.features) {
            let value = plane.0.as_mut_ptr().add(at);
            step.weight.mul_add(feature, V::load(value)).store(value);
        }
    }
}

/// Composites a splat into all vectors of pixels that it visits.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn paint<V: Lanes, const C: usize>(
    brush: &Brush<V, C>,
    visited: Blocks,
    alphas: &mut [V; VECTORS],
    (transmittance, planes): (&mut Plane, &mut [Plane; C]),
) {
    // SAFETY: the caller's contract; a vector lies inside its plane.
    unsafe {
        for_each_vector(
            visited,
            #[inline(always)]
            |k, at| alphas[k] = brush.alpha::<true>(&brush.ellipse.offset(at)),
        );
        for_each_vector(
            visited,
            #[inline(always)]
            |k, at| draw(brush, (at, alphas[k]), transmittance, planes),
        );
    }
}

/// Composites one tile into the planes, and notes which vectors of pixels each entry visits.
///
/// # Safety
/// Inside a function with the features of `V`; the planes hold the tile's pixels and no other tile's kernel shares them;
/// there is a `visited` for each entry.
#[inline(always)]
unsafe fn forward_tile<V: Lanes, const C: usize>(job: &TileJob, visited: &mut [Blocks], out: &PlanePointers<C>) {
    let (mut transmittance, mut planes) = (Plane::open(job.size), [Plane::ZERO; C]);
    // SAFETY: every vector lies inside its plane. V's features are here by contract.
    unsafe {
        let (constants, mut alphas) = (Constants::<V>::new(), [V::zero(); VECTORS]);
        for (from, visited) in (0..).step_by(BATCH).zip(visited.chunks_mut(BATCH)) {
            let (open, entries) = (alive::<V>(&transmittance), &job.entries[from..]);
            if open == 0 {
                visited.fill(0);
                continue;
            }
            fill::<V, C>(job, entries, open, visited);
            for (&visited, &entry) in visited.iter().zip(entries).filter(|(visited, _)| **visited != 0) {
                let brush = Brush::new(job.record::<C>(entry), job.origin, &constants);
                paint(&brush, visited, &mut alphas, (&mut transmittance, &mut planes));
            }
        }
        for value in &mut transmittance.0 {
            *value = value.abs();
        }
        let first = job.origin[1] * out.width + job.origin[0];
        for (plane, &target) in planes.iter().zip(&out.planes).chain([(&transmittance, &out.transmittance)]) {
            if !target.is_null() {
                write_plane(plane, job.size, target.add(first), out.width);
            }
        }
    }
}

/// Writes a tile's pixels into a picture's plane of some width, from the tile's first pixel there.
///
/// # Safety
/// The picture's plane holds the tile's pixels.
#[inline(always)]
unsafe fn write_plane(plane: &Plane, size: [usize; 2], to: *mut f32, width: usize) {
    for_each_piece(
        size,
        #[inline(always)]
        |column, row, at, count| {
            let (from, to) = (plane.0.as_ptr().wrapping_add(at), to.wrapping_add(row * width + column));
            // SAFETY: the piece lies inside the tile. A constant count is one instruction.
            unsafe {
                match count {
                    4 => to.copy_from_nonoverlapping(from, 4),
                    count => to.copy_from_nonoverlapping(from, count),
                }
            }
        },
    );
}

dispatched! {
    /// [`forward_tile`] at the machine's level.
    ///
    /// Its contract: the planes hold the tile's pixels, and no other tile's kernel shares them.
    pub(crate) fn forward[const C: usize](job: &TileJob, visited: &mut [Blocks], out: &PlanePointers<C>) = forward_tile;
}
