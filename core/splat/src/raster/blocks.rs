//! A tile's pixels in blocks of 4×2, and the blocks that a splat touches.
//!
//! What always holds: block `8·b + a` is the `a`-th from the left in the `b`-th pair of rows from the top, and its eight
//! pixels lie together, the upper row first: a vector of pixels is a block (or two neighbours) and is loaded whole from
//! where the last splat stored it. Small splats fill blocks better than pieces of rows (a fifth fewer vectors). Pixels from
//! the tile's first one.

use super::{RECORD_HEAD, TileJob};
use crate::bin::{Entry, SLACK_PX, TILE_HEIGHT, TILE_WIDTH};
use crate::lanes::{EightLanes, Lanes};
use crate::project::reach;
use std::f32::consts::LOG2_E;

/// Pixels of a tile.
pub(super) const PIXELS: usize = TILE_HEIGHT * TILE_WIDTH;
/// Width of a block, pixels.
const BLOCK_WIDTH: usize = 4;
/// Height of a block, pixels.
const BLOCK_HEIGHT: usize = 2;
/// Pixels of a block.
const BLOCK: usize = BLOCK_WIDTH * BLOCK_HEIGHT;
/// Blocks side by side.
const ACROSS: usize = TILE_WIDTH / BLOCK_WIDTH;
/// Entries that are prepared together, so that the latency of one's spans hides behind another's; between two batches
/// the forward kernel looks which vectors are finished, and fetches the records of the next.
pub(super) const BATCH: usize = 16;

/// A bit for each block of a tile; the first of a vector's blocks stands for the vector.
pub(crate) type Blocks = u64;
const _: () = assert!(PIXELS / BLOCK == 64 && ACROSS == 8 && TILE_HEIGHT / BLOCK_HEIGHT == 8);

/// Floats of a [`Plane`]: a tile's pixels and a gap, so that the same pixels of a tile's planes do not lie a multiple of
/// 4 KiB apart, where a processor takes a load for one that depends on a recent store.
const PLANE: usize = PIXELS + 112;

/// A tile's pixels in one quantity, block by block.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
pub(super) struct Plane(pub [f32; PLANE]);

/// Columns and rows of a tile's pixels.
static COLUMNS: Plane = Plane::places(true);
static ROWS: Plane = Plane::places(false);

impl Plane {
    pub const ZERO: Self = Self([0.0; PLANE]);

    const fn places(columns: bool) -> Self {
        let mut plane = Self::ZERO;
        let mut at = 0;
        while at < PIXELS {
            let [column, row] = pixel(at);
            plane.0[at] = if columns { column as f32 } else { row as f32 };
            at += 1;
        }
        plane
    }

    /// Transmittance before the first splat: 1 inside the picture, −1 (finished) elsewhere.
    #[inline(always)]
    pub fn open(size: [usize; 2]) -> Self {
        let mut plane = Self([-1.0; PLANE]);
        for_each_piece(
            size,
            #[inline(always)]
            |_, _, at, count| plane.0[at..at + count].fill(1.0),
        );
        plane
    }
}

/// Column and row of the pixel at a place of a plane.
pub(super) const fn pixel(at: usize) -> [usize; 2] {
    let (block, inside) = (at / BLOCK, at % BLOCK);
    [block % ACROSS * BLOCK_WIDTH + inside % BLOCK_WIDTH, block / ACROSS * BLOCK_HEIGHT + inside / BLOCK_WIDTH]
}

/// Calls `visit(column, row, place, count)` for the pieces of a tile's rows that lie together in a plane: all pixels that
/// are inside the picture, at most four at a time.
#[inline(always)]
pub(super) fn for_each_piece(size: [usize; 2], mut visit: impl FnMut(usize, usize, usize, usize)) {
    for row in 0..size[1] {
        let first = row / BLOCK_HEIGHT * ACROSS * BLOCK + row % BLOCK_HEIGHT * BLOCK_WIDTH;
        for block in 0..size[0] / BLOCK_WIDTH {
            visit(block * BLOCK_WIDTH, row, first + block * BLOCK, BLOCK_WIDTH);
        }
        let whole = size[0] / BLOCK_WIDTH;
        if !size[0].is_multiple_of(BLOCK_WIDTH) {
            visit(whole * BLOCK_WIDTH, row, first + whole * BLOCK, size[0] % BLOCK_WIDTH);
        }
    }
}

