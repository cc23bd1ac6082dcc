//! What makes the skull a face: nose, lips, lids, sockets, brows, chin, hair, as displacements of the smooth head.
//!
//! Millimetres, head axes. Functions here take a point of the sheet and give where it goes; symmetric in x.

use super::profile::{smoothstep, table};

/// Height of the mouth line, millimetres.
pub const MOUTH_Y: f64 = -56.0;
/// Half width of the mouth in sheet columns (at the reference half width of 75 mm).
pub const MOUTH_COLUMN: f64 = 28.0;
/// Height of the line through the eye corners.
pub const EYE_Y: f64 = 15.0;
/// Inner and outer eye corner in sheet columns.
pub const EYE_COLUMNS: [f64; 2] = [15.0, 45.0];
/// Centre of the subject's left eyeball.
pub const EYE_CENTRE: [f64; 3] = [31.0, 15.0, 67.5];
/// Radius of the eyeball.
pub const EYE_RADIUS: f64 = 13.0;

/// Mid-sagittal profile from brow to chin: height, depth, width of its influence.
const PROFILE: [[f64; 3]; 27] = [
    [-106.0, 76.0, 17.0],
    [-101.0, 86.5, 18.0],
    [-95.0, 92.0, 19.0],
    [-88.0, 93.0, 18.0],
    [-80.0, 91.6, 17.0],
    [-74.5, 90.2, 17.0],
    [-70.0, 91.2, 18.0],
    [-66.0, 95.0, 20.0],
    [-62.0, 97.6, 21.0],
    [-58.5, 97.6, 21.0],
    [-56.0, 95.6, 21.0],
    [-53.5, 98.6, 21.0],
    [-50.5, 99.6, 21.0],
    [-47.0, 98.4, 21.0],
    [-42.0, 96.6, 20.0],
    [-37.5, 96.0, 15.0],
    [-34.5, 97.6, 11.0],
    [-31.5, 102.5, 10.5],
    [-28.5, 108.0, 11.8],
    [-25.5, 111.6, 12.6],
    [-22.0, 112.8, 12.8],
    [-18.0, 111.8, 12.6],
    [-10.0, 109.0, 12.0],
    [2.0, 102.8, 11.2],
    [13.0, 95.6, 10.2],
    [21.0, 92.6, 10.0],
    [32.0, 95.6, 13.0],
];

/// A Gaussian bump in the frontal plane, mirrored in x: centre, widths, rise along z.
struct Bump {
    centre: [f64; 2],
    width: [f64; 2],
    rise: f64,
}

const fn bump(x: f64, y: f64, width_x: f64, width_y: f64, rise: f64) -> Bump {
    Bump { centre: [x, y], width: [width_x, width_y], rise }
}

const BUMPS: [Bump; 19] = [
    bump(26.0, 34.0, 17.0, 6.0, 3.2),    // brow ridge
    bump(14.5, 15.5, 5.5, 9.0, -5.5),    // socket beside the nose
    bump(31.0, 3.0, 13.0, 4.0, -2.4),    // fold under the eye
    bump(32.0, 26.0, 14.0, 4.0, -2.5),   // crease above the lid
    bump(51.0, 14.0, 7.0, 10.0, -3.5),   // outer rim
    bump(44.0, -10.0, 15.0, 12.0, 4.5),  // cheekbone
    bump(26.0, -20.0, 9.0, 12.0, 1.5),   // cheek beside the nose
    bump(14.2, -26.5, 4.2, 5.2, 8.2),    // wing of the nose
    bump(21.5, -25.0, 3.2, 6.0, -2.0),   // groove beside it
    bump(6.6, -33.2, 3.4, 2.2, -4.2),    // nostril
    bump(0.0, -41.5, 2.4, 4.5, -1.1),    // philtrum
    bump(5.0, -43.5, 2.6, 4.5, 0.5),     // its ridge
    bump(25.5, -56.5, 5.0, 5.5, -3.2),   // corner of the mouth
    bump(31.0, -45.0, 5.0, 12.0, -1.2),  // fold from nose to mouth
    bump(0.0, -74.0, 20.0, 4.0, -1.2),   // fold under the lip
    bump(36.0, -78.0, 16.0, 14.0, -1.5), // hollow before the jaw
    bump(0.0, 66.0, 30.0, 18.0, 1.2),    // forehead
    bump(66.0, 40.0, 10.0, 20.0, -1.5),  // temple
    bump(12.0, -60.5, 9.0, 4.0, 0.8),    // body of the lower lip
];

