//! Linear blend skinning: pose parameters to joint transforms to world vertices, and vertex normals.
//!
//! Rotations are axis-angle vectors (radians). A joint turns about its own position in the shaped rest head; the root's
//! transform is `world_from_head` itself. Vertices are blended by the weighted sum of matrices.

use glam::{Mat4, Quat, Vec3};

use crate::model::{HeadModel, JOINTS};
use crate::track::FramePose;

impl HeadModel {
    /// Rest vertices displaced by expression and eyelids, before skinning. Head space, `V`.
    pub fn shaped(&self, pose: &FramePose) -> Vec<[f32; 3]> {
        let mut vertices = self.vertices.clone();
        self.expression.add_to(&pose.expression, &mut vertices);
        self.eyelids.add_to(&pose.eyelids, &mut vertices);
        vertices
    }

    /// World-from-rest transform of every joint, the global pose included. Bake the identity first
    /// ([`HeadModel::with_identity`]), so that the joints sit where they belong.
    pub fn joint_transforms(&self, pose: &FramePose) -> [Mat4; JOINTS] {
        let local = [[0.0; 3], pose.neck, pose.jaw, pose.eyes[0], pose.eyes[1]];
        let world_from_head = Mat4::from_rotation_translation(
            Quat::from_scaled_axis(Vec3::from_array(pose.rotation)),
            Vec3::from_array(pose.translation),
        );
        let mut transforms = [world_from_head; JOINTS];
        for joint in 1..JOINTS {
            let centre = Vec3::from_array(self.joints[joint]);
            let turn = Mat4::from_quat(Quat::from_scaled_axis(Vec3::from_array(local[joint])));
            let about_centre = Mat4::from_translation(centre) * turn * Mat4::from_translation(-centre);
            transforms[joint] = transforms[self.parents[joint].max(0) as usize] * about_centre;
        }
        transforms
    }

    /// World vertices, `V`, metres. Bake the identity first.
    pub fn pose(&self, pose: &FramePose) -> Vec<[f32; 3]> {
        self.skinned(&self.shaped(pose), &self.joint_transforms(pose))
    }

    /// Blends the joint transforms over given rest vertices (`V`).
    pub fn skinned(&self, rest: &[[f32; 3]], transforms: &[Mat4; JOINTS]) -> Vec<[f32; 3]> {
        rest.iter()
            .zip(&self.weights)
            .map(|(vertex, weights)| {
                let vertex = Vec3::from_array(*vertex);
                let blended: Vec3 = weights
                    .iter()
                    .zip(transforms)
                    .filter(|(weight, _)| **weight != 0.0)
                    .map(|(weight, transform)| transform.transform_point3(vertex) * *weight)
                    .sum();
                blended.to_array()
            })
            .collect()
    }
}

/// Area-weighted unit normals, `V`, outward for counter-clockwise triangles; `[0, 0, 1]` for a vertex without area.
pub fn vertex_normals(vertices: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut sums = vec![Vec3::ZERO; vertices.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| Vec3::from_array(vertices[vertex as usize]));
        let area_normal = (b - a).cross(c - a);
        for vertex in triangle {
            sums[*vertex as usize] += area_normal;
        }
    }
    sums.into_iter().map(|sum| sum.try_normalize().unwrap_or(Vec3::Z).to_array()).collect()
}
