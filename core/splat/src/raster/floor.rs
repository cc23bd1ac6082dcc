//! What compositing alone costs on this machine: the kernels' own steps over one tile that stays in the first-level cache,
//! every lane used, without spans, lists or branches. No rasteriser of this arithmetic can be faster.

use super::backward::{SLOT_HEAD, Seen, State, Sums};
use super::{Blocks, Brush, Constants, PIXELS, Plane, RECORD_HEAD, VECTORS, paint};
use crate::bin::{TILE_HEIGHT, TILE_WIDTH};
use crate::lanes::{Lanes, dispatched, simd_level};
use std::hint::black_box;
use std::time::Instant;

/// Splats over the tile between two fresh ones.
const SPLATS: usize = 64;
/// Tiles of one timing, and timings of which the least counts.
const TILES: usize = 40;
const TIMINGS: usize = 12;
const COLOR: [f32; 3] = [0.8, 0.5, 0.3];

/// Time of one (splat, pixel) pair in three channels on one thread, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Forward.
    pub forward_ns: f64,
    /// Backward.
    pub backward_ns: f64,
    /// Pixels that a vector of the level in use holds.
    pub lanes: usize,
}

/// Measures it, a few milliseconds long.
pub fn floor() -> Floor {
    let least = |f: &dyn Fn() -> f32| {
        let timing = |_| {
            let start = Instant::now();
            for _ in 0..TILES {
                black_box(f());
            }
            start.elapsed().as_secs_f64() * 1e9 / (TILES * SPLATS * PIXELS) as f64
        };
        (0..TIMINGS).map(timing).fold(f64::INFINITY, f64::min)
    };
    Floor { forward_ns: least(&forward), backward_ns: least(&backward), lanes: simd_level().lanes() }
}

/// Calls `pass` for every splat: alphas about 0.02 around the tile's
/// middle.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn every_splat<V: Lanes>(mut pass: impl FnMut(&Brush<V, 3>)) {
    let (half_width, half_height) = (0.5 * TILE_WIDTH as f32, 0.5 * TILE_HEIGHT as f32);
    // SAFETY: the caller's contract.
    let constants = unsafe { Constants::<V>::new() };
    for splat in 0..SPLATS {
        let x = half_width + 0.1 * splat as f32;
        let mut record = [x.floor(), half_height, x.fract(), 0.3, -1e-3, 0.1, 2e-3, -5.6, 0.0, 0.0, 0.0];
        // As the rasteriser has it, a colour that the compiler does not know: folding the constant in makes slower code.
        record[RECORD_HEAD..].copy_from_slice(&black_box(COLOR));
        // SAFETY: the caller's contract.
        let brush = unsafe { Brush::new(record.as_ptr(), [0, 0], &constants) };
        pass(&brush);
    }
}

/// All of a tile's vectors; not known to the compiler.
fn every_vector<V: Lanes>() -> Blocks {
    black_box(if V::N == 8 { Blocks::MAX } else { 0x5555_5555_5555_5555 })
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn forward_lanes<V: Lanes>() -> f32 {
    let (mut transmittance, mut planes) = (Plane::open([TILE_WIDTH, TILE_HEIGHT]), [Plane::ZERO; 3]);
    // SAFETY: every place lies inside a plane; V's features are here by contract.
    unsafe {
        let mut alphas = [V::zero(); VECTORS];
        every_splat::<V>(
            #[inline(always)]
            |brush| paint(brush, every_vector::<V>(), &mut alphas, (&mut transmittance, &mut planes)),
        );
    }
    transmittance.0[7] + planes[2].0[9]
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn backward_lanes<V: Lanes>() -> f32 {
    let transmittance = Plane::open([TILE_WIDTH, TILE_HEIGHT]);
    let mut state = State { transmittance, behind: Plane::open([0, 0]), gradients: [Plane::open([9, 9]); 3] };
    // SAFETY: every place lies inside a plane; V's features are here by contract.
    unsafe {
        let mut sums = Sums { moments: [V::zero(); SLOT_HEAD], on_features: [V::zero(); 3] };
        let mut seen = [Seen::none(); VECTORS];
        every_splat::<V>(
            #[inline(always)]
            |brush| state.pass::<V, false>(brush, every_vector::<V>(), &mut seen, &mut sums),
        );
        sums.moments.iter().chain(&sums.on_features).map(|sum| sum.sum()).sum()
    }
}

dispatched! { fn forward() -> f32 = forward_lanes; }
dispatched! { fn backward() -> f32 = backward_lanes; }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_floor_is_a_positive_time() {
        let floor = floor();
        assert!(floor.forward_ns > 0.0 && floor.backward_ns > 0.0 && floor.lanes >= 8, "{floor:?}");
    }
}
