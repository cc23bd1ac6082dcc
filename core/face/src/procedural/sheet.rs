//! The skin as one grid wrapped around the head, slit open at the mouth and the eyes.
//!
//! Rows run from the crown to the neck, columns around the head starting in front and going to the subject's left.
//! Inside a slit a row has two vertices a column, the upper and the lower edge; at its corners one. Metres out,
//! millimetres within.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use super::features::{self, EYE_COLUMNS, EYE_Y, MOUTH_COLUMN, MOUTH_Y};
use super::profile::{level_of_front_height, smoothstep, surface};
use crate::model::Region;

/// Front heights of the rows, millimetres, down to the chin; the eye and mouth slits are rows of their own.
const FRONT_ROWS: [f64; 57] = [
    123.6, 119.0, 112.0, 102.0, 92.0, 82.0, 72.0, 63.0, 55.0, 48.0, 43.5, 40.5, 38.0, 35.0, 32.0, 29.0, 25.5, 22.5,
    20.0, 17.5, EYE_Y, 12.5, 10.0, 7.0, 3.0, -1.5, -6.0, -10.5, -14.5, -18.0, -21.0, -24.0, -26.5, -29.0, -31.0, -33.0,
    -35.0, -38.0, -41.5, -45.0, -47.5, -49.7, -51.7, -53.8, MOUTH_Y, -58.2, -60.8, -63.2, -65.6, -68.5, -72.0, -76.0,
    -80.5, -85.0, -90.0, -95.0, -100.0,
];
/// Rows under the chin and down the neck, as levels of the smooth head.
const NECK_LEVELS: [f64; 9] = [12.55, 13.0, 13.5, 14.0, 14.6, 15.3, 16.0, 17.0, 18.0];
/// The rows that outline the lips.
const UPPER_OUTLINE: f64 = -49.7;
const LOWER_OUTLINE: f64 = -65.6;
/// Columns of the front half to the left of the middle, millimetres at the reference half width.
const FRONT_COLUMNS: [f64; 21] = [
    3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 21.4, 24.8, 28.0, 33.5, 38.5, 42.0, 45.0, 48.5, 52.5, 57.5, 63.0, 68.5, 72.1,
    74.3, 75.0,
];
/// Columns of the back half, without its ends.
const BACK_COLUMNS: usize = 15;

/// A vertex of the sheet.
pub struct SheetVertex {
    /// Head space, metres.
    pub position: [f64; 3],
    /// What it is.
    pub region: Region,
    /// +1 above the mouth slit, −1 below it.
    pub side: f64,
}

/// The grid and its vertices.
pub struct Sheet {
    /// All vertices.
    pub vertices: Vec<SheetVertex>,
    /// Triangles, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// The slits, as (upper, lower) edge vertices from corner to corner by increasing x; corners are equal.
    pub mouth: Vec<[u32; 2]>,
    /// The left and the right eye's slit, likewise.
    pub eyes: [Vec<[u32; 2]>; 2],
    index: BTreeMap<(usize, usize, bool), u32>,
}

/// Column angles, from −π/2 through the front to π/2 and on around the back.
fn column_angles() -> Vec<f64> {
    let left = FRONT_COLUMNS.iter().map(|column| (column / 75.0).min(1.0).asin());
    let mut angles: Vec<f64> = left.clone().rev().map(|angle| -angle).collect();
    angles.push(0.0);
    angles.extend(left);
    angles.extend((1..=BACK_COLUMNS).map(|k| PI / 2.0 + PI * k as f64 / (BACK_COLUMNS + 1) as f64));
    angles
}

/// What a grid point is before it is placed.
#[derive(Clone, Copy)]
struct GridPoint {
    level: f64,
    /// Front height, millimetres; meaningless under the chin.
    height: f64,
    angle: f64,
    side_of_slit: f64,
    on_face: bool,
}

impl GridPoint {
    fn column_mm(&self) -> f64 {
        75.0 * self.angle.sin()
    }

