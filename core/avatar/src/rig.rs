//! Joint transforms of a posed head and their exact derivatives, in f64.
//!
//! The tree is FLAME's: root → neck → {jaw, left eye, right eye}. A pose is 18 numbers, all axis–angle in radians but
//! the translation in metres: rotation and translation of world-from-head, neck, jaw, left eye, right eye. The rest pose
//! is the identity, so every transform maps canonical head space (metres) to the world.

use glam::{DMat3, DMat4, DVec3};

/// Joints of the rig: root, neck, jaw, left eye, right eye.
pub const JOINTS: usize = 5;
/// Numbers in a pose.
pub const POSE_SIZE: usize = 18;
/// One frame's pose: rotation, translation, neck, jaw, left eye, right eye; three numbers each.
pub type Pose = [f64; POSE_SIZE];

/// Where the joints rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// Rest positions in canonical head space, metres. The root's is not used: the head turns about the origin.
    pub joints: [[f64; 3]; JOINTS],
}

impl Rig {
    /// World-from-canonical transform of each joint.
    pub fn transforms(&self, pose: &Pose) -> [DMat4; JOINTS] {
        let root = DMat4::from_translation(part(pose, 1)) * DMat4::from_mat3(rotation(part(pose, 0)));
        let neck = root * self.turned(1, pose, 2);
        let below = |joint, slot| neck * self.turned(joint, pose, slot);
        [root, neck, below(2, 3), below(3, 4), below(4, 5)]
    }

    /// Pulls gradients of the joint transforms (upper three rows count) back to the pose.
    pub fn backward(&self, pose: &Pose, gradients: &[DMat4; JOINTS]) -> Pose {
        let root = DMat4::from_translation(part(pose, 1)) * DMat4::from_mat3(rotation(part(pose, 0)));
        let neck_local = self.turned(1, pose, 2);
        let locals = [self.turned(2, pose, 3), self.turned(3, pose, 4), self.turned(4, pose, 5)];
        let mut out = [0.0; POSE_SIZE];
        for (index, out) in out.iter_mut().enumerate() {
            let (slot, axis) = (index / 3, index % 3);
            let tangent = match slot {
                0 => linear_only(rotation_derivative(part(pose, 0), axis), DVec3::ZERO),
                1 => linear_only(DMat3::ZERO, DVec3::AXES[axis]),
                _ => self.turned_derivative(slot - 1, pose, slot, axis),
            };
            *out = match slot {
                0 | 1 => {
                    let neck = tangent * neck_local;
                    dot(&gradients[0], &tangent)
                        + dot(&gradients[1], &neck)
                        + (0..3).map(|i| dot(&gradients[2 + i], &(neck * locals[i]))).sum::<f64>()
                }
                2 => {
                    let neck = root * tangent;
                    dot(&gradients[1], &neck) + (0..3).map(|i| dot(&gradients[2 + i], &(neck * locals[i]))).sum::<f64>()
                }
                _ => dot(&gradients[slot - 1], &(root * neck_local * tangent)),
            };
        }
        out
    }

    /// Rotation by pose slot `slot` about the rest position of `joint`.
    fn turned(&self, joint: usize, pose: &Pose, slot: usize) -> DMat4 {
        let turn = rotation(part(pose, slot));
        let centre = DVec3::from_array(self.joints[joint]);
        DMat4::from_translation(centre - turn * centre) * DMat4::from_mat3(turn)
    }

    fn turned_derivative(&self, joint: usize, pose: &Pose, slot: usize, axis: usize) -> DMat4 {
        let turn = rotation_derivative(part(pose, slot), axis);
        linear_only(turn, -(turn * DVec3::from_array(self.joints[joint])))
    }
}

fn part(pose: &Pose, slot: usize) -> DVec3 {
    DVec3::new(pose[3 * slot], pose[3 * slot + 1], pose[3 * slot + 2])
}

/// A tangent of an affine transform: its last row is zero.
fn linear_only(linear: DMat3, offset: DVec3) -> DMat4 {
    DMat4::from_cols(
        linear.x_axis.extend(0.0),
        linear.y_axis.extend(0.0),
        linear.z_axis.extend(0.0),
        offset.extend(0.0),
    )
}

