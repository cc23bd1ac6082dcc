//! Real spherical harmonics of bands 0 to 4 as polynomials, values and gradients, in lane code.
//! Twin of `reference/harmonics.rs`, which goes by Legendre recursion instead.
//!
//! Index `l² + l + m`, orthonormal over the sphere, no Condon–Shortley sign, polar axis z. The argument need not be of
//! unit length: the polynomials are evaluated as written (Sloan 2008, "Stupid Spherical Harmonics Tricks").

use crate::lanes::Lanes;
use crate::lanes::wide::Wide;

/// Bands 0 to 4.
pub(crate) const BANDS: usize = 5;
/// Functions in those bands.
pub(crate) const COUNT: usize = BANDS * BANDS;
/// Band of each function.
pub(crate) const BAND_OF: [usize; COUNT] = [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4];

const C0: f32 = 0.282_094_8;
const C1: f32 = 0.488_602_5;
const C2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];
const C3: [f32; 5] = [0.590_043_6, 2.890_611_4, 0.457_045_8, 0.373_176_33, 1.445_305_7];
const C4: [f32; 6] = [2.503_343, 1.770_130_8, 0.946_174_7, 0.669_046_5, 0.105_785_55, 0.473_087_35];
const C44: f32 = 0.625_835_7;

/// All functions at a direction.
#[inline(always)]
pub(crate) fn basis<V: Lanes>([x, y, z]: [Wide<V>; 3]) -> [Wide<V>; COUNT] {
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    let (difference, three_x, three_y) = (xx - yy, xx * 3.0 - yy, xx - yy * 3.0);
    let (z5, z7) = (zz * 5.0 + -1.0, zz * 7.0 + -1.0);
    let z73 = zz * 7.0 + -3.0;
    let one = zz * 0.0 + 1.0;
    [
        one * C0,
        y * C1,
        z * C1,
        x * C1,
        xy * C2[0],
        yz * C2[0],
        (zz * 3.0 + -1.0) * C2[1],
        xz * C2[0],
        difference * C2[2],
        y * three_x * C3[0],
        xy * z * C3[1],
        y * z5 * C3[2],
        z * (zz * 5.0 + -3.0) * C3[3],
        x * z5 * C3[2],
        z * difference * C3[4],
        x * three_y * C3[0],
        xy * difference * C4[0],
        yz * three_x * C4[1],
        xy * z7 * C4[2],
        yz * z73 * C4[3],
        (zz * (zz * 35.0 + -30.0) + 3.0) * C4[4],
        xz * z73 * C4[3],
        difference * z7 * C4[5],
        xz * three_y * C4[1],
        (xx * three_y - yy * three_x) * C44,
    ]
}

/// Adds `weight·factor·d` to a gradient, leaving out what is `None`.
#[inline(always)]
fn add<V: Lanes>(g: &mut [Wide<V>; 3], weight: Wide<V>, factor: f32, d: [Option<Wide<V>>; 3]) {
    let k = weight * factor;
    for (g, d) in g.iter_mut().zip(d) {
        if let Some(d) = d {
            *g = k.mul_add(d, *g);
        }
    }
}

/// Gradient at a direction of `Σ weights_i · Y_i`.
#[inline(always)]
pub(crate) fn gradient<V: Lanes>([x, y, z]: [Wide<V>; 3], w: &[Wide<V>; COUNT]) -> [Wide<V>; 3] {
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    let (difference, three_x, three_y) = (xx - yy, xx * 3.0 - yy, xx - yy * 3.0);
    let (z5, z7) = (zz * 5.0 + -1.0, zz * 7.0 + -1.0);
    let z73 = zz * 7.0 + -3.0;
    let xyz = xy * z;
    let mut g = [w[3] * C1, w[1] * C1, w[2] * C1];
    add(&mut g, w[4], C2[0], [Some(y), Some(x), None]);
    add(&mut g, w[5], C2[0], [None, Some(z), Some(y)]);
    add(&mut g, w[6], C2[1], [None, None, Some(z * 6.0)]);
    add(&mut g, w[7], C2[0], [Some(z), None, Some(x)]);
    add(&mut g, w[8], C2[2], [Some(x * 2.0), Some(y * -2.0), None]);
    add(&mut g, w[9], C3[0], [Some(xy * 6.0), Some(difference * 3.0), None]);
    add(&mut g, w[10], C3[1], [Some(yz), Some(xz), Some(xy)]);
    add(&mut g, w[11], C3[2], [None, Some(z5), Some(yz * 10.0)]);
    add(&mut g, w[12], C3[3], [None, None, Some(zz * 15.0 + -3.0)]);
    add(&mut g, w[13], C3[2], [Some(z5), None, Some(xz * 10.0)]);
    add(&mut g, w[14], C3[4], [Some(xz * 2.0), Some(yz * -2.0), Some(difference)]);
    add(&mut g, w[15], C3[0], [Some(difference * 3.0), Some(xy * -6.0), None]);
    add(&mut g, w[16], C4[0], [Some(y * three_x), Some(x * three_y), None]);
    add(&mut g, w[17], C4[1], [Some(xyz * 6.0), Some(z * difference * 3.0), Some(y * three_x)]);
    add(&mut g, w[18], C4[2], [Some(y * z7), Some(x * z7), Some(xyz * 14.0)]);
    add(&mut g, w[19], C4[3], [None, Some(z * z73), Some(y * (zz * 21.0 + -3.0))]);
    add(&mut g, w[20], C4[4], [None, None, Some(z * (zz * 140.0 + -60.0))]);
    add(&mut g, w[21], C4[3], [Some(z * z73), None, Some(x * (zz * 21.0 + -3.0))]);
    add(&mut g, w[22], C4[5], [Some(x * z7 * 2.0), Some(y * z7 * -2.0), Some(z * difference * 14.0)]);
    add(&mut g, w[23], C4[1], [Some(z * difference * 3.0), Some(xyz * -6.0), Some(x * three_y)]);
    add(&mut g, w[24], C44, [Some(x * three_y * 4.0), Some(y * three_x * -4.0), None]);
    g
}
