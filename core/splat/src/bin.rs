//! Depth order and tile lists. What always holds: a tile's list is in the order of depth, ties in the order of the
//! scene, whatever the number of threads; a Gaussian is in a tile's list exactly when its region of alpha ≥ 1/255
//! reaches a row of the tile's pixel centres inside the tile's columns (up to [`SLACK_PX`]).

use crate::project::Splat;
use rayon::prelude::*;

/// Tile width, pixels: wider than high, because the lanes run along rows.
pub(crate) const TILE_WIDTH: usize = 32;
/// Tile height, pixels.
pub(crate) const TILE_HEIGHT: usize = 16;
/// Widening of every span, pixels, against rounding: the kernel tests alpha itself.
pub(crate) const SLACK_PX: f32 = 2e-3;

/// Tile lists of one frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tiles {
    /// Tiles in a row and in a column.
    pub columns: usize,
    pub rows: usize,
    /// `tiles + 1` offsets into `entries`.
    pub offsets: Vec<u32>,
    /// Position in depth order of each entry's splat, tile after tile.
    pub entries: Vec<u32>,
    /// `splats + 1` offsets into `places`.
    pub place_offsets: Vec<u32>,
    /// For each splat in depth order, the entries it has, tile after tile.
    pub places: Vec<u32>,
}

