//! The skeleton of the built-in head and its skinning weights.
//!
//! Metres, head space. The jaw hinges at the ears; the lower lip and the chin follow it wholly, the corners of the mouth
//! in part, the upper lip not at all. The neck fades into the trunk.

use super::features::EYE_CENTRE;
use super::parts::{Mesh, Role};
use super::profile::smoothstep;
use crate::model::{JOINTS, joint};

/// Half width of the mouth, metres.
const MOUTH_HALF_WIDTH: f64 = 0.0255;
/// Height of the mouth line, metres.
const MOUTH_HEIGHT: f64 = -0.056;

/// Positions of root, neck, jaw, left and right eye.
pub fn joints() -> [[f64; 3]; JOINTS] {
    let [x, y, z] = EYE_CENTRE.map(|millimetres| millimetres * 1e-3);
    [[0.0, -0.165, -0.020], [0.0, -0.085, -0.018], [0.0, -0.006, 0.006], [x, y, z], [-x, y, z]]
}

/// Skinning weights of every vertex.
pub fn weights(mesh: &Mesh) -> Vec<[f64; JOINTS]> {
    let mut rows: Vec<[f64; JOINTS]> = Vec::with_capacity(mesh.positions.len());
    for (position, role) in mesh.positions.iter().zip(&mesh.roles) {
        let row = match *role {
            Role::Skin { side } => skin(*position, side),
            Role::Follows { vertex, share } => {
                // Deep in the mouth the roof stays with the skull and the floor goes with the jaw.
                let lip = rows[vertex as usize];
                let jaw_end = if lip[joint::JAW] > 0.5 { 1.0 } else { 0.0 };
                let jaw = share * lip[joint::JAW] + (1.0 - share) * jaw_end;
                let mut row = [0.0; JOINTS];
                row[joint::JAW] = jaw;
                row[joint::NECK] = 1.0 - jaw;
                row
            }
            Role::Rigid(part) => {
                let mut row = [0.0; JOINTS];
                row[[joint::NECK, joint::JAW, joint::EYE_LEFT, joint::EYE_RIGHT][part.min(3)]] = 1.0;
                row
            }
        };
        rows.push(row);
    }
    rows
}

fn skin(position: [f64; 3], side: f64) -> [f64; JOINTS] {
    let [_, y, z] = position;
    let front = smoothstep(-0.02, 0.03, z);
    let trunk = smoothstep(-0.100, -0.155, y) * (1.0 - 0.35 * front * smoothstep(-0.155, -0.120, y));
    let jaw = jaw_share(position, side) * (1.0 - trunk);
    let mut row = [0.0; JOINTS];
    row[joint::ROOT] = trunk;
    row[joint::JAW] = jaw;
    row[joint::NECK] = 1.0 - trunk - jaw;
    row
}

/// How much of a skin point goes with the jaw.
fn jaw_share([x, y, z]: [f64; 3], side: f64) -> f64 {
    let [_, hinge_y, hinge_z] = joints()[joint::JAW];
    // Angle about the hinge in the sagittal plane, from the line through the mouth; positive below it.
    let mouth_angle = (hinge_y - MOUTH_HEIGHT).atan2(0.094 - hinge_z);
    let angle = (hinge_y - y).atan2((z - hinge_z).max(1e-4)) - mouth_angle;
    let forward = smoothstep(-0.010, 0.045, z);
    let under_chin = smoothstep(0.010, 0.068, z + 1.0 * (y + 0.100).max(0.0));
    let along = (x.abs() / MOUTH_HALF_WIDTH).min(2.5);
    let cheek = smoothstep(-0.16, 0.30, angle);
    // Within the lips the slit is sharp: the lower lip goes fully with the jaw, the upper stays.
    let at_lips = smoothstep(1.45, 0.85, along);
    let corner = 0.42;
    let lips = if side < 0.0 {
        corner + (1.0 - corner) * smoothstep(1.0, 0.45, along).max(smoothstep(-0.060, -0.075, y))
    } else {
        corner * smoothstep(0.45, 1.0, along) * smoothstep(-0.030, -0.052, y)
    };
    (at_lips * lips + (1.0 - at_lips) * cheek) * forward * under_chin
}