/// A splat in a tile, as the kernels evaluate it.
#[derive(Clone, Copy)]
pub(super) struct Ellipse<V: Lanes> {
    centre: [V; 2],
    shear: V,
    /// `−½·log2(e)` over the variance, and times the precision.
    falloff: [V; 2],
    log2_opacity: V,
}

/// A vector of pixels seen from a splat.
#[derive(Clone, Copy)]
pub(super) struct Offset<V: Lanes> {
    /// Offset from the row's centre.
    pub u: V,
    /// Base-2 logarithm of the alpha before its clamp.
    pub exponent: V,
}

impl<V: Lanes> Ellipse<V> {
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    pub unsafe fn new(record: &[f32; RECORD_HEAD], origin: [usize; 2]) -> Self {
        let [x, y] = centre(record, origin);
        // SAFETY: the caller's contract.
        unsafe {
            Self {
                centre: [V::splat(x), V::splat(y)],
                shear: V::splat(record[5]),
                falloff: [V::splat(record[4]), V::splat(-0.5 * LOG2_E * record[6])],
                log2_opacity: V::splat(record[7]),
            }
        }
    }

    /// Vertical offset of the pixels at a place of a plane from the splat's centre.
    ///
    /// # Safety
    /// Inside a function with the features of `V`; `at + V::N ≤ PIXELS`.
    #[inline(always)]
    pub unsafe fn dy(&self, at: usize) -> V {
        // SAFETY: the caller's contract.
        unsafe { V::load(ROWS.0.as_ptr().add(at)).sub(self.centre[1]) }
    }

    /// The pixels at a place of a plane.
    ///
    /// # Safety
    /// Inside a function with the features of `V`; `at + V::N ≤ PIXELS`.
    #[inline(always)]
    pub unsafe fn offset(&self, at: usize) -> Offset<V> {
        // SAFETY: the caller's contract.
        unsafe {
            let dy = self.dy(at);
            let u = self.shear.neg_mul_add(dy, V::load(COLUMNS.0.as_ptr().add(at)).sub(self.centre[0]));
            let peak = dy.mul(dy).mul_add(self.falloff[1], self.log2_opacity);
            Offset { u, exponent: u.mul(u).mul_add(self.falloff[0], peak) }
        }
    }
}

/// A splat's centre seen from the tile's first pixel's. Whole pixels are subtracted first, exactly; the fraction keeps its
/// digits.
#[inline(always)]
fn centre(record: &[f32; RECORD_HEAD], origin: [usize; 2]) -> [f32; 2] {
    let along = |k: usize| (record[k] - origin[k] as f32 - 0.5) + record[2 + k];
    [along(0), along(1)]
}

/// The blocks that the rows of a splat's region of alpha ≥ 1/255 touch.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn touched<V: EightLanes>(record: &[f32; RECORD_HEAD], origin: [usize; 2]) -> Blocks {
    let [x, y] = centre(record, origin);
    // SAFETY: V's features are here by contract; eight values are read.
    unsafe {
        let region = Region {
            x: V::splat(x),
            variance: V::splat(-0.5 * LOG2_E / record[4]),
            shear: V::splat(record[5]),
            precision: V::splat(record[6]),
            reach: V::splat(reach(record[7])),
        };
        let upper = V::load(UPPER_ROWS.as_ptr()).sub(V::splat(y));
        let ([low, high], [low_below, high_below]) = (region.span(upper), region.span(upper.add(V::splat(1.0))));
        let slack = V::splat(SLACK_PX);
        V::fours(low.min(low_below).sub(slack), high.max(high_below).add(slack))
    }
}

/// A splat's region of alpha ≥ 1/255.
struct Region<V: Lanes> {
    x: V,
    variance: V,
    shear: V,
    precision: V,
    reach: V,
}

impl<V: Lanes> Region<V> {
    /// Both ends in rows `dy` below the centre; a row without a point of it ends before it starts.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn span(&self, dy: V) -> [V; 2] {
        // SAFETY: the caller's contract.
        unsafe {
            let rest = self.precision.mul(dy).neg_mul_add(dy, self.reach);
            let half = V::select(rest.ge(V::zero()), self.variance.mul(rest).sqrt(), V::splat(-1e6));
            let middle = self.shear.mul_add(dy, self.x);
            [middle.sub(half), middle.add(half)]
        }
    }
}

/// The upper rows of a tile's pairs of rows.
const UPPER_ROWS: [f32; 8] = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0];

