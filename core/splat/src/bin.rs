//! Depth order and tile lists. What always holds: a tile's list is in the order of depth, ties in the order of the
//! scene, whatever the number of threads; a Gaussian is in a tile's list exactly when its region of alpha ≥ 1/255
//! reaches a row of the tile's pixel centres inside the tile's columns (up to [`SLACK_PX`]).

use crate::lanes::{Lanes, MAX_LANES, dispatched};
use crate::project::Splat;
use rayon::prelude::*;
use std::ops::Range;

/// Tile width, pixels: wider than high, because the lanes run along rows.
pub(crate) const TILE_WIDTH: usize = 32;
/// Tile height, pixels.
pub(crate) const TILE_HEIGHT: usize = 16;
/// Widening of every span, pixels, against rounding: the kernel tests alpha itself.
pub(crate) const SLACK_PX: f32 = 2e-3;
/// Most (Gaussian, tile) pairs of a frame: about a gibibyte of lists, six of gradients.
pub(crate) const MOST_PAIRS: usize = 1 << 27;
/// Tiles from which lists are made by one thread: more would need too many counters.
const SERIAL_TILES: usize = 1 << 16;

/// A Gaussian in a tile's list.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Entry {
    pub gaussian: u32,
    /// Where its gradients in this tile go: a Gaussian's slots lie together, in the order of its tiles.
    pub slot: u32,
}

/// Tile lists of one frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tiles {
    /// Tiles in a row and in a column.
    pub columns: usize,
    pub rows: usize,
    /// `tiles + 1` offsets into `entries`.
    pub offsets: Vec<u32>,
    /// The lists, tile after tile, front to back.
    pub entries: Vec<Entry>,
    /// `gaussians + 1` offsets into the slots.
    pub slot_offsets: Vec<u32>,
}

/// The tiles that consecutive Gaussians reach, one after another, and how many each.
#[derive(Default)]
pub(crate) struct Reached {
    pub tiles: Vec<u32>,
    pub counts: Vec<u32>,
}

impl Reached {
    /// Adds the next Gaussian; gives whether it reaches any tile.
    #[inline(always)]
    fn push(&mut self, before: usize) -> bool {
        self.counts.push((self.tiles.len() - before) as u32);
        self.tiles.len() > before
    }
}

/// What the tiles of up to `MAX_LANES` splats are told by: centre 2, variance, shear, precision, reach, and 1 where drawn.
type Shapes = [[f32; MAX_LANES]; 7];
/// The first row of tiles that each of them reaches and how many follow; the first column and the number of columns in the
/// first row, and in the last one if that is another.
type Corners = [[f32; MAX_LANES]; 6];

