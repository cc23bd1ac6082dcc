//! Where and how much each Gaussian of a tile shows, for the render as a linear operator.
//!
//! The kernels' own spans and blending, a splat at a time: it runs once a frame, not in a fitting loop.

use super::{Batch, PIXELS, Plane, RECORD_HEAD, TileJob, Vectors, blend};
use crate::bin::{Entry, TILE_WIDTH};
use crate::lanes::{Lanes, MAX_LANES, dispatched};

/// Told of each Gaussian of a tile and of its (x, y, weight) pixels.
type Visit<'a> = &'a mut dyn FnMut(u32, &mut dyn Iterator<Item = (usize, usize, f32)>);

/// Calls `visit(Gaussian, its pixels as (x, y, α·T))` for each entry of a tile that shows, front to back.
pub(crate) fn weights(job: &TileJob, channels: usize, visit: Visit<'_>) {
    let stride = RECORD_HEAD + channels;
    let mut transmittance = Plane::open(job.size);
    let mut found: Vec<(usize, usize, f32)> = Vec::with_capacity(PIXELS);
    for &Entry { gaussian, .. } in job.entries {
        // A record without features is all that weights need.
        let records = &job.records[gaussian as usize * stride..][..RECORD_HEAD];
        let one = TileJob { records, entries: &[Entry { gaussian: 0, slot: 0 }], ..*job };
        found.clear();
        weigh_entry(&one, &mut transmittance, &mut found);
        if !found.is_empty() {
            visit(gaussian, &mut found.drain(..));
        }
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn weigh_entry_lanes<V: Lanes>(job: &TileJob, transmittance: &mut Plane, found: &mut Vec<(usize, usize, f32)>) {
    let mut batch = Batch::new();
    // SAFETY: as in `forward_tile`.
    unsafe {
        batch.fill::<V, 0>(job, 0, Vectors::MAX);
        let falloff = V::splat(job.records[4]);
        batch.for_each_vector::<V>(
            0,
            #[inline(always)]
            |place, row, u, rows| {
                let (at, x) = (transmittance.0.as_mut_ptr().add(place), place % TILE_WIDTH);
                let step = blend(u, falloff, V::splat(rows.peak[row]), V::load(at));
                step.next.store(at);
                let mut lanes = [0.0; MAX_LANES];
                step.weight.store(lanes.as_mut_ptr());
                found.extend(lanes.iter().enumerate().filter(|(_, w)| **w > 0.0).map(|(i, &w)| (x + i, row, w)));
            },
        );
    }
}

dispatched! {
    /// Composites one splat into the transmittance and notes where it shows.
    fn weigh_entry(job: &TileJob, transmittance: &mut Plane, found: &mut Vec<(usize, usize, f32)>) = weigh_entry_lanes;
}
