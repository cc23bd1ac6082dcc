//! Smooth displacement fields, the bricks of the bases.
//!
//! A field is a Gaussian bump of displacement in space: millimetres, head axes, per unit of its coefficient. It may be
//! mirrored in x (the shift's x mirrors too), and it may act on one lip only, with the mouth slit as a sharp border.

use super::features::{MOUTH_COLUMN, MOUTH_Y};
use super::profile::smoothstep;

/// What of the mouth a field moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lip {
    /// Both sides of the slit alike.
    Both,
    /// Only what lies above the mouth line.
    Upper,
    /// Only what lies below it.
    Lower,
}

/// Where in x a field acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mirror {
    /// Only where its centre is.
    No,
    /// Also at the mirrored place, the shift mirrored.
    Yes,
    /// Also at the mirrored place, the shift mirrored and negated.
    Anti,
}

/// One bump.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    centre: [f64; 3],
    width: [f64; 3],
    shift: [f64; 3],
    mirror: Mirror,
    lip: Lip,
}

/// A field at `centre`, one width in every direction, of `shift` per unit.
pub const fn field(centre: [f64; 3], width: f64, shift: [f64; 3]) -> Field {
    Field { centre, width: [width; 3], shift, mirror: Mirror::No, lip: Lip::Both }
}

impl Field {
    /// With a width per axis.
    pub const fn wide(mut self, width: [f64; 3]) -> Self {
        self.width = width;
        self
    }

    /// Mirrored about the middle.
    pub const fn both(mut self) -> Self {
        self.mirror = Mirror::Yes;
        self
    }

    /// The opposite on the other side.
    pub const fn opposed(mut self) -> Self {
        self.mirror = Mirror::Anti;
        self
    }

    /// On the subject's right instead of the left.
    pub const fn right(mut self) -> Self {
        self.centre[0] = -self.centre[0];
        self.shift[0] = -self.shift[0];
        self
    }

    /// On one lip only.
    pub const fn on(mut self, lip: Lip) -> Self {
        self.lip = lip;
        self
    }

    /// Displacement at a point, millimetres; `side` is +1 above the mouth slit, −1 below.
    pub fn at(&self, point: [f64; 3], side: f64) -> [f64; 3] {
        let upper = above_mouth(point, side);
        let share = match self.lip {
            Lip::Both => 1.0,
            Lip::Upper => upper,
            Lip::Lower => 1.0 - upper,
        };
        let [sx, sy, sz] = self.shift;
        let here = share * self.weight(point);
        let mut sum = [here * sx, here * sy, here * sz];
        if self.mirror != Mirror::No {
            let sign = if self.mirror == Mirror::Yes { 1.0 } else { -1.0 };
            let there = sign * share * self.weight([-point[0], point[1], point[2]]);
            sum = [sum[0] - there * sx, sum[1] + there * sy, sum[2] + there * sz];
        }
        sum
    }

    fn weight(&self, point: [f64; 3]) -> f64 {
        let squared: f64 = (0..3).map(|k| ((point[k] - self.centre[k]) / self.width[k]).powi(2)).sum();
        // Compact: exactly zero from three widths on.
        (-squared).exp() * smoothstep(9.0, 6.0, squared)
    }
}

/// 1 above the mouth line, 0 below; sharp within the slit, soft beyond its corners.
fn above_mouth([x, y, _]: [f64; 3], side: f64) -> f64 {
    let within = smoothstep(1.0, 0.75, x.abs() / (0.85 * MOUTH_COLUMN));
    let hard = if side > 0.0 { 1.0 } else { 0.0 };
    within * hard + (1.0 - within) * smoothstep(-9.0, 7.0, y - MOUTH_Y)
}

/// The sum of several fields.
pub fn sum(fields: &[Field], point: [f64; 3], side: f64) -> [f64; 3] {
    let mut total = [0.0; 3];
    for field in fields {
        let shift = field.at(point, side);
        for axis in 0..3 {
            total[axis] += shift[axis];
        }
    }
    total
}
