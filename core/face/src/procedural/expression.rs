//! How a face moves besides jaw and eyeballs: muscles as fields, and the lids.
//!
//! Millimetres at a coefficient of 1, which is a strong but human pull.

use super::features::{EYE_CENTRE, EYE_RADIUS};
use super::fields::{Field, Lip, field};
use super::profile::smoothstep;

const CORNER: [f64; 3] = [25.0, -57.0, 85.0];
const SMILE_CORNER: Field = field(CORNER, 13.0, [6.5, 6.0, -4.0]).wide([13.0, 12.0, 30.0]);
const SMILE_CHEEK: Field = field([38.0, -22.0, 76.0], 16.0, [1.5, 4.0, 2.0]);
const FROWN: Field = field(CORNER, 12.0, [0.5, -6.0, -1.0]).wide([12.0, 12.0, 30.0]);
const OUTER_BROW: Field = field([40.0, 38.0, 82.0], 15.0, [0.0, 6.0, 0.0]).wide([15.0, 14.0, 30.0]);
const SQUINT: Field = field([31.0, 6.0, 80.0], 8.0, [0.0, 3.0, 1.0]).wide([16.0, 7.0, 25.0]);

/// The modes of expression.
pub const MODES: &[&[Field]] = &[
    // Smile, left and right.
    &[SMILE_CORNER, SMILE_CHEEK],
    &[SMILE_CORNER.right(), SMILE_CHEEK.right()],
    // Corners down, left and right.
    &[FROWN],
    &[FROWN.right()],
    // Mouth stretched wide.
    &[field(CORNER, 13.0, [6.0, -1.0, -3.5]).wide([14.0, 12.0, 30.0]).both()],
    // Pucker.
    &[
        field(CORNER, 12.0, [-7.0, 0.0, 2.0]).wide([13.0, 11.0, 30.0]).both(),
        field([0.0, -56.0, 97.0], 16.0, [0.0, 0.0, 6.0]).wide([17.0, 14.0, 30.0]),
    ],
    // Funnel: lips apart and forward.
    &[
        field([0.0, -52.0, 97.0], 12.0, [0.0, 3.5, 3.0]).wide([15.0, 9.0, 30.0]).on(Lip::Upper),
        field([0.0, -60.0, 97.0], 12.0, [0.0, -3.5, 3.0]).wide([15.0, 9.0, 30.0]).on(Lip::Lower),
        field(CORNER, 12.0, [-3.0, 0.0, 1.0]).both(),
    ],
    // Upper lip raised, both sides; then the left against the right.
    &[
        field([0.0, -51.0, 96.0], 14.0, [0.0, 5.0, 0.5]).wide([19.0, 11.0, 30.0]).on(Lip::Upper),
        field([15.0, -26.0, 94.0], 9.0, [0.0, 1.5, 0.0]).both(),
    ],
    &[field([14.0, -50.0, 93.0], 9.0, [0.0, 3.5, 0.0]).wide([9.0, 10.0, 30.0]).opposed().on(Lip::Upper)],
    // Lower lip dropped, both sides; then the left against the right.
    &[field([0.0, -61.0, 96.0], 12.0, [0.0, -5.0, 0.5]).wide([18.0, 11.0, 30.0]).on(Lip::Lower)],
    &[field([14.0, -61.0, 93.0], 9.0, [0.0, -3.5, 0.0]).wide([9.0, 10.0, 30.0]).opposed().on(Lip::Lower)],
    // Lips pressed together and in.
    &[
        field([0.0, -50.5, 97.0], 8.0, [0.0, -2.5, -2.0]).wide([20.0, 5.0, 30.0]).on(Lip::Upper),
        field([0.0, -64.0, 97.0], 8.0, [0.0, 3.0, -2.0]).wide([20.0, 6.0, 30.0]).on(Lip::Lower),
    ],
    // Mouth to the left; up.
    &[field([0.0, -58.0, 92.0], 24.0, [6.0, 0.0, 0.0]).wide([30.0, 18.0, 40.0])],
    &[field([0.0, -57.0, 92.0], 20.0, [0.0, 3.5, 0.0]).wide([32.0, 13.0, 40.0])],
    // Chin raised, pushing the lower lip.
    &[
        field([0.0, -86.0, 92.0], 15.0, [0.0, 4.0, 2.0]).wide([18.0, 14.0, 30.0]),
        field([0.0, -62.0, 96.0], 9.0, [0.0, 2.5, 2.0]).wide([16.0, 9.0, 30.0]).on(Lip::Lower),
    ],
    // Inner brows up; outer brows up, left and right; brows together and down.
    &[field([12.0, 36.0, 93.0], 12.0, [0.0, 6.0, 0.0]).wide([12.0, 13.0, 30.0]).both()],
    &[OUTER_BROW],
    &[OUTER_BROW.right()],
    &[field([15.0, 35.0, 92.0], 12.0, [-3.0, -5.0, 1.0]).wide([15.0, 11.0, 30.0]).both()],
    // Cheeks blown.
    &[field([40.0, -46.0, 70.0], 17.0, [5.0, 0.0, 6.0]).both()],
    // Lower lids up, left and right; upper lids up beyond rest.
    &[SQUINT],
    &[SQUINT.right()],
    &[field([31.0, 23.0, 80.0], 8.0, [0.0, 2.5, 0.0]).wide([14.0, 6.0, 25.0]).both()],
    // Nose wrinkled; nostrils wide.
    &[field([13.0, -14.0, 96.0], 10.0, [-0.5, 4.0, 1.0]).wide([11.0, 13.0, 25.0]).both()],
    &[field([15.0, -26.0, 95.0], 7.0, [2.0, 0.8, 0.0]).both()],
];