fn dot(a: &DMat4, b: &DMat4) -> f64 {
    (0..4).map(|column| a.col(column).truncate().dot(b.col(column).truncate())).sum()
}

fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// Coefficients of Rodrigues' formula, `sin θ/θ` and `(1 − cos θ)/θ²`, and their derivatives with respect to θ².
fn rodrigues(squared: f64) -> [f64; 4] {
    if squared < 1e-6 {
        // Taylor: the next terms are below 1e-16 of the value.
        return [
            1.0 - squared / 6.0 + squared * squared / 120.0,
            0.5 - squared / 24.0 + squared * squared / 720.0,
            -1.0 / 6.0 + squared / 60.0,
            -1.0 / 24.0 + squared / 360.0,
        ];
    }
    let angle = squared.sqrt();
    let (sine, cosine) = angle.sin_cos();
    let one_minus_cosine = 2.0 * (0.5 * angle).sin().powi(2);
    [
        sine / angle,
        one_minus_cosine / squared,
        (angle * cosine - sine) / (2.0 * squared * angle),
        (angle * sine - 2.0 * one_minus_cosine) / (2.0 * squared * squared),
    ]
}

/// Rotation matrix of an axis–angle vector (Rodrigues), exact near zero.
pub fn rotation(vector: DVec3) -> DMat3 {
    let [a, b, ..] = rodrigues(vector.length_squared());
    let k = cross_matrix(vector);
    DMat3::IDENTITY + k * a + k * k * b
}

/// Derivative of [`rotation`] with respect to one component of the vector.
pub fn rotation_derivative(vector: DVec3, axis: usize) -> DMat3 {
    let [a, b, a_slope, b_slope] = rodrigues(vector.length_squared());
    let (k, e) = (cross_matrix(vector), cross_matrix(DVec3::AXES[axis]));
    let twice = 2.0 * vector[axis];
    k * (a_slope * twice) + k * k * (b_slope * twice) + e * a + (e * k + k * e) * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pose_gradients_match_finite_differences() {
        let rig = Rig {
            joints: [[0.0; 3], [0.01, -0.08, -0.03], [0.0, -0.02, 0.01], [0.03, 0.03, 0.05], [-0.03, 0.03, 0.05]],
        };
        let weight = |j: usize| {
            DMat4::from_cols_array(&std::array::from_fn(|i| {
                if i % 4 == 3 { 0.0 } else { ((i * 7 + j * 13) % 11) as f64 - 5.0 }
            }))
        };
        let weights: [DMat4; JOINTS] = std::array::from_fn(weight);
        let loss = |pose: &Pose| -> f64 { rig.transforms(pose).iter().zip(&weights).map(|(a, w)| dot(a, w)).sum() };
        let near_zero: Pose = std::array::from_fn(|i| 1e-5 * (i as f64 - 8.0));
        for pose in [[0.0; POSE_SIZE], near_zero, std::array::from_fn(|i| 0.37 * ((i * 5 % 7) as f64 - 3.0))] {
            let gradient = rig.backward(&pose, &weights);
            for (i, exact) in gradient.iter().enumerate() {
                let shifted = |h: f64| {
                    let mut pose = pose;
                    pose[i] += h;
                    loss(&pose)
                };
                let numeric = (shifted(1e-5) - shifted(-1e-5)) / 2e-5;
                assert!((numeric - exact).abs() <= 1e-6 * exact.abs().max(1.0), "{i}: {numeric} {exact}");
            }
        }
    }

    #[test]
    fn rotations_are_rotations() {
        for vector in [DVec3::ZERO, DVec3::new(1e-9, 0.0, 0.0), DVec3::new(0.3, -2.0, 1.0), DVec3::new(0.0, 3.15, 0.0)]
        {
            let turn = rotation(vector);
            let error = turn * turn.transpose() - DMat3::IDENTITY;
            assert!(error.to_cols_array().iter().all(|e| e.abs() < 1e-12), "{vector}");
            assert!((turn.determinant() - 1.0).abs() < 1e-12);
            assert!((turn * vector - vector).length() < 1e-12);
        }
    }
}
