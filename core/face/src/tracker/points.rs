//! The head reduced to what the tracker sees: its landmark points, with their bases and jaw weights, in f64.
//!
//! The neck is held at rest: no landmark lies on the trunk, so a turn of the neck and one of the whole head look alike, and
//! what is fitted is their sum. A split by rule (half of the turn from the clip's mean, say) would move trunk and neck by
//! something that nobody saw, and is wrong where a whole body turns on a chair; so the sum is given as the head's own turn.

use glam::{DMat3, DVec3};

use crate::model::{HeadModel, joint};

/// Landmarks that outline the face: they slide over the skin as it turns, so they count little and are not scored.
pub const OVAL: [u32; 36] = [
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150,
    136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
];
/// Edges of the lids and of the lips: they carry blinks and speech.
const EDGES: [u32; 52] = [
    7, 163, 144, 145, 153, 154, 155, 173, 157, 158, 159, 160, 161, 246, 249, 390, 373, 374, 380, 381, 382, 398, 384,
    385, 386, 387, 388, 466, 78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308, 415, 310, 311, 312, 13, 82, 81, 80, 191,
    33, 133, 263, 362,
];
/// Upper and lower landmarks whose distance says how far lids and lips are apart.
const GAPS: [[u32; 2]; 12] = [
    [159, 145],
    [158, 153],
    [160, 144],
    [157, 154],
    [386, 374],
    [385, 380],
    [387, 373],
    [384, 381],
    [13, 14],
    [82, 87],
    [312, 317],
    [81, 178],
];

/// Bases and template of the landmark points.
#[derive(Clone)]
pub struct Points {
    /// MediaPipe indices, increasing.
    pub indices: Vec<u32>,
    /// Template positions.
    pub rest: Vec<DVec3>,
    /// `K × L`.
    pub identity: Vec<DVec3>,
    /// `E × L`.
    pub expression: Vec<DVec3>,
    /// `2 × L`.
    pub eyelids: Vec<DVec3>,
    /// How much of each point follows the jaw.
    pub jaw_weights: Vec<f64>,
    /// The jaw's hinge.
    pub jaw: DVec3,
    /// `K`: how identity moves the hinge.
    pub jaw_identity: Vec<DVec3>,
    /// How much each point counts.
    pub importance: Vec<f64>,
    /// Pairs of points (upper, lower) whose distance is compared too.
    pub gaps: Vec<[usize; 2]>,
}

/// The points of one person: identity applied.
#[derive(Clone)]
pub struct Shape {
    /// `L` rest positions.
    pub rest: Vec<DVec3>,
    /// The jaw's hinge.
    pub jaw: DVec3,
}

impl Points {
    /// Reads the points off a head.
    pub fn new(head: &HeadModel) -> Self {
        let gather = |field: &dyn Fn(usize) -> DVec3| -> Vec<DVec3> {
            head.landmarks
                .iter()
                .map(|anchor| {
                    let corners = head.triangles[anchor.triangle as usize];
                    (0..3).map(|k| field(corners[k] as usize) * f64::from(anchor.barycentric[k])).sum()
                })
                .collect()
        };
        let modes = |basis: &crate::model::Basis| -> Vec<DVec3> {
            (0..basis.count).flat_map(|mode| gather(&|vertex| vector(basis.mode(mode)[vertex]))).collect()
        };
        let indices: Vec<u32> = head.landmarks.iter().map(|anchor| anchor.index).collect();
        let position = |index: u32| indices.binary_search(&index).ok();
        Self {
            rest: gather(&|vertex| vector(head.vertices[vertex])),
            identity: modes(&head.identity),
            expression: modes(&head.expression),
            eyelids: modes(&head.eyelids),
            jaw_weights: gather(&|vertex| DVec3::splat(f64::from(head.weights[vertex][joint::JAW])))
                .iter()
                .map(|weight| weight.x)
                .collect(),
            jaw: vector(head.joints[joint::JAW]),
            jaw_identity: head
                .joint_identity
                .as_chunks::<3>()
                .0
                .chunks(crate::model::JOINTS)
                .map(|joints| vector(joints[joint::JAW]))
                .collect(),
            importance: indices.iter().map(|index| importance(*index)).collect(),
            gaps: GAPS.iter().filter_map(|[upper, lower]| Some([position(*upper)?, position(*lower)?])).collect(),
            indices,
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// Number of identity modes.
    pub fn identity_count(&self) -> usize {
        self.jaw_identity.len()
    }

    /// Number of expression modes.
    pub fn expression_count(&self) -> usize {
        self.expression.len().checked_div(self.len()).unwrap_or(0)
    }

    /// The points of one person.
    pub fn shape(&self, identity: &[f64]) -> Shape {
        let mut shape = Shape { rest: self.rest.clone(), jaw: self.jaw };
        for (mode, &coefficient) in identity.iter().enumerate() {
            for (point, delta) in shape.rest.iter_mut().zip(&self.identity[mode * self.len()..]) {
                *point += *delta * coefficient;
            }
            shape.jaw += self.jaw_identity[mode] * coefficient;
        }
        shape
    }
}

fn vector(values: [f32; 3]) -> DVec3 {
    DVec3::from_array(values.map(f64::from))
}

fn importance(index: u32) -> f64 {
    if OVAL.contains(&index) {
        0.05
    } else if EDGES.contains(&index) {
        1.6
    } else {
        1.0
    }
}

/// Rotation matrix of an axis-angle vector.
pub fn rotation(vector: DVec3) -> DMat3 {
    DMat3::from_quat(glam::DQuat::from_scaled_axis(vector))
}

/// The matrix of the cross product.
pub fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// Right Jacobian of the rotation group: `exp(v + d) ≈ exp(v)·exp(J(v)·d)`.
pub fn right_jacobian(v: DVec3) -> DMat3 {
    let angle_squared = v.length_squared();
    let cross = cross_matrix(v);
    let (a, b) = if angle_squared < 1e-8 {
        (0.5 - angle_squared / 24.0, 1.0 / 6.0 - angle_squared / 120.0)
    } else {
        let angle = angle_squared.sqrt();
        ((1.0 - angle.cos()) / angle_squared, (angle - angle.sin()) / (angle_squared * angle))
    };
    DMat3::IDENTITY - cross * a + cross * cross * b
}
