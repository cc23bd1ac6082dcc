//! A head model as plain data: template, linear bases, skeleton, regions and landmark anchors.
//!
//! Always holds after [`HeadModel::validate`]: every basis has `count·V·3` values, triangles and anchors point at
//! existing vertices, skinning weights are non-negative and sum to 1. Head space, metres. The skeleton and the order of
//! the sum are FLAME's: vertices = LBS(template + identity + expression + eyelids), without pose correctives.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};
use serde::{Deserialize, Serialize};

use crate::FaceError;

/// Number of joints.
pub const JOINTS: usize = 5;

/// Joint numbers.
pub mod joint {
    /// The whole head; its frame is head space itself.
    pub const ROOT: usize = 0;
    /// Base of the skull.
    pub const NECK: usize = 1;
    /// The jaw's hinge, between the ears.
    pub const JAW: usize = 2;
    /// Centre of the subject's left eyeball.
    pub const EYE_LEFT: usize = 3;
    /// Centre of the subject's right eyeball.
    pub const EYE_RIGHT: usize = 4;
}

/// What a vertex is part of. Left and right are the subject's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Region {
    /// Facial skin, eyelids included.
    Skin = 0,
    /// The red of the lips.
    Lips = 1,
    /// Eyebrow hair.
    Brow = 2,
    /// Left eyeball.
    EyeLeft = 3,
    /// Right eyeball.
    EyeRight = 4,
    /// Hair-bearing scalp.
    Scalp = 5,
    /// Neck skin.
    Neck = 6,
    /// Teeth and the inside of the mouth.
    Mouth = 7,
    /// Outer ears.
    Ear = 8,
}

impl Region {
    /// All regions, in the order of their codes.
    pub const ALL: [Region; 9] = [
        Region::Skin,
        Region::Lips,
        Region::Brow,
        Region::EyeLeft,
        Region::EyeRight,
        Region::Scalp,
        Region::Neck,
        Region::Mouth,
        Region::Ear,
    ];

    /// The region of a code; `None` for an unknown one.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }
}

/// `count` modes over `V` vertices: `data[(mode·V + vertex)·3 + axis]`, metres per unit of the coefficient.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Basis {
    /// Number of modes.
    pub count: usize,
    /// `count × V × 3`.
    pub data: Vec<f32>,
}

impl Basis {
    /// One mode, `V×3`; empty for a mode that does not exist.
    pub fn mode(&self, mode: usize) -> &[[f32; 3]] {
        let values = self.data.len().checked_div(self.count).unwrap_or(0);
        self.data.get(mode * values..(mode + 1) * values).unwrap_or(&[]).as_chunks::<3>().0
    }

    /// Adds `Σ coefficient·mode` to `vertices`; coefficients beyond the basis are ignored, missing ones are 0.
    pub fn add_to(&self, coefficients: &[f32], vertices: &mut [[f32; 3]]) {
        for (mode, &coefficient) in coefficients.iter().enumerate().take(self.count) {
            if coefficient == 0.0 {
                continue;
            }
            for (vertex, delta) in vertices.iter_mut().zip(self.mode(mode)) {
                for axis in 0..3 {
                    vertex[axis] += coefficient * delta[axis];
                }
            }
        }
    }
}

/// Where a landmark of the 468-point MediaPipe face mesh sits on the model's surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LandmarkAnchor {
    /// MediaPipe index, 0–467 (468–477 are the irises).
    pub index: u32,
    /// Triangle it lies in.
    pub triangle: u32,
    /// Barycentric coordinates there.
    pub barycentric: [f32; 3],
}