/// The vectors that have a pixel that is not finished.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
pub(super) unsafe fn alive<V: Lanes>(transmittance: &Plane) -> Blocks {
    let mut bits = 0;
    for at in (0..PIXELS).step_by(V::N) {
        // SAFETY: the plane holds PIXELS values; V's features are here by contract.
        let open = unsafe { V::bits(V::zero().lt(V::load(transmittance.0.as_ptr().add(at)))) != 0 };
        bits |= Blocks::from(open) << (at / BLOCK);
    }
    bits
}

/// The vectors of the next entries, those that are `open`.
///
/// # Safety
/// Inside a function with the features of `V`; `entries` are a tile's from some place on, and are no fewer than `visited`.
#[inline(always)]
pub(super) unsafe fn fill<V: Lanes, const C: usize>(
    job: &TileJob,
    entries: &[Entry],
    open: Blocks,
    visited: &mut [Blocks],
) {
    for (k, visited) in visited.iter_mut().enumerate() {
        // SAFETY: V's features are here by contract, and so are those of its eight lanes.
        unsafe {
            if let Some(&ahead) = entries.get(k + BATCH) {
                prefetch::<V>(job.record::<C>(ahead), RECORD_HEAD + C);
            }
            let blocks = touched::<V::Eight>(&*job.record::<C>(entries[k]).cast(), job.origin);
            *visited = open & if V::N == BLOCK { blocks } else { (blocks | blocks >> 1) & 0x5555_5555_5555_5555 };
        }
    }
}

/// Most vectors of pixels that an entry visits.
pub(super) const VECTORS: usize = PIXELS / BLOCK;

/// Calls `visit(number, place in a plane)` for each vector of pixels that an entry visits.
#[inline(always)]
pub(super) fn for_each_vector(mut visited: Blocks, mut visit: impl FnMut(usize, usize)) {
    let mut number = 0;
    while visited != 0 {
        visit(number, visited.trailing_zeros() as usize * BLOCK);
        visited &= visited - 1;
        number += 1;
    }
}

/// Asks for some values, no more than two cache lines hold.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
pub(super) unsafe fn prefetch<V: Lanes>(from: *const f32, count: usize) {
    // SAFETY: a prefetch reads nothing; V's features are here by contract.
    unsafe {
        V::prefetch(from);
        V::prefetch(from.wrapping_add(count - 1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Array;

    /// Every pixel has a place of its own, and every pixel above the cut lies in a block that is listed.
    #[test]
    fn blocks_cover_what_a_splat_shows() {
        let mut seen = [[false; TILE_WIDTH]; TILE_HEIGHT];
        for_each_piece([TILE_WIDTH, TILE_HEIGHT], |column, row, at, count| {
            for k in 0..count {
                assert_eq!(pixel(at + k), [column + k, row]);
                seen[row][column + k] = true;
            }
        });
        assert!(seen.as_flattened().iter().all(|seen| *seen));
        let unit = |k: u32| {
            (k.wrapping_mul(0x9E37_79B9).rotate_left(15).wrapping_mul(1_597_334_677) >> 8) as f32 / 16_777_216.0
        };
        for seed in 0..2000 {
            let r = |k: u32| unit(seed * 16 + k);
            let (variance, precision) = (0.3 + 40.0 * r(1) * r(2) * r(3), 1.0 / (0.3 + 40.0 * r(4) * r(5) * r(6)));
            let record = [
                (50.0 * r(7)).floor(),
                (40.0 * r(8)).floor(),
                r(9),
                r(10),
                -0.5 * LOG2_E / variance,
                4.0 * r(11) - 2.0,
                precision,
                -6.0 * r(12),
            ];
            let origin = [8, 16];
            // SAFETY: the portable lanes need nothing; a place is a multiple of eight.
            unsafe {
                let (blocks, ellipse) = (touched::<Array>(&record, origin), Ellipse::<Array>::new(&record, origin));
                for block in 0..PIXELS / BLOCK {
                    let mut exponents = [0.0; BLOCK];
                    ellipse.offset(block * BLOCK).exponent.store(exponents.as_mut_ptr());
                    let most = exponents.into_iter().fold(f32::MIN, f32::max);
                    let listed = blocks >> block & 1 == 1;
                    assert!(listed || most < -7.994, "seed {seed}: block {block} is missed, {most}");
                }
            }
        }
    }
}
