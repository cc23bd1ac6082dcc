//! The compact file of an installed head: safetensors, with bases as 16-bit steps and expression shapes sparse.
//!
//! A mode's step is its largest displacement over 32,767: under a micrometre. Named shapes become our bases on loading:
//! blinks are the eyelids, `jawOpen`, gaze and tongue are left out (joints do those, or nothing sees them), the rest are
//! expressions in order of their names.

use heartian_artifact::{Artifact, ArtifactError, BundleReader};

use crate::model::{Basis, HeadModel, JOINTS, LandmarkAnchor, Region};

/// Schema of the file.
const FORM: &str = "heartian-head-1";
const STEPS: f32 = 32767.0;

/// A named shape: displaced vertices only, metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// As ARKit calls it.
    pub name: String,
    /// Vertex and displacement, by increasing vertex.
    pub deltas: Vec<(u32, [f32; 3])>,
}

/// A head as the file keeps it.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// The model's name.
    pub name: String,
    /// Head space, metres.
    pub vertices: Vec<[f32; 3]>,
    /// Counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// One a vertex.
    pub regions: Vec<Region>,
    /// One row a vertex.
    pub weights: Vec<[f32; JOINTS]>,
    /// Five.
    pub joints: Vec<[f32; 3]>,
    /// Unit-variance modes.
    pub identity: Basis,
    /// As [`HeadModel::joint_identity`].
    pub joint_identity: Vec<f32>,
    /// Expression shapes.
    pub shapes: Vec<Shape>,
    /// Anchors of the face mesh.
    pub landmarks: Vec<LandmarkAnchor>,
}

/// Values as whole steps (i16 in two bytes) and the size of one.
fn stepped(values: &[f32]) -> (Vec<u8>, f32) {
    let largest = values.iter().fold(0.0f32, |most, value| most.max(value.abs()));
    let step = if largest > 0.0 { largest / STEPS } else { 1.0 };
    (values.iter().flat_map(|value| ((value / step).round() as i16).to_le_bytes()).collect(), step)
}

fn unstepped(bytes: &[u8], step: f32) -> impl Iterator<Item = f32> {
    bytes.as_chunks::<2>().0.iter().map(move |b| f32::from(i16::from_le_bytes(*b)) * step)
}