/// Adds Gaussians to `reached` and sets the key of each that reaches no tile to 0. Most splats lie in one or two rows of
/// tiles, whose columns are found in lanes.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn reach_lanes<V: Lanes>(splats: &[Splat], keys: &mut [u64], size: [usize; 2], reached: &mut Reached) {
    let columns = size[0].div_ceil(TILE_WIDTH);
    let (mut shapes, mut found) = ([[0.0; MAX_LANES]; 7], [[0.0; MAX_LANES]; 6]);
    for (splats, keys) in splats.chunks(V::N).zip(keys.chunks_mut(V::N)) {
        for (lane, (splat, key)) in splats.iter().zip(keys.iter()).enumerate() {
            let ([x, y], drawn) = (splat.mean(), f32::from(u8::from(*key != 0)));
            let values = [x, y, splat.variance, splat.shear, splat.precision_y, splat.reach, drawn];
            for (row, value) in shapes.iter_mut().zip(values) {
                row[lane] = value;
            }
        }
        // SAFETY: V's features are here by contract.
        unsafe { corners::<V>(&shapes, size, &mut found) };
        reached.tiles.reserve(4 * V::N);
        for (lane, (splat, key)) in splats.iter().zip(keys).enumerate() {
            // SAFETY: `corners` gives whole numbers below the picture's size, and 0 for what is not drawn.
            let get = |k: usize| unsafe { found[k][lane].to_int_unchecked::<i32>() as u32 };
            let (row, more) = (get(0), get(1));
            let ((left, count), (left_last, count_last)) = ((get(2), get(3)), (get(4), get(5)));
            let before = reached.tiles.len();
            if more > 1 || count.max(count_last) > 2 {
                for_each_tile_row(splat, size, |row, from, to| {
                    reached.tiles.extend((from..=to).map(|column| (row * columns + column) as u32));
                });
                reached.tiles.reserve(4 * V::N);
            } else {
                // Every place is written, and only those that count stay: no branch to guess.
                let (first, last) = (row * columns as u32 + left, (row + more) * columns as u32 + left_last);
                // SAFETY: there is room for four more tiles of every splat of the block.
                unsafe {
                    let room = reached.tiles.as_mut_ptr().add(before);
                    room.write(first);
                    room.add(1).write(first + 1);
                    room.add(count as usize).write(last);
                    room.add(count as usize + 1).write(last + 1);
                    reached.tiles.set_len(before + (count + count_last) as usize);
                }
            }
            if !reached.push(before) {
                *key = 0;
            }
        }
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn corners<V: Lanes>(shapes: &Shapes, size: [usize; 2], found: &mut Corners) {
    // SAFETY: V's features are here by contract; MAX_LANES values are readable and writable.
    unsafe {
        let get = |k: usize| V::load(shapes[k].as_ptr());
        let (x, y, variance, shear, precision, reach) = (get(0), get(1), get(2), get(3), get(4), get(5));
        let variance_y = V::splat(1.0).div(precision);
        let extent_x = shear.mul(shear).mul_add(variance_y, variance).mul(reach).sqrt();
        let extent_y = reach.mul(variance_y).sqrt();
        let (first, last, in_rows) = tiles_along(y.sub(extent_y), y.add(extent_y), size[1], TILE_HEIGHT);
        let drawn = V::both(in_rows, get(6).ge(V::splat(0.5)));
        // dy of the ellipse's rightmost point; its leftmost one mirrors it.
        let right_at = shear.mul(variance_y).mul(reach).div(extent_x.max(V::splat(f32::MIN_POSITIVE)));
        let left_at = V::zero().sub(right_at);
        let edge = Edge { variance, shear, precision, reach };
        for (k, row) in [first, last].into_iter().enumerate() {
            let top = row.mul(V::splat(TILE_HEIGHT as f32)).sub(y);
            let low = top.add(V::splat(0.5)).max(V::zero().sub(extent_y));
            let high = top.add(V::splat(TILE_HEIGHT as f32 - 0.5)).min(extent_y).max(low);
            // The extreme over the band is at the ellipse's own extreme if that lies inside, else at the nearer end.
            let left = edge.at(left_at.max(low).min(high))[0];
            let right = edge.at(right_at.max(low).min(high))[1];
            let (from, to, any) = tiles_along(x.add(left), x.add(right), size[0], TILE_WIDTH);
            let mut there = V::both(drawn, any);
            if k == 1 {
                there = V::both(there, first.lt(last));
            }
            from.keep(there).store(found[2 + 2 * k].as_mut_ptr());
            to.sub(from).add(V::splat(1.0)).keep(there).store(found[3 + 2 * k].as_mut_ptr());
        }
        first.keep(drawn).store(found[0].as_mut_ptr());
        last.sub(first).keep(drawn).store(found[1].as_mut_ptr());
    }
}

/// The first and the last tile along an axis that pixel centres in `[low, high]` fall in, and whether any do.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn tiles_along<V: Lanes>(low: V, high: V, size: usize, tile: usize) -> (V, V, V::Mask) {
    // SAFETY: the caller's contract.
    unsafe {
        // First and last pixel whose centre (i + ½) lies in the range, cut to the picture.
        let first = V::zero().sub(V::splat(0.5 + SLACK_PX).sub(low).floor()).max(V::zero());
        let last = high.sub(V::splat(0.5 - SLACK_PX)).floor().min(V::splat(size as f32 - 1.0));
        let by_tile = V::splat(1.0 / tile as f32);
        (first.mul(by_tile).floor(), last.mul(by_tile).floor(), last.ge(first))
    }
}

/// The ends of an ellipse's rows.
struct Edge<V: Lanes> {
    variance: V,
    shear: V,
    precision: V,
    reach: V,
}