/// Opens the slits of the sheet in its own plane: where a grid point at column `x_mm` (sheet columns) and front height
/// `y_mm` lies in height. `side` is +1 on or above a slit's upper edge, −1 on or below its lower edge.
pub fn opened_height(column_mm: f64, y_mm: f64, side: f64) -> f64 {
    let bent = if y_mm > EYE_Y + 2.0 { bent_along_brow(column_mm, y_mm) } else { y_mm };
    opened_mouth(column_mm, opened_eye(column_mm, bent, side), side)
}

fn opened_eye(column_mm: f64, y_mm: f64, side: f64) -> f64 {
    let [inner, outer] = EYE_COLUMNS;
    let u = (column_mm.abs() - inner) / (outer - inner);
    let distance = y_mm - EYE_Y;
    let tilt = (-1.3 + 2.2 * u.clamp(-0.3, 1.3))
        * smoothstep(22.0, 0.0, distance.abs())
        * smoothstep(-0.5, -0.1, u)
        * smoothstep(1.5, 1.1, u);
    if !(0.0..=1.0).contains(&u) {
        return y_mm + tilt;
    }
    // Almond: the upper edge peaks nearer the nose, the lower nearer the temple.
    let upper = 5.6 * (4.0 * u.powf(0.85) * (1.0 - u.powf(0.85))).powf(0.8);
    let lower = 4.6 * (4.0 * u.powf(1.15) * (1.0 - u.powf(1.15))).powf(0.8);
    let open = if side >= 0.0 { upper } else { -lower };
    let reach = if side >= 0.0 { 15.0 } else { 17.0 };
    let fade = (1.0 - distance.abs() / reach).max(0.0);
    y_mm + tilt + open * fade * fade.sqrt()
}

/// Half-height of the reddened lip at a column, as a fraction of its height in the middle.
fn lip_taper(column_mm: f64) -> f64 {
    let u = (column_mm.abs() / MOUTH_COLUMN).min(1.0);
    (1.0 - u.powf(2.2)).powf(0.8)
}

fn opened_mouth(column_mm: f64, y_mm: f64, side: f64) -> f64 {
    let distance = y_mm - MOUTH_Y;
    let reach = smoothstep(20.0, 7.0, distance.abs());
    if reach == 0.0 {
        return y_mm;
    }
    let beyond = smoothstep(MOUTH_COLUMN + 12.0, MOUTH_COLUMN, column_mm.abs());
    let squeeze = 1.0 - (1.0 - lip_taper(column_mm).max(0.30)) * reach * beyond * smoothstep(18.0, 5.0, distance.abs());
    let u = column_mm / MOUTH_COLUMN;
    let bow = if side >= 0.0 {
        // Cupid's bow: a dip in the middle, two peaks beside it.
        1.1 * ((-((u.abs() - 0.26) / 0.16).powi(2)).exp() - (-(u / 0.12).powi(2)).exp() * 0.6)
            * smoothstep(1.5, 6.5, distance)
            * smoothstep(14.0, 7.0, distance)
    } else {
        0.0
    };
    let line = 0.9 * (-(u / 0.25).powi(2)).exp() * -0.5 - 0.8 * (u * u).min(1.0) * beyond;
    MOUTH_Y + distance * squeeze + (bow + line) * reach
}

/// Whether a grid point belongs to the red of the lips.
pub fn is_lip(column_mm: f64, y_mm: f64) -> bool {
    let distance = y_mm - MOUTH_Y;
    column_mm.abs() < MOUTH_COLUMN + 0.5 && (-9.8..=6.8).contains(&distance)
}

