//! What is not skin of the sheet: eyeballs, lid rims, mouth interior, teeth, ears.
//!
//! Metres out. Parts that hang on a slit remember the slit's vertex, so that bases and weights are inherited from it.

use std::f64::consts::PI;

use super::features::{EYE_CENTRE, EYE_RADIUS};
use super::sheet::Sheet;
use crate::model::Region;

/// How a vertex gets its skinning weights and bases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Role {
    /// From its own place; `side` is +1 above the mouth line, −1 below.
    Skin {
        /// Which lip it belongs to.
        side: f64,
    },
    /// As another vertex, scaled.
    Follows {
        /// That vertex.
        vertex: u32,
        /// How much of its expression it shares.
        share: f64,
    },
    /// A rigid part: 0 skull, 1 jaw, 2 left eye, 3 right eye.
    Rigid(usize),
}

/// A mesh under construction.
#[derive(Default)]
pub struct Mesh {
    /// Positions, metres.
    pub positions: Vec<[f64; 3]>,
    /// Regions.
    pub regions: Vec<Region>,
    /// Roles.
    pub roles: Vec<Role>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    fn push(&mut self, position: [f64; 3], region: Region, role: Role) -> u32 {
        self.positions.push(position);
        self.regions.push(region);
        self.roles.push(role);
        self.positions.len() as u32 - 1
    }

    /// A strip of quads between two rows of vertices. Seen with `upper` above and x to the right it faces the viewer.
    fn strip(&mut self, upper: &[u32], lower: &[u32]) {
        for (a, b) in upper.windows(2).zip(lower.windows(2)) {
            self.triangles.extend([[a[0], b[0], b[1]], [a[0], b[1], a[1]]]);
        }
    }

    /// The skin with every part added.
    pub fn assembled(sheet: &Sheet) -> Self {
        let mut mesh = Self::default();
        for vertex in &sheet.vertices {
            mesh.push(vertex.position, vertex.region, Role::Skin { side: vertex.side });
        }
        mesh.triangles.clone_from(&sheet.triangles);
        mesh.add_lid_rims(sheet);
        mesh.add_mouth(sheet);
        mesh.add_teeth(sheet);
        for side in [1.0, -1.0] {
            mesh.add_eyeball(side);
            mesh.add_ear(side);
        }
        mesh
    }

    /// Gives the lids a thickness: a strip from each lid edge back to the eyeball.
    fn add_lid_rims(&mut self, sheet: &Sheet) {
        for (eye, slit) in sheet.eyes.iter().enumerate() {
            let [x, y, z] = EYE_CENTRE;
            let centre = [if eye == 0 { x } else { -x }, y, z].map(|millimetres| millimetres * 1e-3);
            for edge in 0..2 {
                let front: Vec<u32> = slit.iter().map(|pair| pair[edge]).collect();
                let back: Vec<u32> = front
                    .iter()
                    .map(|&vertex| {
                        let position = on_eyeball(self.positions[vertex as usize], centre);
                        self.push(position, Region::Skin, Role::Follows { vertex, share: 1.0 })
                    })
                    .collect();
                if edge == 0 {
                    self.strip(&front, &back);
                } else {
                    self.strip(&back, &front);
                }
            }
        }
    }

    /// A closed bag behind the lips: rows from the upper lip up and back, from the lower lip down and back, and a wall.
    fn add_mouth(&mut self, sheet: &Sheet) {
        // Height and depth of each row relative to the lip, and how much of the lip's motion it shares.
        const ROWS: [[f64; 3]; 4] =
            [[0.0008, -0.003, 1.0], [0.0035, -0.006, 0.85], [0.009, -0.014, 0.35], [0.010, -0.034, 0.0]];
        let mut last_rows: [Vec<u32>; 2] = [Vec::new(), Vec::new()];
        for (edge, last) in last_rows.iter_mut().enumerate() {
            let direction = if edge == 0 { 1.0 } else { -1.0 };
            let mut front: Vec<u32> = sheet.mouth.iter().map(|pair| pair[edge]).collect();
            let lips = front.clone();
            for [rise, depth, share] in ROWS {
                let row: Vec<u32> = lips
                    .iter()
                    .map(|&vertex| {
                        let [x, y, z] = self.positions[vertex as usize];
                        let towards_middle = (x / 0.0246).abs().min(1.0).powi(2);
                        let position = [
                            x * (1.0 + 3.0 * depth),
                            y + direction * rise * (1.0 - 0.8 * towards_middle),
                            z + depth * (1.0 - 0.3 * towards_middle),
                        ];
                        self.push(position, Region::Mouth, Role::Follows { vertex, share })
                    })
                    .collect();
                if edge == 0 {
                    self.strip(&front, &row);
                } else {
                    self.strip(&row, &front);
                }
                front = row;
            }
            *last = front;
        }
        self.strip(&last_rows[0].clone(), &last_rows[1].clone());
    }