/// One eye's slit in the frontal plane, millimetres: x, upper y, lower y, from one corner to the other by increasing x.
pub struct EyeSlit {
    /// Rows of the slit.
    pub rows: Vec<[f64; 3]>,
    /// +1 the left eye, −1 the right one.
    pub side: f64,
}

impl EyeSlit {
    /// How far closing the lids fully moves a skin point, millimetres.
    pub fn closing_at(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        const STILL: [f64; 3] = [0.0; 3];
        let Some([_, upper, lower]) = self.edges_at(x) else { return STILL };
        if z < 50.0 || upper - lower < 1e-6 {
            return STILL;
        }
        // The upper lid does nearly all the way; it meets the lower one a little above where that rests.
        let meeting = lower + 0.10 * (upper - lower);
        let middle = 0.5 * (upper + lower);
        let drop = if y >= middle {
            (meeting - upper) * (1.0 - smoothstep(0.0, 15.0, y - upper).sqrt()).max(0.0)
        } else {
            (meeting - lower) * smoothstep(9.0, 0.0, lower - y)
        };
        [0.0, drop, self.lid_depth(x, y + drop) - self.lid_depth(x, y)]
    }

    /// Depth of the lids' surface over the eyeball.
    fn lid_depth(&self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.side * EYE_CENTRE[0], y - EYE_CENTRE[1]);
        let radius = EYE_RADIUS + 1.3;
        let reach = if self.side * dx > 0.0 { 16.0 } else { 17.2 };
        radius * (1.0 - (dx / reach).powi(2) - (dy / radius).powi(2)).max(0.12).sqrt()
    }

    fn edges_at(&self, x: f64) -> Option<[f64; 3]> {
        let after = self.rows.iter().position(|row| row[0] >= x)?;
        let (to, from) = (self.rows[after], self.rows[after.checked_sub(1)?]);
        let u = (x - from[0]) / (to[0] - from[0]);
        Some(std::array::from_fn(|k| from[k] + u * (to[k] - from[k])))
    }
}
