//! The compositing kernels of one tile, in lane code: what both share, and the forward one. Twin of
//! `reference/composite.rs`.
//!
//! Front to back, `C += f·α·T`, `T ← T·(1−α)` with `α = min(0.99, o·e^p)`; alpha below 1/255 is skipped, and a pixel is
//! finished before T falls below 1e-4 (Kerbl et al. 2023). A finished pixel keeps its T with the sign bit set, so
//! that no lane ever branches; pixels outside the picture start finished. A splat visits the aligned vectors of pixels
//! that its spans cover in the tile's rows, less those in which every pixel is finished: aligned, so that a store is
//! forwarded whole to the next splat's load of the same pixels.

mod backward;
mod floor;
mod weights;

pub use floor::{Floor, floor};
pub(crate) use weights::weights;

pub(crate) use backward::{PlaneGradients, SLOT_HEAD, Slots, backward};

use crate::bin::{Entry, SLACK_PX, TILE_HEIGHT, TILE_WIDTH};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
use crate::project::{ALPHA_MAX, ALPHA_MIN, Splat, TRANSMITTANCE_MIN, reach};
use std::f32::consts::LOG2_E;

/// Floats of a splat's record before its features.
pub(crate) const RECORD_HEAD: usize = 8;
/// Entries that are prepared together, so that the latency of one's spans hides behind another's; between two batches
/// the kernels look which vectors are finished, and fetch the records of the next.
const BATCH: usize = 16;
/// Pixels of a tile.
const PIXELS: usize = TILE_HEIGHT * TILE_WIDTH;
/// Columns of a tile.
const IOTA: [f32; TILE_WIDTH] = {
    let mut values = [0.0; TILE_WIDTH];
    let mut i = 0;
    while i < TILE_WIDTH {
        values[i] = i as f32;
        i += 1;
    }
    values
};

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
    /// Records of all Gaussians, stride `RECORD_HEAD + C`.
    pub records: &'a [f32],
    /// The tile's Gaussians, front to back.
    pub entries: &'a [Entry],
    /// First pixel of the tile.
    pub origin: [usize; 2],
    /// Pixels of the tile inside the picture.
    pub size: [usize; 2],
}

impl TileJob<'_> {
    /// The record of an entry.
    #[inline(always)]
    fn record<const C: usize>(&self, entry: Entry) -> &[f32] {
        &self.records[entry.gaussian as usize * (RECORD_HEAD + C)..][..RECORD_HEAD + C]
    }

    /// Asks for the record of an entry.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn prefetch<V: Lanes, const C: usize>(&self, entry: Entry) {
        let record = self.records.as_ptr().wrapping_add(entry.gaussian as usize * (RECORD_HEAD + C));
        // SAFETY: a prefetch reads nothing; V's features are here by contract.
        unsafe {
            V::prefetch(record);
            V::prefetch(record.wrapping_add(RECORD_HEAD + C - 1));
        }
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

/// The rows of an entry: what a kernel needs to evaluate each.
#[derive(Clone, Copy, Default)]
struct Rows {
    /// Offset of the tile's first column from the row's centre.
    offset: [f32; TILE_HEIGHT],
    /// Vertical offset from the splat's centre.
    dy: [f32; TILE_HEIGHT],
    /// `log2` of the alpha at the row's centre.
    peak: [f32; TILE_HEIGHT],
}

/// A bit for each vector of a tile's rows: bit `16·k + row` is the `k`-th from the left.
type Vectors = u64;
const _: () = assert!(TILE_HEIGHT == 16 && TILE_WIDTH == 32 && MAX_LANES == TILE_HEIGHT);

