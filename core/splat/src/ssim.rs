//! Structural similarity and its exact gradient, in lane code. Twin of `reference/loss.rs`.
//!
//! 11×11 Gaussian window of σ = 1.5 px, zero padding, C1 = 0.01², C2 = 0.03² for values in [0, 1]; the mean is over all
//! pixels and planes (Wang et al. 2004, as Kerbl et al. 2023 use it). Pictures are planar f32; a row's sum is f32 in
//! lanes, sums of rows are f64 in one order. Both passes keep the last eleven horizontally smoothed rows in a ring.

use crate::error::{SplatError, expect_length};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
use rayon::prelude::*;

pub(crate) const RADIUS: usize = 5;
pub(crate) const SIGMA: f64 = 1.5;
pub(crate) const C1: f64 = 1e-4;
pub(crate) const C2: f64 = 9e-4;

/// Width of the window.
const TAPS: usize = 2 * RADIUS + 1;
/// Rows of a parallel task.
const BAND: usize = 64;
/// Smoothed maps of the similarity: a, b, a², b², ab.
const MOMENTS: usize = 5;
/// Maps that the gradient is a smoothing of: by the mean of a (total), by E[a²], by E[ab].
const SLOPES: usize = 3;

/// The window's weights along one axis, summing to 1.
pub(crate) fn window() -> [f64; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}

/// Mean structural similarity of two pictures of `width × height` planes with values in [0, 1]; 1 for equal ones.
///
/// # Errors
/// When the lengths differ or are not whole planes.
pub fn ssim(a: &[f32], b: &[f32], width: usize, height: usize) -> Result<f64, SplatError> {
    similarity(a, b, [width, height], None)
}

/// Mean similarity; adds `weight` times its gradient with respect to `a` to `gradient` where one is given.
pub(crate) fn similarity(
    a: &[f32],
    b: &[f32],
    size: [usize; 2],
    gradient: Option<(f32, &mut [f32])>,
) -> Result<f64, SplatError> {
    let pixels = size[0] * size[1];
    expect_length("the second picture", a.len(), b.len())?;
    if pixels == 0 || a.is_empty() || !a.len().is_multiple_of(pixels) {
        return Err(SplatError::Length { what: "a picture (whole planes)", expected: pixels, found: a.len() });
    }
    let scale = 1.0 / a.len() as f64;
    let planes = a.par_chunks(pixels).zip(b.par_chunks(pixels));
    let sums: Vec<f64> = match gradient {
        None => planes.map(|(a, b)| plane_similarity(a, b, size, None)).collect(),
        Some((weight, gradient)) => {
            expect_length("the gradient of a picture", a.len(), gradient.len())?;
            let weight = weight * scale as f32;
            planes
                .zip(gradient.par_chunks_mut(pixels))
                .map(|((a, b), g)| plane_similarity(a, b, size, Some((weight, g))))
                .collect()
        }
    };
    Ok(sums.iter().sum::<f64>() * scale)
}

/// Sum over a plane of the similarity; adds its gradient.
fn plane_similarity(a: &[f32], b: &[f32], size: [usize; 2], gradient: Option<(f32, &mut [f32])>) -> f64 {
    let [width, height] = size;
    let step = BAND * width;
    let Some((weight, gradient)) = gradient else {
        let sums = (0..height.div_ceil(BAND)).into_par_iter().map(|band| band_similarity(a, b, size, band, None));
        return sums.collect::<Vec<f64>>().iter().sum();
    };
    // Row by row, the three maps side by side.
    let mut maps = vec![0.0; SLOPES * a.len()];
    let bands = maps.par_chunks_mut(SLOPES * step).enumerate();
    let sums: Vec<f64> = bands.map(|(band, maps)| band_similarity(a, b, size, band, Some(maps))).collect();
    let maps = &maps;
    gradient
        .par_chunks_mut(step)
        .enumerate()
        .for_each(|(band, out)| band_gradient([a, b], maps, size, (band, weight), out));
    sums.iter().sum()
}

/// The last rows that were smoothed horizontally, `K` maps each; rows are padded so that lanes may run over.
struct Ring<const K: usize> {
    weights: [f32; TAPS],
    padded: usize,
    /// One unsmoothed row of each map, with a border of zeros.
    source: Vec<f32>,
    /// `TAPS × K` smoothed rows.
    rows: Vec<f32>,
}

impl<const K: usize> Ring<K> {
    fn new(width: usize) -> Self {
        let padded = width + 2 * RADIUS + MAX_LANES;
        let weights = window().map(|w| w as f32);
        Self { weights, padded, source: vec![0.0; K * padded], rows: vec![0.0; TAPS * K * padded] }
    }