/// A head with identity, expression and eyelid bases and a skeleton of five joints.
#[derive(Clone, Debug, PartialEq)]
pub struct HeadModel {
    /// `procedural`, `anny`, `flame2020`, …
    pub name: String,
    /// `V` template vertices, head space.
    pub vertices: Vec<[f32; 3]>,
    /// Vertex numbers, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// `V` regions.
    pub regions: Vec<Region>,
    /// `K` identity modes; coefficients ~ N(0, 1).
    pub identity: Basis,
    /// Expression modes; coefficients of order 1.
    pub expression: Basis,
    /// Two modes, the left and the right lid; coefficients in [0, 1], 1 = closed.
    pub eyelids: Basis,
    /// Joint positions of the template, head space.
    pub joints: Vec<[f32; 3]>,
    /// `K × 5 × 3`: how each identity mode moves the joints.
    pub joint_identity: Vec<f32>,
    /// Parent of each joint; −1 for the root.
    pub parents: [i8; JOINTS],
    /// `V` rows of skinning weights, each summing to 1.
    pub weights: Vec<[f32; JOINTS]>,
    /// The landmarks this model knows, in increasing order of their index.
    pub landmarks: Vec<LandmarkAnchor>,
}

impl HeadModel {
    /// The model with an identity baked into template and joints; the identity basis of the result is empty.
    /// Coefficients beyond the basis are ignored, missing ones are 0.
    pub fn with_identity(&self, identity: &[f32]) -> HeadModel {
        let mut head = HeadModel { identity: Basis::default(), joint_identity: Vec::new(), ..self.clone() };
        self.identity.add_to(identity, &mut head.vertices);
        for (mode, coefficient) in identity.iter().enumerate().take(self.identity.count) {
            let deltas = &self.joint_identity[mode * JOINTS * 3..(mode + 1) * JOINTS * 3];
            for (position, delta) in head.joints.as_flattened_mut().iter_mut().zip(deltas) {
                *position += coefficient * delta;
            }
        }
        head
    }

    /// Position of a landmark on given vertices (of any posing of this model).
    pub fn landmark_position(&self, anchor: &LandmarkAnchor, vertices: &[[f32; 3]]) -> [f32; 3] {
        let corners = self.triangles[anchor.triangle as usize].map(|vertex| vertices[vertex as usize]);
        std::array::from_fn(|axis| (0..3).map(|corner| anchor.barycentric[corner] * corners[corner][axis]).sum())
    }

    /// Heights between which what a matte keeps of the neck fades out, lower first, head space: the mesh's lowest
    /// centimetres, so that a picture asks nothing of a head that ends there.
    pub fn neck_fade(&self) -> [f32; 2] {
        let lowest = self.vertices.iter().map(|vertex| vertex[1]).fold(f32::MAX, f32::min);
        [lowest + 0.008, lowest + 0.034]
    }

    /// Checks that the parts fit together.
    ///
    /// # Errors
    /// Names the first part that contradicts another.
    pub fn validate(&self) -> Result<(), FaceError> {
        let count = self.vertices.len();
        let fail = |reason: String| Err(FaceError::Head { name: self.name.clone(), reason });
        if count == 0 || self.triangles.is_empty() {
            return fail("it has no surface".into());
        }
        for (what, found) in [("regions", self.regions.len()), ("skinning weights", self.weights.len())] {
            if found != count {
                return fail(format!("{found} {what} for {count} vertices"));
            }
        }
        for (what, basis) in [("identity", &self.identity), ("expression", &self.expression), ("eyelid", &self.eyelids)]
        {
            if basis.data.len() != basis.count * count * 3 {
                return fail(format!(
                    "the {what} basis holds {} values, not {}×{count}×3",
                    basis.data.len(),
                    basis.count
                ));
            }
            if basis.data.iter().any(|value| !value.is_finite()) {
                return fail(format!("the {what} basis holds a value that is not finite"));
            }
        }
        if self.joints.len() != JOINTS || self.joint_identity.len() != self.identity.count * JOINTS * 3 {
            return fail("the joints do not match the skeleton of five or the identity basis".into());
        }
        if (0..JOINTS).any(|j| self.parents[j] >= j as i8 || (j > 0 && self.parents[j] < 0)) {
            return fail("a joint's parent does not come before it".into());
        }
        if self.vertices.as_flattened().iter().chain(self.joints.as_flattened()).any(|value| !value.is_finite()) {
            return fail("a vertex or joint position is not finite".into());
        }
        if self.triangles.as_flattened().iter().any(|vertex| *vertex as usize >= count) {
            return fail("a triangle points at a vertex that does not exist".into());
        }
        if let Some(row) = self.weights.iter().position(|w| {
            w.iter().any(|value| value.is_nan() || *value < 0.0) || (w.iter().sum::<f32>() - 1.0).abs() > 1e-3
        }) {
            return fail(format!("the skinning weights of vertex {row} are negative or do not sum to 1"));
        }
        if self.landmarks.iter().any(|a| a.triangle as usize >= self.triangles.len()) {
            return fail("a landmark points at a triangle that does not exist".into());
        }
        Ok(())
    }