    fn place(&self) -> SheetVertex {
        let front = self.angle.abs() <= PI / 2.0 + 1e-9;
        let opened = if self.on_face && front {
            features::opened_height(self.column_mm(), self.height, self.side_of_slit)
        } else {
            self.height
        };
        let (opened, angle, at_hairline) =
            if self.on_face { snapped_to_hairline(opened, self.angle) } else { (opened, self.angle, false) };
        let level = if self.on_face { level_of_front_height(opened) } else { self.level };
        let [mut x, mut y, mut z] = surface(level, angle);
        let mut region = if self.on_face { Region::Skin } else { Region::Neck };
        let midline = surface(level_of_front_height(y), 0.0)[2];
        if front && self.on_face && y > -106.0 {
            let face = smoothstep(0.0, 0.25, self.angle.cos());
            z += face * (features::featured_depth(x, y, z, midline) - z);
            if features::is_brow(self.column_mm(), self.height) {
                region = Region::Brow;
            }
            if features::is_lip(self.column_mm(), self.height) {
                region = Region::Lips;
            }
        }
        let wrapped = (angle + PI).rem_euclid(2.0 * PI) - PI;
        let (lift, is_scalp) = features::hair(y, wrapped);
        if is_scalp || at_hairline {
            region = Region::Scalp;
        } else if self.angle.cos() < -0.1 && y < -20.0 {
            region = Region::Neck;
        }
        let outward = [x, 0.7 * (y - 20.0).max(0.0), z + 10.0];
        let length = outward.iter().map(|c| c * c).sum::<f64>().sqrt().max(1.0);
        x += lift * outward[0] / length;
        y += lift * outward[1] / length;
        z += lift * outward[2] / length;
        let mouth_side = if self.on_face && (self.height - MOUTH_Y).abs() < 1e-9 {
            self.side_of_slit
        } else if self.on_face && self.height > MOUTH_Y {
            1.0
        } else {
            -1.0
        };
        SheetVertex { position: [x * 1e-3, y * 1e-3, z * 1e-3], region, side: mouth_side }
    }
}

/// Slides a grid point onto the hairline when it is near, so that the border of the hair is a line and not a stair.
/// Returns its front height and angle, and whether it moved.
fn snapped_to_hairline(height: f64, angle: f64) -> (f64, f64, bool) {
    let reach = 2.6;
    let (mut at, mut moved) = ([height, angle], false);
    for _ in 0..3 {
        let wrapped = (at[1] + PI).rem_euclid(2.0 * PI) - PI;
        // Heights turn with the jaw: judge by where the point really is.
        let y = surface(level_of_front_height(at[0]), at[1])[1];
        let (distance, [turn, rise]) = features::above_hairline(y, wrapped);
        if !moved && distance.abs() > reach {
            return (height, angle, false);
        }
        at = [at[0] - distance * rise, at[1] - distance * turn];
        moved = true;
    }
    (at[0], at[1], true)
}

impl Sheet {
    /// Builds the template.
    pub fn new() -> Self {
        let angles = column_angles();
        let mut sheet = Self {
            vertices: Vec::new(),
            triangles: Vec::new(),
            mouth: Vec::new(),
            eyes: [Vec::new(), Vec::new()],
            index: BTreeMap::new(),
        };
        for row in 0..Self::rows() {
            for (column, &angle) in angles.iter().enumerate() {
                let point = Self::grid_point(row, angle);
                sheet.push(point, (row, column, false));
                if slit_of(point).is_some_and(|slit| slit.interior) {
                    sheet.push(GridPoint { side_of_slit: -1.0, ..point }, (row, column, true));
                }
            }
        }
        sheet.stitch(angles.len());
        sheet.close_crown(angles.len());
        sheet.find_slits(&angles);
        sheet
    }

    /// Number of rows, crown to neck.
    pub fn rows() -> usize {
        FRONT_ROWS.len() + NECK_LEVELS.len()
    }

    /// The vertex of a row and column; `lower` picks the lower edge of a slit where there are two.
    pub fn vertex(&self, row: usize, column: usize, lower: bool) -> u32 {
        let upper = self.index.get(&(row, column, false)).copied().unwrap_or(0);
        if lower { self.index.get(&(row, column, true)).copied().unwrap_or(upper) } else { upper }
    }

    /// Where along the mouth slit (in its entries) a column lies, millimetres at the reference half width.
    pub fn mouth_index_of_column(&self, column_mm: f64) -> f64 {
        let half = self.mouth.len() / 2;
        let (sign, column) = (column_mm.signum(), column_mm.abs());
        let after = FRONT_COLUMNS.partition_point(|c| *c < column).min(half.saturating_sub(1));
        let from = if after == 0 { 0.0 } else { FRONT_COLUMNS[after - 1] };
        half as f64 + sign * (after as f64 + (column - from) / (FRONT_COLUMNS[after] - from))
    }

