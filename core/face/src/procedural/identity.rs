//! How heads differ: proportions of the whole, then of every feature.
//!
//! Millimetres per standard deviation, set from what anthropometry tables say of adults (a nose's length varies by about
//! 3 mm, a face's breadth by 5) and by eye.

use super::fields::{Field, Lip, field, sum};

/// A mode of identity.
pub enum Mode {
    /// Relative growth along x, y and z about head space's origin, per unit.
    Stretch([f64; 3]),
    /// Local fields.
    Local(&'static [Field]),
}

impl Mode {
    /// Displacement of a template point, millimetres.
    pub fn at(&self, point: [f64; 3], side: f64) -> [f64; 3] {
        match self {
            Mode::Stretch(growth) => std::array::from_fn(|axis| growth[axis] * point[axis]),
            Mode::Local(fields) => sum(fields, point, side),
        }
    }
}

/// The modes, the most global first.
pub const MODES: &[Mode] = &[
    Mode::Stretch([0.035, 0.0, 0.0]),
    Mode::Stretch([0.0, 0.035, 0.0]),
    Mode::Stretch([0.0, 0.0, 0.040]),
    // Skull.
    Mode::Local(&[field([0.0, 95.0, 40.0], 50.0, [0.0, 0.0, 4.0])]),
    Mode::Local(&[field([0.0, 120.0, 0.0], 60.0, [0.0, 5.0, 0.0])]),
    Mode::Local(&[field([0.0, 40.0, -100.0], 60.0, [0.0, 0.0, -5.0])]),
    Mode::Local(&[field([80.0, 50.0, -10.0], 45.0, [3.5, 0.0, 0.0]).both()]),
    Mode::Local(&[field([0.0, 60.0, 92.0], 26.0, [0.0, 0.0, 2.5])]),
    Mode::Local(&[field([55.0, 36.0, 62.0], 22.0, [2.5, 0.0, 1.0]).both()]),
    // Brows.
    Mode::Local(&[field([30.0, 36.0, 88.0], 17.0, [0.0, 2.5, 0.0]).wide([24.0, 13.0, 30.0]).both()]),
    Mode::Local(&[field([27.0, 34.0, 90.0], 14.0, [0.0, 0.0, 2.2]).wide([20.0, 10.0, 30.0]).both()]),
    Mode::Local(&[field([14.0, 35.0, 94.0], 12.0, [0.0, 2.2, 0.0]).both()]),
    Mode::Local(&[field([46.0, 36.0, 78.0], 14.0, [0.0, 2.2, 0.0]).both()]),
    Mode::Local(&[field([14.0, 35.0, 94.0], 12.0, [2.0, 0.0, 0.0]).both()]),
    // Eyes.
    Mode::Local(&[field([31.0, 15.0, 72.0], 18.0, [1.8, 0.0, 0.0]).wide([20.0, 18.0, 30.0]).both()]),
    Mode::Local(&[field([31.0, 15.0, 72.0], 18.0, [0.0, 1.8, 0.0]).wide([24.0, 18.0, 30.0]).both()]),
    Mode::Local(&[field([31.0, 15.0, 72.0], 20.0, [0.0, 0.0, 2.0]).wide([24.0, 16.0, 30.0]).both()]),
    Mode::Local(&[field([45.0, 15.0, 74.0], 8.0, [1.4, 0.0, 0.0]).both()]),
    Mode::Local(&[field([15.0, 15.0, 78.0], 7.0, [1.0, 0.0, 0.0]).both()]),
    Mode::Local(&[field([45.0, 15.0, 74.0], 9.0, [0.0, 1.4, 0.0]).both()]),
    Mode::Local(&[field([31.0, 22.0, 80.0], 9.0, [0.0, 0.9, 0.0]).wide([14.0, 5.5, 20.0]).both()]),
    Mode::Local(&[field([31.0, 9.0, 80.0], 9.0, [0.0, -0.8, 0.0]).wide([14.0, 6.0, 20.0]).both()]),
    // Nose.
    Mode::Local(&[field([0.0, -26.0, 104.0], 16.0, [0.0, -3.0, 0.0]).wide([22.0, 15.0, 30.0])]),
    Mode::Local(&[field([0.0, -22.0, 108.0], 13.0, [0.0, 0.0, 3.0]).wide([15.0, 13.0, 30.0])]),
    Mode::Local(&[field([14.0, -26.0, 96.0], 8.5, [1.8, 0.0, 0.0]).both()]),
    Mode::Local(&[field([0.0, 10.0, 92.0], 12.0, [0.0, 0.0, 2.6]).wide([10.0, 15.0, 30.0])]),
    Mode::Local(&[field([9.0, 6.0, 92.0], 8.0, [1.3, 0.0, 0.0]).wide([7.0, 16.0, 20.0]).both()]),
    Mode::Local(&[field([0.0, -6.0, 102.0], 10.0, [0.0, 0.0, 2.0])]),
    Mode::Local(&[field([0.0, -22.0, 112.0], 8.0, [0.0, 2.0, 0.0])]),
    Mode::Local(&[field([0.0, -34.0, 98.0], 8.0, [0.0, 1.6, 0.0])]),
    // Middle of the face.
    Mode::Local(&[field([0.0, -42.0, 92.0], 26.0, [0.0, 0.0, 2.8]).wide([34.0, 24.0, 40.0])]),
    Mode::Local(&[field([58.0, -4.0, 56.0], 22.0, [3.0, 0.0, 0.5]).both()]),
    Mode::Local(&[field([44.0, -8.0, 76.0], 16.0, [0.5, 0.0, 2.6]).both()]),
    Mode::Local(&[field([44.0, -36.0, 68.0], 18.0, [2.5, 0.0, 2.0]).both()]),
    // Mouth.
    Mode::Local(&[field([25.0, -57.0, 85.0], 11.0, [2.4, 0.0, 0.0]).both()]),
    Mode::Local(&[field([0.0, -56.0, 94.0], 20.0, [0.0, 2.2, 0.0]).wide([32.0, 15.0, 40.0])]),
    Mode::Local(&[field([0.0, -56.0, 94.0], 16.0, [0.0, 0.0, 2.0]).wide([24.0, 14.0, 40.0])]),
    Mode::Local(&[field([0.0, -50.0, 96.0], 6.0, [0.0, 1.4, 0.4]).wide([17.0, 4.5, 25.0]).on(Lip::Upper)]),
    Mode::Local(&[field([0.0, -65.0, 95.0], 6.0, [0.0, -1.6, 0.4]).wide([17.0, 5.5, 25.0]).on(Lip::Lower)]),
    Mode::Local(&[field([25.0, -57.0, 85.0], 9.0, [0.0, 1.5, 0.0]).both()]),
    Mode::Local(&[field([6.0, -49.5, 97.0], 4.0, [0.0, 0.9, 0.0]).wide([4.5, 4.0, 20.0]).both().on(Lip::Upper)]),
    // Chin and jaw.
    Mode::Local(&[field([0.0, -102.0, 84.0], 24.0, [0.0, -4.0, 0.0]).wide([42.0, 22.0, 50.0])]),
    Mode::Local(&[field([0.0, -92.0, 88.0], 17.0, [0.0, 0.0, 3.5]).wide([22.0, 20.0, 40.0])]),
    Mode::Local(&[field([20.0, -98.0, 80.0], 15.0, [2.8, 0.0, 0.0]).both()]),
    Mode::Local(&[field([0.0, -74.0, 90.0], 9.0, [0.0, 0.0, -1.6]).wide([18.0, 7.0, 30.0])]),
    Mode::Local(&[field([56.0, -68.0, 14.0], 28.0, [4.0, 0.0, 0.0]).both()]),
    Mode::Local(&[field([52.0, -76.0, 22.0], 26.0, [0.0, -4.0, 0.0]).both()]),
    Mode::Local(&[field([42.0, -82.0, 56.0], 20.0, [2.6, -1.0, 0.5]).both()]),
    // Neck and ears.
    Mode::Local(&[field([50.0, -140.0, -15.0], 40.0, [4.0, 0.0, 0.0]).wide([40.0, 45.0, 80.0]).both()]),
    Mode::Local(&[field([84.0, -6.0, -18.0], 20.0, [0.0, 3.0, 0.0]).wide([16.0, 40.0, 30.0]).both()]),
    Mode::Local(&[field([90.0, -6.0, -24.0], 20.0, [4.0, 0.0, 0.0]).wide([14.0, 36.0, 26.0]).both()]),
];
