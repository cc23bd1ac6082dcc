//! The smooth skull and neck under the features: a stack of superelliptic horizontal sections.
//!
//! Millimetres here (the tables read like a drawing); the sheet converts to metres. A section at level `v` has a front
//! depth, a back depth, a half width and the depth of its widest point; its height differs between front, side and back,
//! which is how the jaw line rises toward the ear. Angle 0 is the front, +π/2 the subject's left.

/// One horizontal section, millimetres: heights at front, side and back; front, widest and back depth; half width;
/// exponent of the front superellipse.
const SECTIONS: [[f64; 8]; 19] = [
    // y front, side, back,  z front, widest, back, half width, exponent
    [125.5, 125.5, 125.5, -12.0, -12.0, -12.0, 0.0, 2.0],
    [122.5, 122.5, 122.5, 22.0, -12.5, -47.0, 32.0, 2.0],
    [113.0, 113.0, 113.0, 50.0, -13.0, -73.0, 53.5, 2.1],
    [97.0, 97.0, 97.0, 71.0, -14.5, -90.0, 68.0, 2.15],
    [75.0, 75.0, 75.0, 86.0, -16.0, -99.0, 75.5, 2.2],
    [52.0, 52.0, 52.0, 93.5, -16.0, -101.5, 77.5, 2.2],
    [34.0, 34.0, 33.0, 94.5, -14.5, -100.0, 77.0, 2.2],
    [15.0, 15.0, 13.0, 88.0, -11.5, -97.0, 75.5, 2.2],
    [-5.0, -5.0, -9.0, 86.5, -9.0, -92.0, 73.5, 2.2],
    [-30.0, -28.0, -34.0, 89.5, -6.0, -83.0, 71.5, 2.1],
    [-56.0, -52.0, -56.0, 91.5, -5.0, -73.0, 67.0, 2.0],
    [-80.0, -69.0, -70.0, 89.5, -4.0, -66.0, 61.0, 2.0],
    [-98.0, -79.0, -80.0, 86.0, -4.0, -62.0, 57.0, 2.0],
    [-107.0, -86.0, -88.0, 73.0, -6.0, -60.0, 53.5, 2.0],
    [-110.5, -93.0, -96.0, 49.0, -8.0, -59.0, 51.5, 2.0],
    [-116.0, -103.0, -106.0, 31.0, -12.0, -59.0, 51.5, 2.0],
    [-130.0, -121.0, -122.0, 26.0, -15.0, -61.0, 53.0, 2.0],
    [-148.0, -143.0, -141.0, 25.0, -18.0, -64.0, 56.0, 2.0],
    [-165.0, -163.0, -160.0, 27.0, -20.0, -68.0, 62.0, 2.0],
];

/// The level `v` whose front height is `y_mm`; clamped to the table.
pub fn level_of_front_height(y_mm: f64) -> f64 {
    let (mut low, mut high) = (0.0, (SECTIONS.len() - 1) as f64);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if section(middle)[0] > y_mm {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Point of the smooth head at level `v` and angle `angle` (radians), millimetres.
pub fn surface(v: f64, angle: f64) -> [f64; 3] {
    let [y_front, y_side, y_back, z_front, z_widest, z_back, half_width, exponent] = section(v);
    let (sine, cosine) = angle.sin_cos();
    let side = sine * sine;
    let x = half_width * sine;
    if cosine >= 0.0 {
        let depth = (1.0 - sine.abs().powf(exponent)).max(0.0).powf(1.0 / exponent);
        [x, y_front + (y_side - y_front) * side, z_widest + (z_front - z_widest) * depth]
    } else {
        [x, y_back + (y_side - y_back) * side, z_widest - (z_back - z_widest) * cosine]
    }
}

/// Catmull–Rom interpolation of the table.
fn section(v: f64) -> [f64; 8] {
    let last = SECTIONS.len() - 1;
    let v = v.clamp(0.0, last as f64);
    let i = (v.floor() as usize).min(last - 1);
    let at = |k: isize| SECTIONS[(i as isize + k).clamp(0, last as isize) as usize];
    let (before, from, to, after) = (at(-1), at(0), at(1), at(2));
    std::array::from_fn(|k| cubic([before[k], from[k], to[k], after[k]], v - i as f64))
}

/// Catmull–Rom spline through four equally spaced values; `u` in [0, 1] between the middle two.
fn cubic([p0, p1, p2, p3]: [f64; 4], u: f64) -> f64 {
    let slope_from = 0.5 * (p2 - p0);
    let slope_to = 0.5 * (p3 - p1);
    let difference = p2 - p1;
    p1 + u
        * (slope_from
            + u * (3.0 * difference - 2.0 * slope_from - slope_to + u * (slope_from + slope_to - 2.0 * difference)))
}

/// Interpolates rows of a table whose first column increases, by a smooth cubic; end rows hold outside.
pub fn table<const N: usize>(rows: &[[f64; N]], key: f64) -> [f64; N] {
    let last = rows.len() - 1;
    if key <= rows[0][0] {
        return rows[0];
    }
    if key >= rows[last][0] {
        return rows[last];
    }
    let i = rows.partition_point(|row| row[0] <= key) - 1;
    let u = (key - rows[i][0]) / (rows[i + 1][0] - rows[i][0]);
    let span = rows[i + 1][0] - rows[i][0];
    std::array::from_fn(|k| {
        let slope = |j: usize| {
            let (a, b) = (rows[j.saturating_sub(1)], rows[(j + 1).min(last)]);
            (b[k] - a[k]) / (b[0] - a[0]) * span
        };
        let (p1, p2, m1, m2) = (rows[i][k], rows[i + 1][k], slope(i), slope(i + 1));
        let d = p2 - p1;
        p1 + u * (m1 + u * (3.0 * d - 2.0 * m1 - m2 + u * (m1 + m2 - 2.0 * d)))
    })
}

/// 0 below `from`, 1 above `to`, smooth between; works for `from > to` too.
pub fn smoothstep(from: f64, to: f64, value: f64) -> f64 {
    let u = ((value - from) / (to - from)).clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}
