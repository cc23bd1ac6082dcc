//! The built-in head: a person made of formulas, so that everything runs with nothing downloaded.
//!
//! Adult proportions in metres (head 0.23 high, 0.155 wide, pupils 0.062 apart), symmetric, about 4,800 vertices, finer
//! in the face. Not FLAME and not derived from any scan or licensed model: every number in `procedural/` was set by hand.

mod anchors;
mod expression;
mod features;
mod fields;
mod identity;
mod parts;
mod profile;
mod sheet;
#[cfg(test)]
mod tests;
mod weights;

use crate::model::{Basis, HeadModel, JOINTS};
use expression::EyeSlit;
use parts::{Mesh, Role};
use sheet::Sheet;

impl HeadModel {
    /// Builds the head named `procedural`. Always the same.
    pub fn procedural() -> HeadModel {
        let sheet = Sheet::new();
        let mesh = Mesh::assembled(&sheet);
        let joints = weights::joints();
        HeadModel {
            name: "procedural".into(),
            vertices: mesh.positions.iter().map(|p| p.map(|c| c as f32)).collect(),
            triangles: mesh.triangles.clone(),
            regions: mesh.regions.clone(),
            identity: basis(identity::MODES.len(), |mode| identity_mode(&mesh, &identity::MODES[mode])),
            expression: basis(expression::MODES.len(), |mode| expression_mode(&mesh, expression::MODES[mode])),
            eyelids: basis(2, |eye| eyelid_mode(&mesh, &eye_slit(&sheet, &mesh, eye))),
            joints: joints.iter().map(|p| p.map(|c| c as f32)).collect(),
            joint_identity: joint_identity(&joints),
            parents: [-1, 0, 1, 1, 1],
            weights: weights::weights(&mesh).iter().map(|row| row.map(|w| w as f32)).collect(),
            landmarks: anchors::anchors(&sheet, &mesh),
        }
    }
}

const STILL: [f64; 3] = [0.0; 3];

fn millimetres(point: [f64; 3]) -> [f64; 3] {
    point.map(|metres| metres * 1e3)
}

/// Gathers modes given in millimetres.
fn basis(count: usize, mode: impl Fn(usize) -> Vec<[f64; 3]>) -> Basis {
    let data = (0..count).flat_map(mode).flatten().map(|value| (value * 1e-3) as f32).collect();
    Basis { count, data }
}

fn identity_mode(mesh: &Mesh, mode: &identity::Mode) -> Vec<[f64; 3]> {
    let joints = weights::joints();
    // Eyeballs and teeth are rigid: they move as their centre does.
    let centres = [[0.0, -0.056, 0.088], [0.0, -0.056, 0.088], joints[3], joints[4]];
    let mut shifts: Vec<[f64; 3]> = Vec::with_capacity(mesh.positions.len());
    for (position, role) in mesh.positions.iter().zip(&mesh.roles) {
        shifts.push(match *role {
            Role::Skin { side } => mode.at(millimetres(*position), side),
            Role::Follows { vertex, .. } => shifts[vertex as usize],
            Role::Rigid(part) => mode.at(millimetres(centres[part.min(3)]), if part == 1 { -1.0 } else { 1.0 }),
        });
    }
    shifts
}

fn joint_identity(joints: &[[f64; 3]; JOINTS]) -> Vec<f32> {
    identity::MODES
        .iter()
        .flat_map(|mode| joints.iter().flat_map(move |joint| mode.at(millimetres(*joint), 1.0)))
        .map(|value| (value * 1e-3) as f32)
        .collect()
}

fn expression_mode(mesh: &Mesh, fields: &[fields::Field]) -> Vec<[f64; 3]> {
    let mut shifts: Vec<[f64; 3]> = Vec::with_capacity(mesh.positions.len());
    for (position, role) in mesh.positions.iter().zip(&mesh.roles) {
        shifts.push(match *role {
            Role::Skin { side } => fields::sum(fields, millimetres(*position), side),
            Role::Follows { vertex, share } => shifts[vertex as usize].map(|shift| shift * share),
            Role::Rigid(_) => STILL,
        });
    }
    shifts
}

fn eye_slit(sheet: &Sheet, mesh: &Mesh, eye: usize) -> EyeSlit {
    let rows = sheet.eyes[eye]
        .iter()
        .map(|[upper, lower]| {
            let [upper, lower] = [upper, lower].map(|vertex| millimetres(mesh.positions[*vertex as usize]));
            [upper[0], upper[1], lower[1]]
        })
        .collect();
    EyeSlit { rows, side: if eye == 0 { 1.0 } else { -1.0 } }
}

fn eyelid_mode(mesh: &Mesh, slit: &EyeSlit) -> Vec<[f64; 3]> {
    let mut shifts: Vec<[f64; 3]> = Vec::with_capacity(mesh.positions.len());
    for (position, role) in mesh.positions.iter().zip(&mesh.roles) {
        shifts.push(match *role {
            Role::Skin { .. } => slit.closing_at(millimetres(*position)),
            Role::Follows { vertex, .. } => shifts[vertex as usize],
            Role::Rigid(_) => STILL,
        });
    }
    shifts
}