/// The rows of a splat in a tile, and the vectors that its spans touch.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn spans<V: Lanes>(record: &[f32], job: &TileJob, rows: &mut Rows) -> Vectors {
    let mut bits = 0;
    // Whole pixels are subtracted first, exactly; the fraction keeps its digits.
    let mx = (record[0] - job.origin[0] as f32 - 0.5) + record[2];
    let my = (record[1] - job.origin[1] as f32 - 0.5) + record[3];
    let reach = reach(record[7]);
    // SAFETY: V's features are here by contract; the arrays hold TILE_HEIGHT values and V::N divides that.
    unsafe {
        let (variance, shear) = (V::splat(-0.5 * LOG2_E / record[4]), V::splat(record[5]));
        let slack = V::splat(SLACK_PX);
        for row in (0..TILE_HEIGHT).step_by(V::N) {
            let dy = V::load(IOTA.as_ptr()).add(V::splat(row as f32 - my));
            let fall = V::splat(record[6]).mul(dy).mul(dy);
            let rest = V::splat(reach).sub(fall);
            let half = variance.mul(rest.max(V::zero())).sqrt().add(slack);
            let centre = shear.mul_add(dy, V::splat(mx));
            // Rows without a point of the ellipse end before they start.
            let low = V::select(rest.ge(V::zero()), centre.sub(half), V::splat(f32::MAX));
            let high = centre.add(half);
            for k in 0..TILE_WIDTH / V::N {
                let (first, last) = (V::splat((k * V::N) as f32), V::splat((k * V::N + V::N - 1) as f32));
                let touched = V::both(high.ge(first), last.ge(low));
                bits |= Vectors::from(V::bits(touched)) << (TILE_HEIGHT * k + row);
            }
            V::zero().sub(centre).store(rows.offset.as_mut_ptr().add(row));
            dy.store(rows.dy.as_mut_ptr().add(row));
            let peak = V::splat(-0.5 * LOG2_E).mul_add(fall, V::splat(record[7]));
            peak.store(rows.peak.as_mut_ptr().add(row));
        }
    }
    bits
}

/// Alpha, its weight and the next transmittance of `N` pixels.
struct Blend<V: Lanes> {
    /// `o·e^p` before the clamp.
    raw: V,
    alpha: V,
    /// `α·T` where composited, else 0.
    weight: V,
    /// Next transmittance, sign set where finished.
    next: V,
    /// Where the splat is composited.
    drawn: V::Mask,
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn blend<V: Lanes>(u: V, falloff: V, peak: V, transmittance: V) -> Blend<V> {
    // SAFETY: V's features are here by contract.
    unsafe {
        let raw = u.mul(u).mul_add(falloff, peak).exp2();
        let alpha = raw.min(V::splat(ALPHA_MAX));
        // Below the cut alpha counts as 0, which changes no transmittance and finishes no pixel.
        let alpha = alpha.keep(alpha.ge(V::splat(ALPHA_MIN)));
        let test = alpha.neg_mul_add(transmittance, transmittance);
        let drawn = test.ge(V::splat(TRANSMITTANCE_MIN));
        let next = V::select(drawn, test, transmittance.negative());
        Blend { raw, alpha, weight: alpha.mul(transmittance).keep(drawn), next, drawn }
    }
}

/// Floats of a [`Plane`]: a tile's pixels and a gap, so that the same pixels of a tile's planes do not lie a multiple of
/// 4 KiB apart, where a processor takes a load for one that depends on a recent store.
const PLANE: usize = PIXELS + 112;

/// A tile's pixels in one quantity, row by row.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
struct Plane([f32; PLANE]);

impl Plane {
    const ZERO: Self = Self([0.0; PLANE]);

    /// Transmittance before the first splat: 1 inside the picture, −1 (finished) elsewhere.
    #[inline(always)]
    fn open(size: [usize; 2]) -> Self {
        let mut plane = Self([-1.0; PLANE]);
        for row in plane.0.chunks_exact_mut(TILE_WIDTH).take(size[1]) {
            row[..size[0]].fill(1.0);
        }
        plane
    }
}

/// The vectors that have a pixel that is not finished.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn alive<V: Lanes>(transmittance: &Plane) -> Vectors {
    let mut bits = 0;
    for row in 0..TILE_HEIGHT {
        for k in 0..TILE_WIDTH / V::N {
            // SAFETY: the plane holds TILE_HEIGHT rows of TILE_WIDTH values; V's features are here by contract.
            let open = unsafe {
                let values = V::load(transmittance.0.as_ptr().add(row * TILE_WIDTH + k * V::N));
                V::bits(values.ge(V::zero())) != 0
            };
            bits |= Vectors::from(open) << (TILE_HEIGHT * k + row);
        }
    }
    bits
}

/// The rows and vectors of some entries.
struct Batch {
    rows: [Rows; BATCH],
    vectors: [Vectors; BATCH],
}

impl Batch {
    #[inline(always)]
    fn new() -> Self {
        Self { rows: [Rows::default(); BATCH], vectors: [0; BATCH] }
    }

