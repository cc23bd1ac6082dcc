//! Which tiles a splat reaches: the ellipse of alpha ≥ 1/255 against each row of tiles. Pixels.

use crate::bin::{SLACK_PX, TILE_HEIGHT, TILE_WIDTH};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
use crate::project::Splat;

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