impl Stored {
    /// The file's bytes.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ArtifactError> {
        let head = self.bare();
        let per_mode = self.vertices.len() * 3;
        let (mut steps, mut scales) = (Vec::new(), Vec::new());
        for mode in self.identity.data.chunks_exact(per_mode.max(1)) {
            let (bytes, step) = stepped(mode);
            steps.extend(bytes);
            scales.push(step);
        }
        let names: Vec<&str> = self.shapes.iter().map(|shape| shape.name.as_str()).collect();
        let counts: Vec<u32> = self.shapes.iter().map(|shape| shape.deltas.len() as u32).collect();
        let vertices: Vec<u32> = self.shapes.iter().flat_map(|shape| shape.deltas.iter().map(|(v, _)| *v)).collect();
        let (mut deltas, mut shape_scales) = (Vec::new(), Vec::new());
        for shape in &self.shapes {
            let values: Vec<f32> = shape.deltas.iter().flat_map(|(_, delta)| *delta).collect();
            let (bytes, step) = stepped(&values);
            deltas.extend(bytes);
            shape_scales.push(step);
        }
        let indices: Vec<u8> = vertices.iter().flat_map(|vertex| (*vertex as u16).to_le_bytes()).collect();
        head.to_bundle()?
            .tensor("identity.steps", &[scales.len(), per_mode * 2], &steps)?
            .tensor("identity.scales", &[scales.len()], &scales)?
            .tensor("identity.joints", &[scales.len(), JOINTS, 3], &self.joint_identity)?
            .tensor("shapes.counts", &[counts.len()], &counts)?
            .tensor("shapes.vertices", &[vertices.len(), 2], &indices)?
            .tensor("shapes.steps", &[vertices.len(), 6], &deltas)?
            .tensor("shapes.scales", &[shape_scales.len()], &shape_scales)?
            .meta("shapes.names", &names)?
            .meta("form", &FORM)?
            .to_bytes()
    }

    /// The head without bases.
    fn bare(&self) -> HeadModel {
        HeadModel {
            name: self.name.clone(),
            vertices: self.vertices.clone(),
            triangles: self.triangles.clone(),
            regions: self.regions.clone(),
            identity: Basis::default(),
            expression: Basis::default(),
            eyelids: Basis::default(),
            joints: self.joints.clone(),
            joint_identity: Vec::new(),
            parents: [-1, 0, 1, 1, 1],
            weights: self.weights.clone(),
            landmarks: self.landmarks.clone(),
        }
    }

    /// Reads the file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ArtifactError> {
        let invalid = |what: &str| ArtifactError::Invalid(format!("head file: {what}"));
        let reader = BundleReader::new(bytes)?;
        if reader.meta::<String>("form")? != FORM {
            return Err(invalid("it is of another version; run `heartian models install head`"));
        }
        let scales: Vec<f32> = reader.tensor("identity.scales")?.1;
        let steps = reader.tensor::<u8>("identity.steps")?.1;
        let joint_identity: Vec<f32> =
            reader.shaped("identity.joints", &[Some(scales.len()), Some(JOINTS), Some(3)])?;
        let names: Vec<String> = reader.meta("shapes.names")?;
        let counts: Vec<u32> = reader.shaped("shapes.counts", &[Some(names.len())])?;
        let shape_scales: Vec<f32> = reader.shaped("shapes.scales", &[Some(names.len())])?;
        let vertices = reader.tensor::<u8>("shapes.vertices")?.1;
        let deltas = reader.tensor::<u8>("shapes.steps")?.1;
        let head = HeadModel::from_bundle(reader)?;
        let count = head.vertices.len();
        if steps.len() != scales.len() * count * 6 {
            return Err(invalid("the identity steps do not fit the vertices"));
        }
        let data = scales.iter().zip(steps.chunks_exact(count * 6)).flat_map(|(s, b)| unstepped(b, *s)).collect();
        let vertices: Vec<u32> =
            vertices.as_chunks::<2>().0.iter().map(|b| u32::from(u16::from_le_bytes(*b))).collect();
        let total: u64 = counts.iter().map(|count| u64::from(*count)).sum();
        if total != vertices.len() as u64
            || deltas.len() != vertices.len() * 6
            || vertices.iter().any(|v| *v as usize >= count)
        {
            return Err(invalid("a shape does not fit the vertices"));
        }
        let mut from = 0;
        let mut shapes = Vec::new();
        for ((name, own), scale) in names.into_iter().zip(&counts).zip(&shape_scales) {
            let to = from + *own as usize;
            let values: Vec<f32> = unstepped(&deltas[from * 6..to * 6], *scale).collect();
            let deltas = vertices[from..to].iter().copied().zip(values.as_chunks::<3>().0.iter().copied()).collect();
            shapes.push(Shape { name, deltas });
            from = to;
        }
        Ok(Self {
            name: head.name,
            vertices: head.vertices,
            triangles: head.triangles,
            regions: head.regions,
            weights: head.weights,
            joints: head.joints,
            identity: Basis { count: scales.len(), data },
            joint_identity,
            shapes,
            landmarks: head.landmarks,
        })
    }

    /// The head with its bases, checked.
    pub fn into_head(self) -> Result<HeadModel, crate::FaceError> {
        let mut head = self.bare();
        let (rows, eyes) = (self.vertices.len(), [Region::EyeLeft, Region::EyeRight]);
        let dense = |shape: &Shape| {
            let mut mode = vec![[0.0f32; 3]; rows];
            for (vertex, delta) in &shape.deltas {
                // Eyeballs turn about their joints and no other way.
                if !eyes.contains(&self.regions[*vertex as usize]) {
                    mode[*vertex as usize] = *delta;
                }
            }
            mode.into_flattened()
        };
        for shape in &self.shapes {
            let basis = match shape.name.as_str() {
                "eyeBlinkLeft" | "eyeBlinkRight" => &mut head.eyelids,
                "jawOpen" | "tongueOut" => continue,
                name if name.starts_with("eyeLook") => continue,
                _ => &mut head.expression,
            };
            basis.data.extend(dense(shape));
            basis.count += 1;
        }
        head.identity = self.identity;
        head.joint_identity = self.joint_identity;
        head.validate()?;
        Ok(head)
    }
}
