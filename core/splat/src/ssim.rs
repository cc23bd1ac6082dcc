//! Structural similarity and its exact gradient. Twin of `reference/loss.rs`.
//!
//! 11×11 Gaussian window of σ = 1.5 px, zero padding, C1 = 0.01², C2 = 0.03² for values in [0, 1]; the mean is over all
//! pixels and planes (Wang et al. 2004, as Kerbl et al. 2023 use it). Pictures are planar f32; sums are f64.

use crate::error::{SplatError, expect_length};
use crate::lanes::{Lanes, dispatched};
use rayon::prelude::*;

pub(crate) const RADIUS: usize = 5;
pub(crate) const SIGMA: f64 = 1.5;
pub(crate) const C1: f64 = 1e-4;
pub(crate) const C2: f64 = 9e-4;

/// The window's weights along one axis, summing to 1.
pub(crate) fn window() -> [f64; 2 * RADIUS + 1] {
    let raw: [f64; 2 * RADIUS + 1] =
        std::array::from_fn(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp());
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
    let bands = size[1].div_ceil(BAND);
    let mut maps = if gradient.is_some() { vec![0.0; 3 * a.len()] } else { Vec::new() };
    // Each band of rows makes its share of the three maps that the gradient is a convolution of.
    let mut outputs: Vec<[&mut [f32]; 3]> = Vec::with_capacity(bands);
    if gradient.is_some() {
        let (first, rest) = maps.split_at_mut(a.len());
        let (second, third) = rest.split_at_mut(a.len());
        let step = BAND * size[0];
        let chunks = first.chunks_mut(step).zip(second.chunks_mut(step)).zip(third.chunks_mut(step));
        outputs.extend(chunks.map(|((x, y), z)| [x, y, z]));
    } else {
        outputs.extend((0..bands).map(|_| [&mut [][..], &mut [][..], &mut [][..]]));
    }
    let sums: Vec<f64> =
        outputs.into_par_iter().enumerate().map(|(band, out)| band_similarity(a, b, size, band, out)).collect();
    if let Some((weight, gradient)) = gradient {
        let maps = &maps;
        gradient
            .par_chunks_mut(BAND * size[0])
            .enumerate()
            .for_each(|(band, out)| band_gradient(a, b, maps, size, band, weight, out));
    }
    sums.iter().sum()
}

/// Rows of a parallel task.
const BAND: usize = 32;

/// Rows that the window around row `y` covers.
#[inline(always)]
fn rows_in_reach(y: usize, height: usize) -> std::ops::RangeInclusive<usize> {
    y.saturating_sub(RADIUS)..=(y + RADIUS).min(height - 1)
}

/// Padded length of a row, so that a horizontal pass reads without bounds of its own.
fn padded(width: usize) -> usize {
    width + 2 * RADIUS + crate::lanes::MAX_LANES
}

/// The similarity of one band of rows; writes `∂/∂μ_a` (total), `∂/∂E[a²]` and `∂/∂E[ab]` where the maps have room.
fn band_similarity(a: &[f32], b: &[f32], size: [usize; 2], band: usize, out: [&mut [f32]; 3]) -> f64 {
    let [width, height] = size;
    let mut columns: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; padded(width)]);
    let mut means: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; padded(width)]);
    let weights = window().map(|w| w as f32);
    let mut sum = 0.0;
    for y in band * BAND..((band + 1) * BAND).min(height) {
        columns.iter_mut().for_each(|c| c.fill(0.0));
        for source in rows_in_reach(y, height) {
            let w = weights[source + RADIUS - y];
            let (ra, rb) = (&a[source * width..][..width], &b[source * width..][..width]);
            accumulate_products(w, ra, rb, &mut columns);
        }
        for (column, mean) in columns.iter().zip(&mut means) {
            convolve_row(&weights, column, mean, width);
        }
        let row = (y - band * BAND) * width;
        for x in 0..width {
            let [ma, mb, aa, bb, ab] = std::array::from_fn(|k| f64::from(means[k][x]));
            let (va, vb, cov) = (aa - ma * ma, bb - mb * mb, ab - ma * mb);
            let (l, k) = (2.0 * ma * mb + C1, 2.0 * cov + C2);
            let (p, q) = (ma * ma + mb * mb + C1, va + vb + C2);
            let value = l * k / (p * q);
            sum += value;
            if !out[0].is_empty() {
                // Chain through va = E[a²] − μa² and cov = E[ab] − μaμb.
                let by_cov = 2.0 * l / (p * q);
                let by_va = -value / q;
                let by_mean = 2.0 * mb * k / (p * q) - 2.0 * ma * value / p;
                out[0][row + x] = (by_mean - 2.0 * ma * by_va - mb * by_cov) as f32;
                out[1][row + x] = by_va as f32;
                out[2][row + x] = by_cov as f32;
            }
        }
    }
    sum
}

