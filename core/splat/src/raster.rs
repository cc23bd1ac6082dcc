//! The compositing kernels of one tile, forward and backward, in lane code. Twin of `reference/composite.rs`.
//!
//! Front to back, `C += f·α·T`, `T ← T·(1−α)` with `α = min(0.99, o·e^p)`; alpha below 1/255 is skipped, and a pixel is
//! finished before T falls below 1e-4 (Kerbl et al. 2023). A finished pixel keeps its T with the sign bit set, so
//! that no lane ever branches. The backward pass walks in the same order and repeats the same arithmetic, so both take
//! the same decisions bit for bit; what lies behind a splat is the pixel's whole sum less what has been passed.
//! Padding lanes and pixels outside the picture start finished.

use crate::bin::{SLACK_PX, TILE_HEIGHT, TILE_WIDTH};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
use crate::project::{ALPHA_MAX, ALPHA_MIN, Splat, TRANSMITTANCE_MIN};

/// Floats of a splat's record before its features.
pub(crate) const RECORD_HEAD: usize = 8;
/// Floats of an entry's gradient slot before its feature gradients: six moments of dL/dp, the blend weight, one spare.
pub(crate) const SLOT_HEAD: usize = 8;
/// Entries between two looks at which rows are finished.
const LOOK_EVERY: usize = 16;
const ROW_STRIDE: usize = TILE_WIDTH + MAX_LANES;
const BUFFER: usize = TILE_HEIGHT * ROW_STRIDE;
/// Column offsets of the lanes of a row's first, second, … vector.
const IOTA: [f32; TILE_WIDTH] = {
    let mut values = [0.0; TILE_WIDTH];
    let mut i = 0;
    while i < TILE_WIDTH {
        values[i] = i as f32;
        i += 1;
    }
    values
};

/// Writes the kernel's record of a splat: geometry relative to nothing, then `features`.
pub(crate) fn write_record(splat: &Splat, features: &[f32], record: &mut [f32]) {
    use std::f32::consts::LOG2_E;
    record[..RECORD_HEAD].copy_from_slice(&[
        splat.mean[0],
        splat.mean[1],
        splat.variance,
        splat.shear,
        splat.precision_y,
        splat.opacity.log2(),
        splat.reach,
        -0.5 * LOG2_E / splat.variance,
    ]);
    record[RECORD_HEAD..].copy_from_slice(features);
}

/// What a tile's kernel reads.
#[derive(Clone, Copy)]
pub(crate) struct TileJob<'a> {
    /// Records of all splats in depth order, stride `RECORD_HEAD + C`.
    pub records: &'a [f32],
    /// The tile's splats, front to back.
    pub entries: &'a [u32],
    /// First pixel of the tile.
    pub origin: [usize; 2],
    /// Pixels of the tile inside the picture.
    pub size: [usize; 2],
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

