//! Similarity and error measures in f64, from the definitions: the specification of `ssim.rs` and `loss.rs`.

use crate::ssim::{C1, C2, RADIUS, window};

/// Mean structural similarity of planar pictures; every window summed anew.
pub fn ssim(a: &[f64], b: &[f64], [width, height]: [usize; 2]) -> f64 {
    let (pixels, w) = (width * height, window());
    let mut sum = 0.0;
    for plane in 0..a.len() / pixels {
        for at in 0..pixels {
            let (x, y) = (at % width, at / width);
            // Means of a, b, a², b², ab under the window; outside the picture all are 0.
            let mut m = [0.0; 5];
            for dy in 0..2 * RADIUS + 1 {
                for dx in 0..2 * RADIUS + 1 {
                    let (sx, sy) = ((x + dx).wrapping_sub(RADIUS), (y + dy).wrapping_sub(RADIUS));
                    if sx < width && sy < height {
                        let i = plane * pixels + sy * width + sx;
                        for (m, v) in m.iter_mut().zip([a[i], b[i], a[i] * a[i], b[i] * b[i], a[i] * b[i]]) {
                            *m += w[dx] * w[dy] * v;
                        }
                    }
                }
            }
            let [ma, mb, aa, bb, ab] = m;
            let (va, vb, cov) = (aa - ma * ma, bb - mb * mb, ab - ma * mb);
            sum += (2.0 * ma * mb + C1) * (2.0 * cov + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2));
        }
    }
    sum / a.len() as f64
}

/// Mean absolute error.
pub fn mean_absolute_error(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.len() as f64
}

/// Peak signal-to-noise ratio in dB of values in [0, 1].
pub fn psnr(a: &[f64], b: &[f64]) -> f64 {
    let held = |v: f64| v.clamp(0.0, 1.0);
    -10.0 * (a.iter().zip(b).map(|(a, b)| (held(*a) - held(*b)).powi(2)).sum::<f64>() / a.len() as f64).log10()
}