/// `gradient += weight·(G∗m0 + 2a·G∗m1 + b·G∗m2)` over one band of rows; `G` is its own transpose.
fn band_gradient(a: &[f32], b: &[f32], maps: &[f32], size: [usize; 2], band: usize, weight: f32, out: &mut [f32]) {
    let [width, height] = size;
    let pixels = width * height;
    let weights = window().map(|w| w as f32);
    let mut columns: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; padded(width)]);
    let mut smooth: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; padded(width)]);
    for (index, row) in out.chunks_exact_mut(width).enumerate() {
        let y = band * BAND + index;
        columns.iter_mut().for_each(|c| c.fill(0.0));
        for source in rows_in_reach(y, height) {
            let w = weights[source + RADIUS - y];
            for (k, column) in columns.iter_mut().enumerate() {
                accumulate(w, &maps[k * pixels + source * width..][..width], column);
            }
        }
        for (column, smooth) in columns.iter().zip(&mut smooth) {
            convolve_row(&weights, column, smooth, width);
        }
        let (ra, rb) = (&a[y * width..][..width], &b[y * width..][..width]);
        for x in 0..width {
            row[x] += weight * (smooth[0][x] + 2.0 * ra[x] * smooth[1][x] + rb[x] * smooth[2][x]);
        }
    }
}

/// `column[5 + x] += w·row[x]`.
#[inline]
fn accumulate(w: f32, row: &[f32], column: &mut [f32]) {
    for (c, r) in column[RADIUS..].iter_mut().zip(row) {
        *c += w * r;
    }
}

/// Adds `w` times a, b, a², b², ab to the five columns.
#[inline]
fn accumulate_products(w: f32, a: &[f32], b: &[f32], columns: &mut [Vec<f32>; 5]) {
    let [ca, cb, caa, cbb, cab] = columns;
    let n = a.len().min(b.len());
    let (ca, cb) = (&mut ca[RADIUS..RADIUS + n], &mut cb[RADIUS..RADIUS + n]);
    let (caa, cbb, cab) = (&mut caa[RADIUS..RADIUS + n], &mut cbb[RADIUS..RADIUS + n], &mut cab[RADIUS..RADIUS + n]);
    for x in 0..n {
        let (wa, wb) = (w * a[x], w * b[x]);
        ca[x] += wa;
        cb[x] += wb;
        caa[x] += wa * a[x];
        cbb[x] += wb * b[x];
        cab[x] += wa * b[x];
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn convolve_lanes<V: Lanes>(weights: &[f32; 2 * RADIUS + 1], column: &[f32], out: &mut [f32], width: usize) {
    assert!(column.len() >= padded(width) && out.len() >= padded(width), "rows are padded");
    for x in (0..width).step_by(V::N) {
        // SAFETY: x + 2·RADIUS + N lies inside the padded rows; V's features are here by contract.
        unsafe {
            let mut sum = V::zero();
            for (k, &w) in weights.iter().enumerate() {
                sum = V::splat(w).mul_add(V::load(column.as_ptr().add(x + k)), sum);
            }
            sum.store(out.as_mut_ptr().add(x));
        }
    }
}

dispatched! { fn convolve_row(weights: &[f32; 2 * RADIUS + 1], column: &[f32], out: &mut [f32], width: usize) = convolve_lanes; }