/// Depth of a point of the face's front after all features, from its depth on the smooth head.
pub fn featured_depth(x: f64, y: f64, smooth_depth: f64, smooth_midline_depth: f64) -> f64 {
    let mut z = smooth_depth;
    if (PROFILE[0][0]..PROFILE[PROFILE.len() - 1][0] + 14.0).contains(&y) {
        let [_, target, width] = table(&PROFILE, y);
        let fade = smoothstep(46.0, 32.0, y);
        let power = if y > -36.0 { 2.3 } else { 2.0 };
        z += fade * (target - smooth_midline_depth) * (-(x.abs() / width).powf(power)).exp();
    }
    for Bump { centre: [cx, cy], width: [wx, wy], rise } in &BUMPS {
        let vertical = (-((y - cy) / wy).powi(2)).exp();
        let left = (-((x - cx) / wx).powi(2)).exp();
        let right = if *cx == 0.0 { 0.0 } else { (-((x + cx) / wx).powi(2)).exp() };
        z += rise * vertical * (left + right);
    }
    lidded_depth(x, y, z)
}

/// Lays the lids over the eyeball.
fn lidded_depth(x: f64, y: f64, z: f64) -> f64 {
    let (dx, dy) = (x.abs() - EYE_CENTRE[0], y - EYE_CENTRE[1]);
    let near = smoothstep(1.75, 0.75, (dx / 16.5).powi(2) + (dy / 9.5).powi(2));
    if near == 0.0 {
        return z;
    }
    let reach = if dx > 0.0 { 16.0 } else { 17.2 };
    let inside = 1.0 - (dx / reach).powi(2) - (dy / (EYE_RADIUS + 1.3)).powi(2);
    let lid = EYE_CENTRE[2] + (EYE_RADIUS + 1.3) * inside.max(0.02).sqrt();
    z + near * (lid - z)
}

/// Height of the hairline at an angle around the head (radians), in front heights.
pub fn hairline_height(angle: f64) -> f64 {
    const LINE: [[f64; 2]; 11] = [
        [0.0, 73.0],
        [25.0, 74.0],
        [42.0, 66.0],
        [52.0, 48.0],
        [60.0, 30.0],
        [68.0, 16.0],
        [80.0, 2.0],
        [95.0, 6.0],
        [112.0, -8.0],
        [135.0, -62.0],
        [180.0, -78.0],
    ];
    // Mirrored about the back as about the front.
    let around = angle.abs();
    table(&LINE, around.min(2.0 * std::f64::consts::PI - around).to_degrees())[1]
}

/// How far a point at a front height and angle lies above the hairline, millimetres along the skin, and the direction in
/// which it is nearest: change of angle and of height per millimetre.
pub fn above_hairline(y: f64, angle: f64) -> (f64, [f64; 2]) {
    const RADIUS: f64 = 72.0;
    let slope = (hairline_height(angle + 0.01) - hairline_height(angle - 0.01)) / (0.02 * RADIUS);
    let length = slope.hypot(1.0);
    ((y - hairline_height(angle)) / length, [-slope / length / RADIUS, 1.0 / length])
}

/// How far hair lifts the scalp at a front height `y` and angle, millimetres, and whether the point is scalp.
pub fn hair(y: f64, angle: f64) -> (f64, bool) {
    let above = y - hairline_height(angle);
    (8.5 * smoothstep(-1.0, 18.0, above), above > -0.05)
}

/// Height of the middle of the brow's rows in the grid.
const BROW_Y: f64 = 36.5;

/// Bends the rows along the eyebrow and squeezes them toward its outer end.
fn bent_along_brow(column_mm: f64, y_mm: f64) -> f64 {
    const LINE: [[f64; 3]; 8] = [
        [0.0, 0.0, 1.0],
        [6.0, -1.6, 1.0],
        [12.0, -2.6, 1.15],
        [22.0, -0.2, 1.25],
        [34.0, 1.8, 1.05],
        [44.0, 0.2, 0.75],
        [54.0, -4.5, 0.55],
        [66.0, 0.0, 1.0],
    ];
    let [_, shift, squeeze] = table(&LINE, column_mm.abs());
    let distance = y_mm - BROW_Y;
    BROW_Y
        + distance * (1.0 + (squeeze - 1.0) * smoothstep(9.0, 3.0, distance.abs()))
        + shift * smoothstep(18.0, 2.0, distance.abs())
}

/// Whether a grid point belongs to an eyebrow.
pub fn is_brow(column_mm: f64, y_mm: f64) -> bool {
    (11.0..54.0).contains(&column_mm.abs()) && (y_mm - BROW_Y).abs() < 2.0
}
