//! The built-in head: a person made of formulas, so that everything runs with nothing downloaded.
//!
//! Adult proportions in metres (head 0.23 high, 0.155 wide, pupils 0.062 apart), symmetric, about 4,500 vertices, finer
//! in the face. Not FLAME and not derived from any scan or licensed model: every number in `procedural/` was set by hand.

mod features;
mod parts;
mod profile;
mod sheet;
mod weights;

use crate::model::{Basis, HeadModel};

impl HeadModel {
    /// Builds the head named `procedural`. Always the same.
    pub fn procedural() -> HeadModel {
        let sheet = sheet::Sheet::new();
        let mesh = parts::Mesh::assembled(&sheet);
        let count = mesh.positions.len();
        let weights = weights::weights(&mesh);
        HeadModel {
            name: "procedural".into(),
            vertices: mesh.positions.iter().map(|p| p.map(|c| c as f32)).collect(),
            triangles: mesh.triangles.clone(),
            regions: mesh.regions.clone(),
            identity: Basis { count: 0, data: Vec::new() },
            expression: Basis { count: 0, data: Vec::new() },
            eyelids: Basis { count: 2, data: vec![0.0; 2 * count * 3] },
            joints: weights::joints().iter().map(|p| p.map(|c| c as f32)).collect(),
            joint_identity: Vec::new(),
            parents: [-1, 0, 1, 1, 1],
            weights: weights.iter().map(|row| row.map(|w| w as f32)).collect(),
            landmarks: Vec::new(),
        }
    }
}