impl<V: Lanes> Edge<V> {
    /// Offsets in x from the centre of the left and the right end at `dy`.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    unsafe fn at(&self, dy: V) -> [V; 2] {
        // SAFETY: the caller's contract.
        unsafe {
            let rest = self.precision.mul(dy).neg_mul_add(dy, self.reach).max(V::zero());
            let (half, middle) = (self.variance.mul(rest).sqrt(), self.shear.mul(dy));
            [middle.sub(half), middle.add(half)]
        }
    }
}

dispatched! {
    /// Adds Gaussians to `reached` and sets the key of each that reaches no tile to 0.
    pub(crate) fn reach(splats: &[Splat], keys: &mut [u64], size: [usize; 2], reached: &mut Reached) = reach_lanes;
}

/// Indices of the keys that are not 0 in ascending order of key, ties in ascending index. The 33 most significant bits
/// that tell the keys apart are compared.
pub(crate) fn order_by_key(keys: &[u64]) -> Vec<u32> {
    const BITS: usize = 11;
    const INDEX_BITS: usize = 31;
    let used = keys.iter().copied().filter(|key| *key != 0);
    let (low, high) = used.clone().fold((u64::MAX, 0), |(low, high), key| (low.min(key), high.max(key)));
    let shift = (64 - (high.max(low) - low).leading_zeros() as usize).saturating_sub(64 - INDEX_BITS);
    let mut pairs: Vec<u64> = Vec::with_capacity(keys.len());
    let mut starts = [[0u32; 1 << BITS]; 3];
    let digit = |pair: u64, pass: usize| (pair >> (INDEX_BITS + BITS * pass)) as usize & ((1 << BITS) - 1);
    for (i, key) in keys.iter().enumerate().filter(|(_, key)| **key != 0) {
        let pair = ((key - low) >> shift) << INDEX_BITS | i as u64;
        pairs.push(pair);
        for (pass, starts) in starts.iter_mut().enumerate() {
            starts[digit(pair, pass)] += 1;
        }
    }
    let mut other = vec![0; pairs.len()];
    for (pass, starts) in starts.iter_mut().enumerate() {
        if starts.iter().any(|&count| count as usize == pairs.len()) {
            continue;
        }
        let mut sum = 0;
        for start in starts.iter_mut() {
            sum += std::mem::replace(start, sum);
        }
        for &pair in &pairs {
            let start = &mut starts[digit(pair, pass)];
            other[*start as usize] = pair;
            *start += 1;
        }
        std::mem::swap(&mut pairs, &mut other);
    }
    pairs.into_iter().map(|pair| (pair & ((1 << INDEX_BITS) - 1)) as u32).collect()
}

/// Range of whole tiles `[first, last]` along one axis that pixel centres in `[low, high]` fall in; empty as (1, 0).
#[inline(always)]
fn tile_range(low: f32, high: f32, size: usize, tile: usize) -> (usize, usize) {
    // First and last pixel whose centre (i + ½) lies in the range, cut to the picture; `as` saturates.
    let first = (low - 0.5 - SLACK_PX).ceil().max(0.0) as usize;
    let last = (high - 0.5 + SLACK_PX).floor().min(size as f32 - 1.0);
    if last < 0.0 || first > last as usize { (1, 0) } else { (first / tile, last as usize / tile) }
}

/// The tiles that a splat reaches, as (row, first column, last column).
#[inline(always)]
fn for_each_tile_row(splat: &Splat, [width, height]: [usize; 2], mut visit: impl FnMut(usize, usize, usize)) {
    let [mx, my] = splat.mean();
    let [extent_x, extent_y] = splat.extent();
    let (first, last) = tile_range(my - extent_y, my + extent_y, height, TILE_HEIGHT);
    let (left, right) = tile_range(mx - extent_x, mx + extent_x, width, TILE_WIDTH);
    if left >= right {
        // One column of tiles, or none: every row of the range has its part of the ellipse there.
        if left == right {
            for row in first..=last {
                visit(row, left, right);
            }
        }
        return;
    }
    let variance_y = 1.0 / splat.precision_y;
    // dy of the ellipse's rightmost point; its leftmost one mirrors it.
    let dy_right = splat.shear * variance_y * splat.reach / extent_x.max(f32::MIN_POSITIVE);
    for row in first..=last {
        let low = ((row * TILE_HEIGHT) as f32 + 0.5 - my).max(-extent_y);
        let high = ((row * TILE_HEIGHT + TILE_HEIGHT) as f32 - 0.5 - my).min(extent_y);
        // The extreme over the band is at the ellipse's own extreme if that lies inside, else at the nearer end.
        let right = edge(splat, dy_right.clamp(low, high.max(low)), 1.0);
        let left = edge(splat, (-dy_right).clamp(low, high.max(low)), -1.0);
        let (from, to) = tile_range(mx + left, mx + right, width, TILE_WIDTH);
        if from <= to {
            visit(row, from, to);
        }
    }
}