    /// Puts source row `y` (which may lie outside the picture) in its place; `fill` writes the maps' values.
    fn push(&mut self, y: isize, size: [usize; 2], fill: impl FnOnce(usize, &mut [f32], usize)) {
        let place = y.rem_euclid(TAPS as isize) as usize * K * self.padded;
        let rows = &mut self.rows[place..place + K * self.padded];
        if y < 0 || y as usize >= size[1] {
            rows.fill(0.0);
            return;
        }
        fill(y as usize, &mut self.source, self.padded);
        for (source, row) in self.source.chunks_exact(self.padded).zip(rows.chunks_exact_mut(self.padded)) {
            smooth_row(&self.weights, source, row, size[0]);
        }
    }

    /// Starts of the rows that the window around row `y` covers, top to bottom.
    fn window_starts(&self, y: usize) -> [usize; TAPS] {
        std::array::from_fn(|k| {
            (y as isize + k as isize - RADIUS as isize).rem_euclid(TAPS as isize) as usize * K * self.padded
        })
    }
}

/// The similarity of one band of rows; writes the slopes where there is room for them.
fn band_similarity(a: &[f32], b: &[f32], size: [usize; 2], band: usize, mut slopes: Option<&mut [f32]>) -> f64 {
    let [width, height] = size;
    let mut ring = Ring::<MOMENTS>::new(width);
    let fill = |y: usize, source: &mut [f32], padded: usize| {
        let (ra, rb) = (&a[y * width..][..width], &b[y * width..][..width]);
        products(ra, rb, source, padded);
    };
    let first = band * BAND;
    let (mut sum, mut next) = (0.0, first as isize - RADIUS as isize);
    let mut out = vec![0.0; SLOPES * (width + MAX_LANES)];
    for y in first..(first + BAND).min(height) {
        while next <= (y + RADIUS) as isize {
            ring.push(next, size, fill);
            next += 1;
        }
        let starts = ring.window_starts(y);
        sum += f64::from(similarity_row(&ring.weights, &ring.rows, (&starts, ring.padded), width, &mut out));
        if let Some(slopes) = slopes.as_deref_mut() {
            let row = &mut slopes[SLOPES * (y - first) * width..][..SLOPES * width];
            for (to, from) in row.chunks_exact_mut(width).zip(out.chunks_exact(width + MAX_LANES)) {
                to.copy_from_slice(&from[..width]);
            }
        }
    }
    sum
}

/// `gradient += weight·(G∗m0 + 2a·G∗m1 + b·G∗m2)` over one band of rows; `G` is its own transpose.
fn band_gradient([a, b]: [&[f32]; 2], maps: &[f32], size: [usize; 2], (band, weight): (usize, f32), out: &mut [f32]) {
    let width = size[0];
    let mut ring = Ring::<SLOPES>::new(width);
    let fill = |y: usize, source: &mut [f32], padded: usize| {
        let row = &maps[SLOPES * y * width..][..SLOPES * width];
        for (to, from) in source.chunks_exact_mut(padded).zip(row.chunks_exact(width)) {
            to[RADIUS..RADIUS + width].copy_from_slice(from);
        }
    };
    let first = band * BAND;
    let mut next = first as isize - RADIUS as isize;
    let mut smooth = vec![0.0; SLOPES * (width + MAX_LANES)];
    for (index, row) in out.chunks_exact_mut(width).enumerate() {
        let y = first + index;
        while next <= (y + RADIUS) as isize {
            ring.push(next, size, fill);
            next += 1;
        }
        let starts = ring.window_starts(y);
        smooth_columns(&ring.weights, &ring.rows, (&starts, ring.padded), width, &mut smooth);
        let (ra, rb) = (&a[y * width..][..width], &b[y * width..][..width]);
        let (m0, rest) = smooth.split_at(width + MAX_LANES);
        let (m1, m2) = rest.split_at(width + MAX_LANES);
        for ((((g, a), b), m0), (m1, m2)) in row.iter_mut().zip(ra).zip(rb).zip(m0).zip(m1.iter().zip(m2)) {
            *g += weight * (m0 + 2.0 * a * m1 + b * m2);
        }
    }
}

