//! Real spherical harmonics of bands 0 to 4 by associated Legendre recursion: the specification of `harmonics.rs`.

use crate::harmonics::{BANDS, COUNT};

/// All functions at a unit direction, index `l² + l + m`, no Condon–Shortley sign.
pub fn basis_f64([x, y, z]: [f64; 3]) -> [f64; COUNT] {
    let azimuth = y.atan2(x);
    let side = x.hypot(y);
    let mut out = [0.0; COUNT];
    for l in 0..BANDS {
        for m in 0..=l {
            let factorials = ((l - m + 1)..=(l + m)).map(|k| k as f64).product::<f64>();
            let norm = ((2 * l + 1) as f64 / (4.0 * std::f64::consts::PI) / factorials).sqrt();
            let value = norm * associated_legendre(l, m, z, side);
            let centre = l * l + l;
            if m == 0 {
                out[centre] = value;
            } else {
                let (sin, cos) = (m as f64 * azimuth).sin_cos();
                out[centre + m] = std::f64::consts::SQRT_2 * value * cos;
                out[centre - m] = std::f64::consts::SQRT_2 * value * sin;
            }
        }
    }
    out
}

/// `P_l^m(z)` without the Condon–Shortley sign; `side = √(1 − z²)`.
fn associated_legendre(l: usize, m: usize, z: f64, side: f64) -> f64 {
    let mut diagonal = 1.0;
    for k in 0..m {
        diagonal *= (2 * k + 1) as f64 * side;
    }
    let (mut before, mut now) = (0.0, diagonal);
    for k in m + 1..=l {
        let next = ((2 * k - 1) as f64 * z * now - (k + m - 1) as f64 * before) / (k - m) as f64;
        (before, now) = (now, next);
    }
    now
}