/// Indices of `depths` in ascending order, ties in ascending index; depths are positive and finite.
pub(crate) fn order_by_depth(depths: &[f32]) -> Vec<u32> {
    const BITS: usize = 11;
    let mut keys: Vec<(u32, u32)> = depths.iter().enumerate().map(|(i, d)| (d.to_bits(), i as u32)).collect();
    let mut other = vec![(0, 0); keys.len()];
    for pass in 0..3 {
        let shift = pass * BITS;
        let digit = |key: u32| (key >> shift) as usize & ((1 << BITS) - 1);
        let mut starts = [0u32; 1 << BITS];
        for &(key, _) in &keys {
            starts[digit(key)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for &pair in &keys {
            let start = &mut starts[digit(pair.0)];
            other[*start as usize] = pair;
            *start += 1;
        }
        std::mem::swap(&mut keys, &mut other);
    }
    keys.into_iter().map(|(_, i)| i).collect()
}

/// Range of whole tiles `[first, last]` along one axis that pixel centres in `[low, high]` fall in; empty as (1, 0).
fn tile_range(low: f32, high: f32, size: usize, tile: usize) -> (usize, usize) {
    // First and last pixel whose centre (i + ½) lies in the range, cut to the picture; `as` saturates.
    let first = (low - 0.5 - SLACK_PX).ceil().max(0.0) as usize;
    let last = (high - 0.5 + SLACK_PX).floor().min(size as f32 - 1.0);
    if last < 0.0 || first > last as usize { (1, 0) } else { (first / tile, last as usize / tile) }
}

/// The tiles that a splat reaches, as (row, first column, last column).
fn for_each_tile_row(splat: &Splat, [width, height]: [usize; 2], mut visit: impl FnMut(usize, usize, usize)) {
    let [mx, my] = splat.mean;
    let [extent_x, extent_y] = splat.extent();
    let (first, last) = tile_range(my - extent_y, my + extent_y, height, TILE_HEIGHT);
    let (left, right) = tile_range(mx - extent_x, mx + extent_x, width, TILE_WIDTH);
    if left >= right {
        // One column of tiles, or none: every row of the range has its part of the ellipse there.
        (first..=last).filter(|_| left == right).for_each(|row| visit(row, left, right));
        return;
    }
    let variance_y = 1.0 / splat.precision_y;
    // dy of the ellipse's rightmost point; its leftmost one mirrors it.
    let dy_right = splat.shear * variance_y * splat.reach / extent_x.max(f32::MIN_POSITIVE);
    for row in first..=last {
        let low = ((row * TILE_HEIGHT) as f32 + 0.5 - my).max(-extent_y);
        let high = ((row * TILE_HEIGHT + TILE_HEIGHT) as f32 - 0.5 - my).min(extent_y);
        let edge = |dy: f32, sign: f32| {
            let rest = (splat.reach - splat.precision_y * dy * dy).max(0.0);
            splat.shear * dy + sign * (splat.variance * rest).sqrt()
        };
        // The extreme over the band is at the ellipse's own extreme if that lies inside, else at the nearer end.
        let right = edge(dy_right.clamp(low, high.max(low)), 1.0);
        let left = edge((-dy_right).clamp(low, high.max(low)), -1.0);
        let (from, to) = tile_range(mx + left, mx + right, width, TILE_WIDTH);
        if from <= to {
            visit(row, from, to);
        }
    }
}

/// Splats of a parallel task.
const CHUNK: usize = 1024;

/// Bins splats given in depth order.
pub(crate) fn bin(splats: &[Splat], size: [usize; 2]) -> Tiles {
    let (columns, rows) = (size[0].div_ceil(TILE_WIDTH), size[1].div_ceil(TILE_HEIGHT));
    let reached: Vec<(Vec<u32>, Vec<u32>)> =
        splats.par_chunks(CHUNK).map(|chunk| reached(chunk, size, columns)).collect();
    let total = reached.iter().map(|(tiles, _)| tiles.len()).sum();
    let (mut place_offsets, mut places) = (Vec::with_capacity(splats.len() + 1), Vec::with_capacity(total));
    for (tiles, ends) in &reached {
        place_offsets
            .extend(std::iter::once(0).chain(ends.iter().copied()).take(ends.len()).map(|e| e + places.len() as u32));
        places.extend_from_slice(tiles);
    }
    place_offsets.push(places.len() as u32);
    let mut next = vec![0u32; columns * rows + 1];
    for &tile in &places {
        next[tile as usize] += 1;
    }
    let mut sum = 0;
    for count in &mut next {
        sum += std::mem::replace(count, sum);
    }
    let offsets = next.clone();
    let mut entries = vec![0u32; places.len()];
    for (i, range) in place_offsets.windows(2).enumerate() {
        for place in &mut places[range[0] as usize..range[1] as usize] {
            let next = &mut next[*place as usize];
            entries[*next as usize] = i as u32;
            *place = *next;
            *next += 1;
        }
    }
    Tiles { columns, rows, offsets, entries, place_offsets, places }
}

/// The tiles that splats reach, one splat after another, and where each splat's tiles end.
fn reached(splats: &[Splat], size: [usize; 2], columns: usize) -> (Vec<u32>, Vec<u32>) {
    let (mut tiles, mut ends) = (Vec::with_capacity(4 * splats.len()), Vec::with_capacity(splats.len()));
    for splat in splats {
        for_each_tile_row(splat, size, |row, from, to| {
            tiles.extend((from..=to).map(|column| (row * columns + column) as u32));
        });
        ends.push(tiles.len() as u32);
    }
    (tiles, ends)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_is_stable_and_ascending() {
        let depths = [2.0, 1.0, 2.0, 0.5, 1e6, 1.0];
        assert_eq!(order_by_depth(&depths), [3, 1, 5, 0, 2, 4]);
        assert!(order_by_depth(&[]).is_empty());
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
                mean: [140.0 * unit(6) - 20.0, 100.0 * unit(7) - 20.0],
                depth: 1.0,
                variance: xx - xy * xy / yy,
                shear: xy / yy,
                precision_y: 1.0 / yy,
                opacity: 0.5,
                reach: 2.0 * 127.5f32.ln(),
            };
            let tiles = bin(&[splat], size);
            for tile in 0..tiles.columns * tiles.rows {
                let listed = tiles.offsets[tile + 1] > tiles.offsets[tile];
                let mut nearest = f64::INFINITY;
                for y in 0..TILE_HEIGHT {
                    for x in 0..TILE_WIDTH {
                        let px = (tile % tiles.columns * TILE_WIDTH + x) as f64 + 0.5 - f64::from(splat.mean[0]);
                        let py = (tile / tiles.columns * TILE_HEIGHT + y) as f64 + 0.5 - f64::from(splat.mean[1]);
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