/// Writes a, b, a², b², ab behind each row's border.
fn products(a: &[f32], b: &[f32], source: &mut [f32], padded: usize) {
    let mut rows = source.chunks_exact_mut(padded).map(|row| &mut row[RADIUS..RADIUS + a.len()]);
    for kind in 0..MOMENTS {
        let Some(row) = rows.next() else { return };
        let (p, q): (&[f32], &[f32]) = match kind {
            0 => {
                row.copy_from_slice(a);
                continue;
            }
            1 => {
                row.copy_from_slice(b);
                continue;
            }
            2 => (a, a),
            3 => (b, b),
            _ => (a, b),
        };
        for ((to, p), q) in row.iter_mut().zip(p).zip(q) {
            *to = p * q;
        }
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn smooth_row_lanes<V: Lanes>(weights: &[f32; TAPS], source: &[f32], out: &mut [f32], width: usize) {
    assert!(source.len() >= width + 2 * RADIUS + MAX_LANES && out.len() >= width + MAX_LANES, "rows are padded");
    for x in (0..width).step_by(V::N) {
        // SAFETY: x + 2·RADIUS + N lies inside the padded rows; V's features are here by contract.
        unsafe {
            let mut sum = V::zero();
            for (k, &w) in weights.iter().enumerate() {
                sum = V::splat(w).mul_add(V::load(source.as_ptr().add(x + k)), sum);
            }
            sum.store(out.as_mut_ptr().add(x));
        }
    }
}

/// The `K` maps smoothed vertically at column `x`.
///
/// # Safety
/// Inside a function with the features of `V`; `starts + K·padded` lies inside `rows`, and `x + N ≤ padded`.
#[inline(always)]
unsafe fn column<V: Lanes, const K: usize>(
    weights: &[f32; TAPS],
    rows: &[f32],
    (starts, padded): (&[usize; TAPS], usize),
    x: usize,
) -> [V; K] {
    // SAFETY: the caller's contract.
    unsafe {
        let mut sums = [V::zero(); K];
        for (&start, &w) in starts.iter().zip(weights) {
            let w = V::splat(w);
            for (k, sum) in sums.iter_mut().enumerate() {
                *sum = w.mul_add(V::load(rows.as_ptr().add(start + k * padded + x)), *sum);
            }
        }
        sums
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn smooth_columns_lanes<V: Lanes>(
    weights: &[f32; TAPS],
    rows: &[f32],
    place: (&[usize; TAPS], usize),
    width: usize,
    out: &mut [f32],
) {
    check(rows.len(), place, width, SLOPES, out.len());
    for x in (0..width).step_by(V::N) {
        // SAFETY: checked above; V's features are here by contract.
        unsafe {
            let maps: [V; SLOPES] = column(weights, rows, place, x);
            for (k, map) in maps.into_iter().enumerate() {
                map.store(out.as_mut_ptr().add(k * (width + MAX_LANES) + x));
            }
        }
    }
}

fn check(rows: usize, (starts, padded): (&[usize; TAPS], usize), width: usize, maps: usize, out: usize) {
    let inside = starts.iter().all(|start| start + maps * padded <= rows);
    assert!(inside && padded >= width + MAX_LANES && out >= SLOPES * (width + MAX_LANES), "rows are padded");
}

/// Similarity of a row, summed; its slopes in three padded rows.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn similarity_row_lanes<V: Lanes>(
    weights: &[f32; TAPS],
    rows: &[f32],
    place: (&[usize; TAPS], usize),
    width: usize,
    out: &mut [f32],
) -> f32 {
    check(rows.len(), place, width, MOMENTS, out.len());
    // SAFETY: checked above; V's features are here by contract.
    unsafe {
        let (c1, c2, two, one) = (V::splat(C1 as f32), V::splat(C2 as f32), V::splat(2.0), V::splat(1.0));
        let iota: [f32; MAX_LANES] = std::array::from_fn(|i| i as f32);
        let mut total = V::zero();
        for x in (0..width).step_by(V::N) {
            let [ma, mb, aa, bb, ab]: [V; MOMENTS] = column(weights, rows, place, x);
            let (va, vb, cov) = (ma.neg_mul_add(ma, aa), mb.neg_mul_add(mb, bb), ma.neg_mul_add(mb, ab));
            let (l, k) = (ma.mul(mb).mul_add(two, c1), cov.mul_add(two, c2));
            let (p, q) = (ma.mul_add(ma, mb.mul_add(mb, c1)), va.add(vb).add(c2));
            let (by_p, by_q) = (one.div(p), one.div(q));
            let scale = by_p.mul(by_q);
            let value = l.mul(k).mul(scale);
            // Chain through va = E[a²] − μa² and cov = E[ab] − μaμb.
            let by_cov = two.mul(l).mul(scale);
            let by_va = V::zero().sub(value.mul(by_q));
            let by_mean = two.mul(mb.mul(k).mul(scale).sub(ma.mul(value).mul(by_p)));
            let total_mean = mb.neg_mul_add(by_cov, two.mul(ma).neg_mul_add(by_va, by_mean));
            for (map, slope) in [total_mean, by_va, by_cov].into_iter().enumerate() {
                slope.store(out.as_mut_ptr().add(map * (width + MAX_LANES) + x));
            }
            total = total.add(value.keep(V::load(iota.as_ptr()).lt(V::splat((width - x) as f32))));
        }
        total.sum()
    }
}

dispatched! { fn smooth_row(weights: &[f32; TAPS], source: &[f32], out: &mut [f32], width: usize) = smooth_row_lanes; }
dispatched! { fn smooth_columns(weights: &[f32; TAPS], rows: &[f32], place: (&[usize; TAPS], usize), width: usize, out: &mut [f32]) = smooth_columns_lanes; }
dispatched! { fn similarity_row(weights: &[f32; TAPS], rows: &[f32], place: (&[usize; TAPS], usize), width: usize, out: &mut [f32]) -> f32 = similarity_row_lanes; }