/// Offset in x from the centre of the ellipse's right (`sign` 1) or left (−1) edge at `dy`.
#[inline(always)]
fn edge(splat: &Splat, dy: f32, sign: f32) -> f32 {
    let rest = (splat.reach - splat.precision_y * dy * dy).max(0.0);
    splat.shear * dy + sign * (splat.variance * rest).sqrt()
}

/// A vector's memory, written by several threads at places that differ.
struct Scattered(*mut Entry);
// SAFETY: every place is written once, by one thread; the owner outlives the parallel loop.
unsafe impl Send for Scattered {}
// SAFETY: as above.
unsafe impl Sync for Scattered {}

impl Scattered {
    /// # Safety
    /// `at` lies inside the allocation and no other thread writes it.
    unsafe fn write(&self, at: u32, entry: Entry) {
        // SAFETY: the caller's contract.
        unsafe { self.0.add(at as usize).write(entry) }
    }
}

/// The lists from the tiles that each Gaussian reaches, chunk after chunk, and the keys of their depth (0 where a
/// Gaussian reaches none). There are at most [`MOST_PAIRS`] pairs.
pub(crate) fn bin(reached: &[Reached], keys: &[u64], size: [usize; 2]) -> Tiles {
    let (columns, rows) = (size[0].div_ceil(TILE_WIDTH), size[1].div_ceil(TILE_HEIGHT));
    let (tiles, total) = (columns * rows, reached.iter().map(|r| r.tiles.len()).sum::<usize>());
    let (order, (slot_offsets, places)) = rayon::join(
        || order_by_key(keys),
        || {
            let (mut slot_offsets, mut places) = (Vec::with_capacity(keys.len() + 1), Vec::with_capacity(total));
            let mut sum = 0;
            for chunk in reached {
                for count in &chunk.counts {
                    slot_offsets.push(sum);
                    sum += count;
                }
                places.extend_from_slice(&chunk.tiles);
            }
            slot_offsets.push(sum);
            (slot_offsets, places)
        },
    );
    let slots = |i: u32| slot_offsets[i as usize] as usize..slot_offsets[i as usize + 1] as usize;
    let (offsets, entries) = lists(&order, slots, &places, tiles);
    Tiles { columns, rows, offsets, entries, slot_offsets }
}

