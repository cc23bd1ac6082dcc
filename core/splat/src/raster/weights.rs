//! Where and how much each Gaussian of a tile shows, for the render as a linear operator.
//!
//! The kernels' own spans and blending, a splat at a time: it runs once a frame, not in a fitting loop.

use super::{Brush, Constants, PIXELS, Plane, RECORD_HEAD, TileJob, blend, fill, for_each_vector, pixel};
use crate::bin::Entry;
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
    let mut visited = [0];
    // SAFETY: as in `forward_tile`.
    unsafe {
        fill::<V, 0>(job, job.entries, u64::MAX, &mut visited);
        let constants = Constants::new();
        let brush = Brush::<V, 0>::new(job.records.as_ptr(), job.origin, &constants);
        for_each_vector(
            visited[0],
            #[inline(always)]
            |_, place| {
                let at = transmittance.0.as_mut_ptr().add(place);
                let before = V::load(at);
                let step = blend(brush.alpha::<true>(&brush.ellipse.offset(place)), before, &constants);
                V::select(step.drawn, step.next, before.negative()).store(at);
                let mut lanes = [0.0; MAX_LANES];
                step.weight.store(lanes.as_mut_ptr());
                found.extend(lanes.iter().enumerate().filter(|(_, w)| **w > 0.0).map(|(i, &w)| {
                    let [x, y] = pixel(place + i);
                    (x, y, w)
                }));
            },
        );
    }
}

dispatched! {
    /// Composites one splat into the transmittance and notes where it shows.
    fn weigh_entry(job: &TileJob, transmittance: &mut Plane, found: &mut Vec<(usize, usize, f32)>) = weigh_entry_lanes;
}
