//! Depth order and tile lists. What always holds: a tile's list is in the order of depth, ties in the order of the
//! scene, whatever the number of threads; a Gaussian is in a tile's list exactly when its region of alpha ≥ 1/255
//! reaches a row of the tile's pixel centres inside the tile's columns (up to [`SLACK_PX`]).

use crate::reach::Reached;
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
    use crate::project::Splat;
    use crate::reach::reach;

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