    /// Two curved plates behind the lips, the upper one fixed to the skull, the lower one to the jaw.
    fn add_teeth(&mut self, sheet: &Sheet) {
        let Some(middle) = sheet.mouth.get(sheet.mouth.len() / 2) else { return };
        let [_, y, z] = self.positions[middle[0] as usize];
        for (rigid, heights) in [(0, [0.010, 0.004, -0.0012]), (1, [-0.0022, -0.006, -0.011])] {
            let rows: Vec<Vec<u32>> = heights
                .iter()
                .map(|height| {
                    (-8..=8)
                        .map(|k| {
                            let along = f64::from(k) / 8.0;
                            let recess = if rigid == 0 { 0.0075 } else { 0.0095 };
                            let position = [0.0225 * along, y + height, z - recess - 0.015 * along * along];
                            self.push(position, Region::Mouth, Role::Rigid(rigid))
                        })
                        .collect()
                })
                .collect();
            for pair in rows.windows(2) {
                self.strip(&pair[0], &pair[1]);
            }
        }
    }

    /// The front two thirds of a sphere, rings about the line of sight.
    fn add_eyeball(&mut self, side: f64) {
        const AROUND: usize = 20;
        const POLAR: [f64; 10] = [6.0, 13.0, 20.0, 26.0, 33.0, 41.0, 50.0, 61.0, 75.0, 95.0];
        let (region, role) =
            if side > 0.0 { (Region::EyeLeft, Role::Rigid(2)) } else { (Region::EyeRight, Role::Rigid(3)) };
        let at = |polar: f64, around: f64| {
            let (ring, depth) = (EYE_RADIUS * polar.sin(), EYE_RADIUS * polar.cos());
            [
                1e-3 * (side * EYE_CENTRE[0] + ring * around.cos()),
                1e-3 * (EYE_CENTRE[1] + ring * around.sin()),
                1e-3 * (EYE_CENTRE[2] + depth),
            ]
        };
        let pole = self.push(at(0.0, 0.0), region, role);
        let mut inner = vec![pole; AROUND];
        for polar in POLAR {
            let ring: Vec<u32> = (0..AROUND)
                .map(|k| self.push(at(polar.to_radians(), 2.0 * PI * k as f64 / AROUND as f64), region, role))
                .collect();
            for k in 0..AROUND {
                let next = (k + 1) % AROUND;
                if inner[k] != inner[next] {
                    self.triangles.push([inner[k], ring[next], inner[next]]);
                }
                self.triangles.push([inner[k], ring[k], ring[next]]);
            }
            inner = ring;
        }
    }

    /// A shell with a raised rim and a hollow, leaning back and away from the head.
    fn add_ear(&mut self, side: f64) {
        const AROUND: usize = 18;
        // Distance from the ear's middle (1 = outline), and how far it stands out, metres: hollow, fold, rim, back.
        const RINGS: [[f64; 2]; 6] =
            [[0.30, -0.003], [0.55, 0.001], [0.78, 0.0035], [0.94, 0.0055], [1.0, 0.002], [0.86, -0.010]];
        let place = |radius: f64, angle: f64, out: f64| {
            // Outline: an egg 62 mm high, 33 mm wide, wider above; angle 0 is the front edge, π/2 the top.
            let (sine, cosine) = angle.sin_cos();
            let along = radius * 0.031 * sine;
            let across = radius * 0.0165 * cosine * (1.0 + 0.22 * sine);
            let lean = 0.22;
            let (y, z) = (along * f64::cos(lean) - across * f64::sin(-lean), -(along * f64::sin(lean)) + across);
            let open = 0.0775 + out + (-across + 0.0165) * 0.36 + 0.05 * along;
            [side * open, -0.006 + y, -0.016 + z]
        };
        let centre = self.push(place(0.0, 0.0, -0.005), Region::Ear, Role::Skin { side: 1.0 });
        let mut inner = vec![centre; AROUND];
        for [radius, out] in RINGS {
            let ring: Vec<u32> = (0..AROUND)
                .map(|k| {
                    let angle = 2.0 * PI * k as f64 / AROUND as f64;
                    self.push(place(radius, angle, out), Region::Ear, Role::Skin { side: 1.0 })
                })
                .collect();
            for k in 0..AROUND {
                let next = (k + 1) % AROUND;
                let mut faces = vec![[inner[k], ring[k], ring[next]]];
                if inner[k] != inner[next] {
                    faces.push([inner[k], ring[next], inner[next]]);
                }
                for mut face in faces {
                    // The ring turns from front over top to back: seen from the left that is clockwise.
                    if side > 0.0 {
                        face.swap(1, 2);
                    }
                    self.triangles.push(face);
                }
            }
            inner = ring;
        }
    }
}

/// A point of a lid's edge moved back to just under the surface of the eyeball.
fn on_eyeball(edge: [f64; 3], centre: [f64; 3]) -> [f64; 3] {
    let radius = 0.96 * EYE_RADIUS * 1e-3;
    let (dx, dy) = (edge[0] - centre[0], edge[1] - centre[1]);
    let shrink = (0.97 * radius / dx.hypot(dy)).min(1.0);
    let across = shrink * dx.hypot(dy);
    [centre[0] + shrink * dx, centre[1] + shrink * dy, centre[2] + (radius * radius - across * across).sqrt() - 0.0005]
}