    /// The vertex of the lip's outline in the column of an entry of the mouth slit.
    pub fn lip_outline(&self, entry: usize, upper: bool) -> u32 {
        let column = FRONT_COLUMNS.len() + entry - self.mouth.len() / 2;
        let target = if upper { UPPER_OUTLINE } else { LOWER_OUTLINE };
        let row = FRONT_ROWS.partition_point(|height| *height > target + 1e-9);
        self.vertex(row, column, false)
    }

    fn grid_point(row: usize, angle: f64) -> GridPoint {
        match FRONT_ROWS.get(row) {
            Some(&height) => {
                GridPoint { level: level_of_front_height(height), height, angle, side_of_slit: 1.0, on_face: true }
                    .sided()
            }
            None => {
                let level = NECK_LEVELS[(row - FRONT_ROWS.len()).min(NECK_LEVELS.len() - 1)];
                GridPoint { level, height: -110.0, angle, side_of_slit: -1.0, on_face: false }
            }
        }
    }

    fn push(&mut self, point: GridPoint, key: (usize, usize, bool)) {
        self.index.insert(key, self.vertices.len() as u32);
        self.vertices.push(point.place());
    }

    fn stitch(&mut self, columns: usize) {
        for row in 0..Self::rows() - 1 {
            for column in 0..columns {
                let next = (column + 1) % columns;
                let [a, b] = [column, next].map(|c| self.vertex(row, c, true));
                let [c, d] = [column, next].map(|c| self.vertex(row + 1, c, false));
                // Diagonals mirror about the middle so that the face is symmetric.
                if column < FRONT_COLUMNS.len() || column >= columns - BACK_COLUMNS.div_ceil(2) {
                    self.triangles.extend([[a, c, d], [a, d, b]]);
                } else {
                    self.triangles.extend([[a, c, b], [b, c, d]]);
                }
            }
        }
    }

    fn close_crown(&mut self, columns: usize) {
        let crown = self.vertices.len() as u32;
        let ring: Vec<u32> = (0..columns).map(|column| self.vertex(0, column, false)).collect();
        let mut centre = [0.0; 3];
        for vertex in &ring {
            for (sum, coordinate) in centre.iter_mut().zip(self.vertices[*vertex as usize].position) {
                *sum += coordinate / columns as f64;
            }
        }
        centre[1] += 0.0015;
        self.vertices.push(SheetVertex { position: centre, region: Region::Scalp, side: 1.0 });
        for column in 0..columns {
            self.triangles.push([crown, ring[column], ring[(column + 1) % columns]]);
        }
    }

    fn find_slits(&mut self, angles: &[f64]) {
        for row in 0..FRONT_ROWS.len() {
            for (column, &angle) in angles.iter().enumerate() {
                if let Some(slit) = slit_of(Self::grid_point(row, angle)) {
                    let pair = [false, true].map(|lower| self.vertex(row, column, lower));
                    match slit.eye {
                        None => self.mouth.push(pair),
                        Some(eye) => self.eyes[eye].push(pair),
                    }
                }
            }
        }
    }
}

impl GridPoint {
    /// Rows below the middle of an eye open downward, those above upward; likewise at the mouth.
    fn sided(mut self) -> Self {
        let below_eye = self.height < EYE_Y && self.height > 0.5 * (EYE_Y + MOUTH_Y);
        if below_eye || self.height < MOUTH_Y {
            self.side_of_slit = -1.0;
        }
        self
    }
}

/// A slit that a grid point lies on.
struct Slit {
    /// `None` the mouth, else 0 the left and 1 the right eye.
    eye: Option<usize>,
    /// Not one of its corners.
    interior: bool,
}

fn slit_of(point: GridPoint) -> Option<Slit> {
    const NEAR: f64 = 1e-6;
    if point.angle.cos() <= 0.0 || !point.on_face {
        return None;
    }
    let column = point.column_mm();
    let (inner, outer, eye) = if (point.height - MOUTH_Y).abs() < NEAR {
        (-MOUTH_COLUMN, MOUTH_COLUMN, None)
    } else if (point.height - EYE_Y).abs() < NEAR {
        (EYE_COLUMNS[0], EYE_COLUMNS[1], Some(usize::from(column < 0.0)))
    } else {
        return None;
    };
    let along = if eye.is_some() { column.abs() } else { column };
    (along > inner - NEAR && along < outer + NEAR)
        .then_some(Slit { eye, interior: along > inner + NEAR && along < outer - NEAR })
}