/// What the backward kernel reads of the picture and of the loss's gradient; padding channels are empty.
#[derive(Clone, Copy)]
pub(crate) struct PlaneGradients<'a, const C: usize> {
    pub values: [&'a [f32]; C],
    pub gradients: [&'a [f32]; C],
    pub transmittance: &'a [f32],
    /// Gradient with respect to transmittance; may be empty.
    pub on_transmittance: &'a [f32],
    pub width: usize,
}

/// The rows of an entry: what a kernel needs to evaluate each.
#[derive(Clone, Copy, Default)]
struct Rows {
    /// First column in the tile.
    first: [i32; TILE_HEIGHT],
    /// Offset of the first column from the row's centre.
    offset: [f32; TILE_HEIGHT],
    /// Vertical offset from the splat's centre.
    dy: [f32; TILE_HEIGHT],
    /// `log2` of the alpha at the row's centre.
    peak: [f32; TILE_HEIGHT],
}

/// A bit for each vector of a tile's rows: bit `16·k + row` is the `k`-th from the row's first column.
const _: () = assert!(TILE_HEIGHT == 16 && TILE_WIDTH == 32 && MAX_LANES == TILE_HEIGHT);
/// The bits of all rows of a tile.
const ALL_ROWS: u32 = 0xFFFF;
/// Repeats a row's bit for each of its vectors.
const EACH_VECTOR: u64 = 0x0001_0001_0001_0001;

/// The spans of a splat in the rows of a tile, and the bits of the vectors that cover them.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn spans<V: Lanes>(record: &[f32], job: &TileJob, rows: &mut Rows) -> u64 {
    let mut bits = 0;
    // SAFETY: V's features are here by contract; the arrays hold TILE_HEIGHT values and V::N divides that.
    unsafe {
        let [mx, my] = [record[0] - job.origin[0] as f32 - 0.5, record[1] - job.origin[1] as f32 - 0.5];
        let (variance, shear, precision) = (V::splat(record[2]), V::splat(record[3]), V::splat(record[4]));
        let (slack, half_pixel) = (V::splat(SLACK_PX), V::splat(0.5));
        for row in (0..TILE_HEIGHT).step_by(V::N) {
            let iota = V::load(IOTA.as_ptr());
            let dy = iota.add(V::splat(row as f32 - my));
            let fall = precision.mul(dy).mul(dy);
            let rest = V::splat(record[6]).sub(fall);
            let half = variance.mul(rest.max(V::zero())).sqrt().add(slack);
            let centre = shear.mul_add(dy, V::splat(mx));
            // Rounding half a pixel up is the ceiling for the first column, and one past the floor for the last.
            let first = centre.sub(half).add(half_pixel).round().max(V::zero());
            // Rows without a point of the ellipse, and rows below the picture, end before they start.
            let inside = V::both(rest.ge(V::zero()), iota.lt(V::splat(job.size[1] as f32 - row as f32)));
            let end = centre.add(half).add(half_pixel).round().min(V::splat(job.size[0] as f32)).keep(inside);
            for k in 0..TILE_WIDTH / V::N {
                let covered = first.add(V::splat((k * V::N) as f32)).lt(end);
                bits |= u64::from(V::bits(covered)) << (TILE_HEIGHT * k + row);
            }
            first.store_whole(rows.first.as_mut_ptr().add(row));
            first.sub(centre).store(rows.offset.as_mut_ptr().add(row));
            dy.store(rows.dy.as_mut_ptr().add(row));
            let peak = V::splat(-0.5 * std::f32::consts::LOG2_E).mul_add(fall, V::splat(record[5]));
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

/// A tile's working planes: transmittance, what lies behind (backward only), and one plane a channel.
struct Buffers<const C: usize> {
    transmittance: [f32; BUFFER],
    behind: [f32; BUFFER],
    planes: [[f32; BUFFER]; C],
}

impl<const C: usize> Buffers<C> {
    /// All zero but the transmittance: 1 inside the picture, −1 (finished) elsewhere.
    #[inline(always)]
    fn new(size: [usize; 2]) -> Self {
        let mut transmittance = [-1.0; BUFFER];
        for row in transmittance.chunks_exact_mut(ROW_STRIDE).take(size[1]) {
            row[..size[0]].fill(1.0);
        }
        Self { transmittance, behind: [0.0; BUFFER], planes: [[0.0; BUFFER]; C] }
    }
}

/// Bits of the rows that have a pixel that is not finished.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn rows_alive<V: Lanes>(transmittance: &[f32; BUFFER]) -> u32 {
    let mut alive = 0;
    for (row, values) in transmittance.chunks_exact(ROW_STRIDE).enumerate() {
        // SAFETY: a row holds TILE_WIDTH values and V::N divides that; V's features are here by contract.
        unsafe {
            let mut most = V::load(values.as_ptr());
            for x in (V::N..TILE_WIDTH).step_by(V::N) {
                most = most.max(V::load(values.as_ptr().add(x)));
            }
            alive |= u32::from(V::bits(most.ge(V::zero())) != 0) << row;
        }
    }
    alive
}

/// Calls `visit(place in a plane, row, u, rows)` for each vector of pixels of an entry, `u` being the pixels' offsets from
/// the row's centre.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn for_each_vector<V: Lanes>(
    record: &[f32],
    job: &TileJob,
    alive: u32,
    mut visit: impl FnMut(usize, usize, V, &Rows),
) {
    let mut rows = Rows::default();
    // SAFETY: V's features are here by contract; a bit's `k` is below TILE_WIDTH / V::N.
    unsafe {
        let mut bits = spans::<V>(record, job, &mut rows) & (u64::from(alive) * EACH_VECTOR);
        while bits != 0 {
            let bit = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let (row, skipped) = (bit % TILE_HEIGHT, bit / TILE_HEIGHT * V::N);
            let at = row * ROW_STRIDE + skipped + rows.first[row] as usize;
            let u = V::load(IOTA.as_ptr().add(skipped)).add(V::splat(rows.offset[row]));
            visit(at, row, u, &rows);
        }
    }
}

/// Composites one tile into the planes.
///
/// # Safety
/// Inside a function with the features of `V`; the planes hold the tile's pixels and no other tile's kernel shares them.
#[inline(always)]
unsafe fn forward_tile<V: Lanes, const C: usize>(job: &TileJob, out: &PlanePointers<C>) {
    let mut buffers = Buffers::<C>::new(job.size);
    let mut alive = ALL_ROWS;
    // SAFETY: every vector starts at a column below TILE_WIDTH of a row below TILE_HEIGHT, and a row has MAX_LANES
    // padding columns, so loads and stores stay inside the planes. V's features are here by contract.
    unsafe {
        for (index, &entry) in job.entries.iter().enumerate() {
            if index % LOOK_EVERY == LOOK_EVERY - 1 {
                alive = rows_alive::<V>(&buffers.transmittance);
                if alive == 0 {
                    break;
                }
            }
            if let Some(&ahead) = job.entries.get(index + 2) {
                V::prefetch(job.records.as_ptr().wrapping_add(ahead as usize * (RECORD_HEAD + C)));
            }
            let record = &job.records[entry as usize * (RECORD_HEAD + C)..][..RECORD_HEAD + C];
            let falloff = V::splat(record[7]);
            for_each_vector::<V>(
                record,
                job,
                alive,
                #[inline(always)]
                |at, row, u, rows| {
                    let transmittance = buffers.transmittance.as_mut_ptr().add(at);
                    let step = blend(u, falloff, V::splat(rows.peak[row]), V::load(transmittance));
                    step.next.store(transmittance);
                    for (plane, &feature) in buffers.planes.iter_mut().zip(&record[RECORD_HEAD..]) {
                        let value = plane.as_mut_ptr().add(at);
                        step.weight.mul_add(V::splat(feature), V::load(value)).store(value);
                    }
                },
            );
        }
        for row in 0..job.size[1] {
            let to = (job.origin[1] + row) * out.width + job.origin[0];
            for (plane, &target) in buffers.planes.iter().zip(&out.planes).filter(|(_, target)| !target.is_null()) {
                std::ptr::copy_nonoverlapping(plane.as_ptr().add(row * ROW_STRIDE), target.add(to), job.size[0]);
            }
            for x in 0..job.size[0] {
                *out.transmittance.add(to + x) = buffers.transmittance[row * ROW_STRIDE + x].abs();
            }
        }
    }
}

/// Copies a tile's share of the loss's gradient, and forms what lies behind the first splat: `Σ value·gradient`.
#[inline(always)]
fn load_gradients<const C: usize>(job: &TileJob, picture: &PlaneGradients<C>, buffers: &mut Buffers<C>) {
    for row in 0..job.size[1] {
        let from = (job.origin[1] + row) * picture.width + job.origin[0];
        let (range, at) = (from..from + job.size[0], row * ROW_STRIDE..row * ROW_STRIDE + job.size[0]);
        let behind = &mut buffers.behind[at.clone()];
        let channels = buffers.planes.iter_mut().zip(&picture.values).zip(&picture.gradients);
        for ((plane, value), gradient) in channels.filter(|((_, value), _)| !value.is_empty()) {
            plane[at.clone()].copy_from_slice(&gradient[range.clone()]);
            for ((b, v), g) in behind.iter_mut().zip(&value[range.clone()]).zip(&gradient[range.clone()]) {
                *b += v * g;
            }
        }
        if !picture.on_transmittance.is_empty() {
            let (t, g) = (&picture.transmittance[range.clone()], &picture.on_transmittance[range]);
            for ((b, t), g) in behind.iter_mut().zip(t).zip(g) {
                *b += t * g;
            }
        }
    }
}

/// Gradients of one tile's entries into their slots (stride `SLOT_HEAD + C`); slots of entries behind a finished tile
/// are zero. A slot holds `Σ dp·{1, u, u², dy, u·dy, dy²}`, `Σ α·T`, a spare, and `Σ α·T·g` for each channel, where `dp` is
/// the gradient of the exponent, `u` the offset from the row's centre and `g` the loss's gradient.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn backward_tile<V: Lanes, const C: usize>(job: &TileJob, picture: &PlaneGradients<C>, slots: &mut [f32]) {
    let mut buffers = Buffers::<C>::new(job.size);
    load_gradients(job, picture, &mut buffers);
    let mut alive = ALL_ROWS;
    let mut done = 0;
    // SAFETY: as in `forward_tile`.
    unsafe {
        for (index, (&entry, slot)) in job.entries.iter().zip(slots.chunks_exact_mut(SLOT_HEAD + C)).enumerate() {
            if index % LOOK_EVERY == LOOK_EVERY - 1 {
                alive = rows_alive::<V>(&buffers.transmittance);
                if alive == 0 {
                    break;
                }
            }
            done = index + 1;
            if let Some(&ahead) = job.entries.get(index + 2) {
                V::prefetch(job.records.as_ptr().wrapping_add(ahead as usize * (RECORD_HEAD + C)));
            }
            let record = &job.records[entry as usize * (RECORD_HEAD + C)..][..RECORD_HEAD + C];
            let falloff = V::splat(record[7]);
            let mut moments = [V::zero(); SLOT_HEAD];
            let mut on_features = [V::zero(); C];
            for_each_vector::<V>(
                record,
                job,
                alive,
                #[inline(always)]
                |at, row, u, rows| {
                    let transmittance = buffers.transmittance.as_mut_ptr().add(at);
                    let step = blend(u, falloff, V::splat(rows.peak[row]), V::load(transmittance));
                    step.next.store(transmittance);
                    let mut towards = V::zero();
                    for c in 0..C {
                        let g = V::load(buffers.planes[c].as_ptr().add(at));
                        towards = g.mul_add(V::splat(record[RECORD_HEAD + c]), towards);
                        on_features[c] = step.weight.mul_add(g, on_features[c]);
                    }
                    let behind = buffers.behind.as_mut_ptr().add(at);
                    let own = step.weight.mul(towards);
                    let rest = V::load(behind).sub(own);
                    rest.store(behind);
                    // α·dL/dα = α·T·(f·g) − α/(1−α)·(what lies behind); nothing flows where α was clamped.
                    let free = V::both(step.drawn, step.raw.lt(V::splat(ALPHA_MAX)));
                    let share = step.alpha.div(V::splat(1.0).sub(step.alpha));
                    let dp = share.neg_mul_add(rest, own).keep(free);
                    let dy = V::splat(rows.dy[row]);
                    let (dp_u, dp_dy) = (dp.mul(u), dp.mul(dy));
                    moments[0] = moments[0].add(dp);
                    moments[1] = moments[1].add(dp_u);
                    moments[2] = dp_u.mul_add(u, moments[2]);
                    moments[3] = moments[3].add(dp_dy);
                    moments[4] = dp_u.mul_add(dy, moments[4]);
                    moments[5] = dp_dy.mul_add(dy, moments[5]);
                    moments[6] = moments[6].add(step.weight);
                },
            );
            slot[..SLOT_HEAD].copy_from_slice(&V::sum_eight(moments));
            for (s, v) in slot[SLOT_HEAD..].iter_mut().zip(on_features) {
                *s = v.sum();
            }
        }
    }
    slots[done * (SLOT_HEAD + C)..].fill(0.0);
}

