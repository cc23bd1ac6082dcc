//! What compositing alone costs on this machine: the kernels' own steps over one tile that stays in the first-level cache,
//! every lane used, without spans, lists or branches. No rasteriser of this arithmetic can be faster.

use super::backward::{SLOT_HEAD, State, Sums};
use super::{IOTA, PIXELS, Plane, draw};
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

/// Calls `step(place, u, falloff, peak, dy)` for every vector of a tile and every splat: alphas about 0.02 around the
/// tile's middle.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn every_vector<V: Lanes>(mut step: impl FnMut(usize, V, V, V, V)) {
    for splat in 0..SPLATS {
        for at in (0..PIXELS).step_by(V::N) {
            // SAFETY: the caller's contract; `at % TILE_WIDTH + N ≤ TILE_WIDTH`.
            unsafe {
                let dy = (at / TILE_WIDTH) as f32 - 0.5 * TILE_HEIGHT as f32;
                let u = V::load(IOTA.as_ptr().add(at % TILE_WIDTH)).add(V::splat(-0.25 * splat as f32));
                step(at, u, V::splat(-1e-3), V::splat(-5.6 - 1e-3 * dy * dy), V::splat(dy));
            }
        }
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn forward_lanes<V: Lanes>() -> f32 {
    let (mut transmittance, mut planes) = (Plane::open([TILE_WIDTH, TILE_HEIGHT]), [Plane::ZERO; 3]);
    // SAFETY: every place lies inside a plane; V's features are here by contract.
    unsafe {
        every_vector::<V>(
            #[inline(always)]
            |at, u, falloff, peak, _| draw((u, falloff, peak), &COLOR, at, &mut transmittance, &mut planes),
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
        // As the rasteriser has it, a colour that the compiler does not know: folding the constant in makes slower code.
        let color = black_box(COLOR);
        every_vector::<V>(
            #[inline(always)]
            |at, u, falloff, peak, dy| state.step((u, falloff, peak), &color, (at, dy), &mut sums),
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