    /// The spans of entries `from‥from + BATCH` of a tile, in the vectors that are `open`; gives how many entries there are.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn fill<V: Lanes, const C: usize>(&mut self, job: &TileJob, from: usize, open: Vectors) -> usize {
        let count = BATCH.min(job.entries.len() - from);
        for (k, &entry) in job.entries[from..from + count].iter().enumerate() {
            // SAFETY: V's features are here by contract.
            unsafe {
                if let Some(&ahead) = job.entries.get(from + k + BATCH) {
                    job.prefetch::<V, C>(ahead);
                }
                self.vectors[k] = spans::<V>(job.record::<C>(entry), job, &mut self.rows[k]) & open;
            }
        }
        count
    }

    /// Calls `visit(place in a plane, row, u, rows)` for each vector of pixels of entry `k`, `u` being the pixels' offsets
    /// from the row's centre.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn for_each_vector<V: Lanes>(&self, k: usize, mut visit: impl FnMut(usize, usize, V, &Rows)) {
        let (rows, mut bits) = (&self.rows[k], self.vectors[k]);
        while bits != 0 {
            let bit = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let (row, column) = (bit % TILE_HEIGHT, bit / TILE_HEIGHT * V::N);
            // SAFETY: V's features are here by contract; a bit's column is below TILE_WIDTH.
            let u = unsafe { V::load(IOTA.as_ptr().add(column)).add(V::splat(rows.offset[row])) };
            visit(row * TILE_WIDTH + column, row, u, rows);
        }
    }
}

/// Composites a splat's `features` into the pixels at `at`.
///
/// # Safety
/// Inside a function with the features of `V`; `at + V::N ≤ PIXELS`.
#[inline(always)]
unsafe fn draw<V: Lanes, const C: usize>(
    (u, falloff, peak): (V, V, V),
    features: &[f32],
    at: usize,
    transmittance: &mut Plane,
    planes: &mut [Plane; C],
) {
    // SAFETY: the caller's contract.
    unsafe {
        let t = transmittance.0.as_mut_ptr().add(at);
        let step = blend(u, falloff, peak, V::load(t));
        step.next.store(t);
        for (plane, &feature) in planes.iter_mut().zip(features) {
            let value = plane.0.as_mut_ptr().add(at);
            step.weight.mul_add(V::splat(feature), V::load(value)).store(value);
        }
    }
}

/// Composites one tile into the planes.
///
/// # Safety
/// Inside a function with the features of `V`; the planes hold the tile's pixels and no other tile's kernel shares them.
#[inline(always)]
unsafe fn forward_tile<V: Lanes, const C: usize>(job: &TileJob, out: &PlanePointers<C>) {
    let (mut transmittance, mut planes, mut batch) = (Plane::open(job.size), [Plane::ZERO; C], Batch::new());
    // SAFETY: every vector lies inside its plane. V's features are here by contract.
    unsafe {
        for from in (0..job.entries.len()).step_by(BATCH) {
            let open = alive::<V>(&transmittance);
            if open == 0 {
                break;
            }
            for k in 0..batch.fill::<V, C>(job, from, open) {
                let record = job.record::<C>(job.entries[from + k]);
                let falloff = V::splat(record[4]);
                batch.for_each_vector::<V>(
                    k,
                    #[inline(always)]
                    |at, row, u, rows| {
                        let peak = V::splat(rows.peak[row]);
                        draw::<V, C>((u, falloff, peak), &record[RECORD_HEAD..], at, &mut transmittance, &mut planes);
                    },
                );
            }
        }
        for row in 0..job.size[1] {
            let to = (job.origin[1] + row) * out.width + job.origin[0];
            for (plane, &target) in planes.iter().zip(&out.planes).filter(|(_, target)| !target.is_null()) {
                std::ptr::copy_nonoverlapping(plane.0.as_ptr().add(row * TILE_WIDTH), target.add(to), job.size[0]);
            }
            for x in 0..job.size[0] {
                out.transmittance.add(to + x).write(transmittance.0[row * TILE_WIDTH + x].abs());
            }
        }
    }
}

dispatched! {
    /// [`forward_tile`] at the machine's level.
    ///
    /// Its contract: the planes hold the tile's pixels, and no other tile's kernel shares them.
    pub(crate) fn forward[const C: usize](job: &TileJob, out: &PlanePointers<C>) = forward_tile;
}