/// Told of each entry of a tile and of its (x, y, weight) pixels.
type Visit<'a> = &'a mut dyn FnMut(u32, &mut dyn Iterator<Item = (usize, usize, f32)>);

/// Calls `visit(splat, its pixels as (x, y, α·T))` for each entry of a tile that shows, front to back.
///
/// Plain lanes: this runs once a frame, not in a fitting loop.
pub(crate) fn weights(job: &TileJob, channels: usize, visit: Visit<'_>) {
    let stride = RECORD_HEAD + channels;
    let mut transmittance = [-1.0f32; BUFFER];
    for row in transmittance.chunks_exact_mut(ROW_STRIDE).take(job.size[1]) {
        row[..job.size[0]].fill(1.0);
    }
    let mut found: Vec<(usize, usize, f32)> = Vec::with_capacity(TILE_WIDTH * TILE_HEIGHT);
    for &entry in job.entries {
        let record = &job.records[entry as usize * stride..][..stride];
        found.clear();
        weigh_entry(job, record, &mut transmittance, &mut found);
        if !found.is_empty() {
            visit(entry, &mut found.drain(..));
        }
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn weigh_entry_lanes<V: Lanes>(
    job: &TileJob,
    record: &[f32],
    transmittance: &mut [f32; BUFFER],
    found: &mut Vec<(usize, usize, f32)>,
) {
    // SAFETY: as in `forward_tile`.
    unsafe {
        let falloff = V::splat(record[7]);
        for_each_vector::<V>(
            record,
            job,
            ALL_ROWS,
            #[inline(always)]
            |place, row, u, rows| {
                let (at, x) = (transmittance.as_mut_ptr().add(place), place % ROW_STRIDE);
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
    fn weigh_entry(job: &TileJob, record: &[f32], transmittance: &mut [f32; BUFFER], found: &mut Vec<(usize, usize, f32)>) = weigh_entry_lanes;
}
dispatched! {
    /// [`forward_tile`] at the machine's level.
    ///
    /// Its contract: the planes hold the tile's pixels, and no other tile's kernel shares them.
    pub(crate) fn forward[const C: usize](job: &TileJob, out: &PlanePointers<C>) = forward_tile;
}
dispatched! {
    /// [`backward_tile`] at the machine's level.
    pub(crate) fn backward[const C: usize](job: &TileJob, picture: &PlaneGradients<C>, slots: &mut [f32]) = backward_tile;
}