    /// Adds this model to a bundle, every name prefixed by `head.`.
    pub(crate) fn add_to_bundle<'a>(&'a self, bundle: Bundle<'a>) -> Result<Bundle<'a>, ArtifactError> {
        let count = self.vertices.len();
        let codes: Vec<u8> = self.regions.iter().map(|region| *region as u8).collect();
        bundle
            .tensor("head.vertices", &[count, 3], self.vertices.as_flattened())?
            .tensor("head.triangles", &[self.triangles.len(), 3], self.triangles.as_flattened())?
            .tensor("head.identity", &[self.identity.count, count, 3], &self.identity.data)?
            .tensor("head.expression", &[self.expression.count, count, 3], &self.expression.data)?
            .tensor("head.eyelids", &[self.eyelids.count, count, 3], &self.eyelids.data)?
            .tensor("head.joints", &[self.joints.len(), 3], self.joints.as_flattened())?
            .tensor("head.joint_identity", &[self.identity.count, JOINTS, 3], &self.joint_identity)?
            .tensor("head.weights", &[count, JOINTS], self.weights.as_flattened())?
            .meta("head.regions", &codes)?
            .meta("head.parents", &self.parents)?
            .meta("head.landmarks", &self.landmarks)?
            .meta("head.name", &self.name)
    }

    /// Reads what [`HeadModel::add_to_bundle`] wrote.
    pub(crate) fn from_reader(reader: &BundleReader<'_>) -> Result<Self, ArtifactError> {
        let invalid = |what: &str| ArtifactError::Invalid(format!("head model: {what}"));
        let codes: Vec<u8> = reader.meta("head.regions")?;
        let regions: Option<Vec<Region>> = codes.into_iter().map(Region::from_code).collect();
        let rows = |name: &str| -> Result<Vec<[f32; 3]>, ArtifactError> {
            Ok(reader.shaped::<f32>(name, &[None, Some(3)])?.as_chunks::<3>().0.to_vec())
        };
        let basis = |name: &str| -> Result<Basis, ArtifactError> {
            let (shape, data) = reader.tensor::<f32>(name)?;
            Ok(Basis { count: shape.first().copied().unwrap_or(0), data })
        };
        let head = HeadModel {
            name: reader.meta("head.name")?,
            vertices: rows("head.vertices")?,
            triangles: reader.shaped::<u32>("head.triangles", &[None, Some(3)])?.as_chunks::<3>().0.to_vec(),
            regions: regions.ok_or_else(|| invalid("unknown region code"))?,
            identity: basis("head.identity")?,
            expression: basis("head.expression")?,
            eyelids: basis("head.eyelids")?,
            joints: rows("head.joints")?,
            joint_identity: reader.tensor("head.joint_identity")?.1,
            parents: reader.meta("head.parents")?,
            weights: reader.shaped::<f32>("head.weights", &[None, Some(JOINTS)])?.as_chunks::<JOINTS>().0.to_vec(),
            landmarks: reader.meta("head.landmarks")?,
        };
        head.validate().map_err(|error| ArtifactError::Invalid(error.to_string()))?;
        Ok(head)
    }
}

impl Artifact for HeadModel {
    const TYPE: ArtifactType = ArtifactType { name: "head", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        self.add_to_bundle(Bundle::new())
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Self::from_reader(&reader)
    }
}