/// Counting sort by tile of the pairs of Gaussians in `order`; `slots` are a Gaussian's pairs, `places` their tiles.
fn lists(
    order: &[u32],
    slots: impl Fn(u32) -> Range<usize> + Sync,
    places: &[u32],
    tiles: usize,
) -> (Vec<u32>, Vec<Entry>) {
    let threads = if tiles > SERIAL_TILES { 1 } else { rayon::current_num_threads() };
    // How the order is cut changes nothing: parts are laid one behind another in every tile.
    let part = order.len().div_ceil(threads).max(2048);
    let mut next: Vec<Vec<u32>> = order
        .par_chunks(part)
        .map(|part| {
            let mut counts = vec![0u32; tiles];
            for &tile in part.iter().flat_map(|&i| &places[slots(i)]) {
                counts[tile as usize] += 1;
            }
            counts
        })
        .collect();
    let (mut offsets, mut sum) = (Vec::with_capacity(tiles + 1), 0);
    for tile in 0..tiles {
        offsets.push(sum);
        for counts in &mut next {
            sum += std::mem::replace(&mut counts[tile], sum);
        }
    }
    offsets.push(sum);
    let mut entries: Vec<Entry> = Vec::with_capacity(places.len());
    let target = Scattered(entries.as_mut_ptr());
    order.par_chunks(part).zip(next.par_iter_mut()).for_each(|(part, next)| {
        for &gaussian in part {
            for slot in slots(gaussian) {
                let at = &mut next[places[slot] as usize];
                // SAFETY: `at` runs through the places that were counted for this part and tile, which no other has.
                unsafe { target.write(*at, Entry { gaussian, slot: slot as u32 }) };
                *at += 1;
            }
        }
    });
    // SAFETY: each of the `sum` places that were counted was written, and `sum ≤ places.len()` is the capacity.
    unsafe { entries.set_len(sum as usize) };
    (offsets, entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_is_stable_and_ascending_and_finer_than_f32() {
        let key = |depth: f64| depth.to_bits();
        let keys = [2.0, 1.0, 2.0, 0.5, 1e6, 1.0].map(key);
        assert_eq!(order_by_key(&keys), [3, 1, 5, 0, 2, 4]);
        assert_eq!(order_by_key(&[key(2.0), 0, key(1.0), 0]), [2, 0]);
        assert_eq!(order_by_key(&[key(1.3 + 1e-9), key(1.3), key(1.3 - 1e-9)]), [2, 1, 0]);
        assert!(order_by_key(&[]).is_empty() && order_by_key(&[0, 0]).is_empty());
        assert_eq!(order_by_key(&[key(3.0); 4]), [0, 1, 2, 3]);
    }

    /// The lists against every pixel of every tile, by the definition.
    #[test]
    fn a_tile_lists_exactly_the_splats_that_reach_its_pixels() {
        let size = [96usize, 64usize];
        for seed in 0..400u32 {
            let unit = |k: u32| {
                (seed.wrapping_mul(2_654_435_761).wrapping_add(k.wrapping_mul(0x9E37_79B9)).wrapping_mul(1_597_334_677)
                    >> 8) as f32
                    / 16_777_216.0
            };
            let (xx, yy) = (0.3 + 120.0 * unit(1) * unit(2), 0.3 + 120.0 * unit(3) * unit(4));
            let xy = (2.0 * unit(5) - 1.0) * 0.99 * (xx * yy - 0.29).max(0.0).sqrt();
            let splat = Splat {
                cell: [(140.0 * unit(6) - 20.0).floor(), (100.0 * unit(7) - 20.0).floor()],
                fraction: [unit(8), unit(9)],
                depth: 1.0,
                variance: xx - xy * xy / yy,
                shear: xy / yy,
                precision_y: 1.0 / yy,
                opacity: 0.5,
                log2_opacity: -1.0,
                reach: 2.0 * 127.5f32.ln(),
            };
            let mut reached = Reached::default();
            let mut keys = [1];
            reach(&[splat], &mut keys, size, &mut reached);
            let tiles = bin(&[reached], &keys, size);
            for tile in 0..tiles.columns * tiles.rows {
                let listed = tiles.offsets[tile + 1] > tiles.offsets[tile];
                let mut nearest = f64::INFINITY;
                for y in 0..TILE_HEIGHT {
                    for x in 0..TILE_WIDTH {
                        let px = (tile % tiles.columns * TILE_WIDTH + x) as f64 + 0.5 - f64::from(splat.mean()[0]);
                        let py = (tile / tiles.columns * TILE_HEIGHT + y) as f64 + 0.5 - f64::from(splat.mean()[1]);
                        let u = px - f64::from(splat.shear) * py;
                        nearest =
                            nearest.min(u * u / f64::from(splat.variance) + py * py * f64::from(splat.precision_y));
                    }
                }
                let reach = f64::from(splat.reach);
                assert!(listed || nearest > reach * (1.0 - 1e-4), "seed {seed} tile {tile} missed: {nearest} {reach}");
                // A listed tile may hold no centre when the ellipse passes between two rows' centres, never by a tile.
                assert!(!listed || nearest < reach + 60.0, "seed {seed} tile {tile} for nothing: {nearest} {reach}");
            }
        }
    }
}
