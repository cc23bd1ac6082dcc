//! The guided filter with a colour guide (He, Sun, Tang, "Guided Image Filtering", TPAMI 2013, section 3.5).

use heartian_space::Rgb8Image;

/// Mean over a square window clipped to the image, by running sums in f64 along each axis.
pub(super) fn box_mean(plane: &[f32], size: usize, radius: usize) -> Vec<f32> {
    let count = |at: usize| ((at + radius).min(size - 1) - at.saturating_sub(radius) + 1) as f64;
    let scale: Vec<f64> = (0..size).map(|at| 1.0 / count(at)).collect();
    let mut rows = Vec::with_capacity(plane.len());
    for row in plane.chunks_exact(size.max(1)) {
        let mut sum: f64 = row[..radius.min(size)].iter().map(|v| f64::from(*v)).sum();
        for x in 0..size {
            if x + radius < size {
                sum += f64::from(row[x + radius]);
            }
            if x > radius {
                sum -= f64::from(row[x - radius - 1]);
            }
            rows.push((sum * scale[x]) as f32);
        }
    }
    let row = |y: usize| &rows[y * size..(y + 1) * size];
    let mut sums = vec![0.0f64; size];
    let add = |sums: &mut [f64], y: usize, sign: f64| {
        sums.iter_mut().zip(row(y)).for_each(|(sum, value)| *sum += sign * f64::from(*value));
    };
    (0..radius.min(size)).for_each(|y| add(&mut sums, y, 1.0));
    let mut out = Vec::with_capacity(plane.len());
    for y in 0..size {
        if y + radius < size {
            add(&mut sums, y + radius, 1.0);
        }
        if y > radius {
            add(&mut sums, y - radius - 1, -1.0);
        }
        out.extend(sums.iter().map(|sum| (sum * scale[y]) as f32));
    }
    out
}

/// Filters `mask` so that it follows the image's edges. `regularisation` is a variance of colours in [0, 1].
pub(super) fn filter(image: &Rgb8Image, mask: &[f32], radius: usize, regularisation: f32) -> Vec<f32> {
    let size = image.width;
    let mean = |plane: &[f32]| box_mean(plane, size, radius);
    let product = |a: &[f32], b: &[f32]| -> Vec<f32> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let guide: [Vec<f32>; 3] =
        std::array::from_fn(|c| image.data.iter().skip(c).step_by(3).map(|v| f32::from(*v) / 255.0).collect());
    let means = [mean(&guide[0]), mean(&guide[1]), mean(&guide[2])];
    let mask_mean = mean(mask);
    let cross: [Vec<f32>; 3] = std::array::from_fn(|c| mean(&product(&guide[c], mask)));
    const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    let second = PAIRS.map(|(a, b)| mean(&product(&guide[a], &guide[b])));
    let mut slopes: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; mask.len()]);
    let mut offset = vec![0.0; mask.len()];
    for i in 0..mask.len() {
        let m = [means[0][i], means[1][i], means[2][i]];
        let mut sigma = [0.0; 6];
        for (k, (a, b)) in PAIRS.into_iter().enumerate() {
            sigma[k] = second[k][i] - m[a] * m[b] + if a == b { regularisation } else { 0.0 };
        }
        let covariance = std::array::from_fn(|c| cross[c][i] - m[c] * mask_mean[i]);
        let a = solve(sigma, covariance);
        (0..3).for_each(|c| slopes[c][i] = a[c]);
        offset[i] = mask_mean[i] - a[0] * m[0] - a[1] * m[1] - a[2] * m[2];
    }
    let slopes = [mean(&slopes[0]), mean(&slopes[1]), mean(&slopes[2])];
    let offset = mean(&offset);
    (0..mask.len())
        .map(|i| ((0..3).map(|c| slopes[c][i] * guide[c][i]).sum::<f32>() + offset[i]).clamp(0.0, 1.0))
        .collect()
}

/// Solves a symmetric positive definite 3×3 system given as (00, 01, 02, 11, 12, 22).
fn solve([a, b, c, d, e, f]: [f32; 6], r: [f32; 3]) -> [f32; 3] {
    let (m00, m01, m02) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let (m11, m12, m22) = (a * f - c * c, b * c - a * e, a * d - b * b);
    let determinant = a * m00 + b * m01 + c * m02;
    if determinant.abs() < 1e-20 {
        return [0.0; 3];
    }
    [
        (m00 * r[0] + m01 * r[1] + m02 * r[2]) / determinant,
        (m01 * r[0] + m11 * r[1] + m12 * r[2]) / determinant,
        (m02 * r[0] + m12 * r[1] + m22 * r[2]) / determinant,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_means_agree_with_their_definition() {
        let size = 13;
        let plane: Vec<f32> = (0..size * size).map(|i| ((i * 37) % 101) as f32).collect();
        for radius in [1, 4, 20] {
            let fast = box_mean(&plane, size, radius);
            for (i, fast) in fast.iter().enumerate() {
                let (y, x) = (i / size, i % size);
                let inside = |c: usize| c.saturating_sub(radius)..(c + radius + 1).min(size);
                let all: Vec<f32> =
                    inside(y).flat_map(|y| inside(x).map(move |x| (y, x))).map(|(y, x)| plane[y * size + x]).collect();
                let want = all.iter().sum::<f32>() / all.len() as f32;
                assert!((fast - want).abs() < 1e-3, "{i}: {fast} {want}");
            }
        }
    }

    #[test]
    fn a_blurred_mask_snaps_to_the_edge_of_the_picture() {
        let size = 48;
        let mut image = Rgb8Image::filled(size, size, [30, 60, 200]);
        (0..size * size).filter(|i| i % size < 24).for_each(|i| image.set_pixel(i % size, i / size, [200, 150, 120]));
        // The mask falls over six pixels, half of them on the wrong side.
        let mask: Vec<f32> =
            (0..size * size).map(|i| (1.0 - ((i % size) as f32 - 21.0) / 6.0).clamp(0.0, 1.0)).collect();
        let refined = filter(&image, &mask, 5, 1e-4);
        let at = |x: usize| refined[20 * size + x];
        assert!(at(23) - at(24) > 0.5, "{} {}", at(23), at(24));
    }
}
