//! The user's FLAME file, as published: a pickle of Python 2 with chumpy and scipy objects, or an `.npz`.
//!
//! Arrays are found in the replayed pickle by their names; only the names of [`allowed`] may occur and nothing is run.
//! Pose correctives are not used. Head space is the file's own, moved so that the eyes sit where ours do; identity
//! coefficients are the file's (unit variance), cut to the first [`MOST_IDENTITY`] and [`MOST_EXPRESSION`].

use std::io::Cursor;

use heartian_foreign::npy::{self, Content, Npz};
use heartian_foreign::{Array, ForeignError, Id, Object, Pickle, numpy};

use super::{align, lids, parts};
use crate::HeadModel;
use crate::model::{Basis, JOINTS, LandmarkAnchor, Region, joint};

/// Most values of one array: FLAME's largest, the shapes, has 6 million.
const MOST_VALUES: usize = 1 << 25;
/// Modes used of each kind.
const MOST_IDENTITY: usize = 100;
const MOST_EXPRESSION: usize = 50;
/// Where the middle between the eyeballs sits in head space, metres.
const EYES: [f64; 3] = [0.0, 0.015, 0.0675];

/// Names that may occur in a model's pickle.
fn allowed(module: &str, name: &str) -> bool {
    let scipy = matches!(module, "scipy.sparse.csc" | "scipy.sparse._csc" | "scipy.sparse.csr" | "scipy.sparse._csr");
    numpy::is_numpy(module, name)
        || (scipy && matches!(name, "csc_matrix" | "csr_matrix"))
        || (module, name) == ("chumpy.ch", "Ch")
        || (matches!(module, "copy_reg" | "copyreg") && name == "_reconstructor")
        || (matches!(module, "__builtin__" | "builtins") && matches!(name, "object" | "set" | "frozenset"))
        || (module, name) == ("collections", "OrderedDict")
}

fn said(error: &ForeignError) -> String {
    error.what().to_owned()
}

/// A model file's arrays, unchecked.
pub struct Raw {
    template: Array,
    triangles: Array,
    shapes: Array,
    regressor: Array,
    weights: Array,
    parents: Array,
}

impl Raw {
    /// Reads a `.pkl` or `.npz`, told apart by content.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        if bytes.starts_with(b"PK\x03\x04") {
            let mut npz = Npz::open(Cursor::new(bytes)).map_err(|error| said(&error))?;
            return Self::gather(|name| npz.array(name, MOST_VALUES).map_err(|error| said(&error)));
        }
        if bytes.first() != Some(&0x80) {
            return Err("it is neither a pickle nor an .npz".into());
        }
        let pickle = Pickle::read(bytes, &allowed).map_err(|error| error.to_string())?;
        if pickle.entries(pickle.top()).is_none() {
            return Err("its pickle holds no dictionary of arrays".into());
        }
        Self::gather(|name| match pickle.entry(pickle.top(), name) {
            Some(id) => array(&pickle, id, 0).map_err(|reason| format!("`{name}`: {reason}")),
            None => Ok(None),
        })
    }

    fn gather(mut find: impl FnMut(&str) -> Result<Option<Array>, String>) -> Result<Self, String> {
        let mut need = |name: &str| find(name)?.ok_or_else(|| format!("it holds no array `{name}`"));
        Ok(Self {
            template: need("v_template")?,
            triangles: need("f")?,
            shapes: need("shapedirs")?,
            regressor: need("J_regressor")?,
            weights: need("weights")?,
            parents: need("kintree_table")?,
        })
    }
}

/// An array under any of the three coats it comes in: numpy's own, chumpy's (under `x`) and scipy's sparse columns.
fn array(pickle: &Pickle<'_>, id: Id, depth: usize) -> Result<Option<Array>, String> {
    if let Some(array) = numpy::array(pickle, id, MOST_VALUES).map_err(|error| said(&error))? {
        return Ok(Some(array));
    }
    let Object::Made { global, arguments, state: Some(state) } = pickle.get(id) else { return Ok(None) };
    // `copy_reg._reconstructor(class, …)` names the class among its arguments.
    let class = match (pickle.get(*global), pickle.items(*arguments)) {
        (Object::Global(_, "_reconstructor"), Some([class, ..])) => pickle.get(*class),
        (class, _) => class,
    };
    match class {
        Object::Global("chumpy.ch", "Ch") if depth < 4 => match pickle.entry(*state, "x") {
            Some(inner) => array(pickle, inner, depth + 1),
            None => Ok(None),
        },
        Object::Global(_, "csc_matrix") => sparse(pickle, *state, true).map(Some),
        Object::Global(_, "csr_matrix") => sparse(pickle, *state, false).map(Some),
        _ => Ok(None),
    }
}

/// A compressed sparse matrix made dense.
fn sparse(pickle: &Pickle<'_>, state: Id, by_columns: bool) -> Result<Array, String> {
    let part = |name: &str| -> Result<Vec<f64>, String> {
        let id = pickle.entry(state, name).ok_or_else(|| format!("the sparse matrix lacks `{name}`"))?;
        let found = numpy::array(pickle, id, MOST_VALUES).map_err(|error| said(&error))?;
        found.map(|array| array.values).ok_or_else(|| format!("the sparse matrix's `{name}` is no array"))
    };
    let shape = ["_shape", "shape"].iter().find_map(|name| pickle.items(pickle.entry(state, name)?));
    let sizes: Option<Vec<usize>> = shape.and_then(|items| items.iter().map(|size| pickle.size(*size)).collect());
    let Some([rows, columns]) = sizes.as_deref().and_then(|sizes| <[usize; 2]>::try_from(sizes).ok()) else {
        return Err("the sparse matrix has no shape of two sizes".into());
    };
    let whole = rows.checked_mul(columns).filter(|count| *count <= MOST_VALUES);
    let count = whole.ok_or_else(|| format!("the sparse matrix is {rows}×{columns}"))?;
    let (data, indices, starts) = (part("data")?, part("indices")?, part("indptr")?);
    let (lines, across) = if by_columns { (columns, rows) } else { (rows, columns) };
    if starts.len() != lines + 1 || data.len() != indices.len() {
        return Err("the parts of the sparse matrix do not fit".into());
    }
    let mut values = vec![0.0; count];
    for (line, bounds) in starts.windows(2).enumerate() {
        for k in bounds[0] as usize..(bounds[1] as usize).min(data.len()) {
            let other = indices[k] as usize;
            if other >= across || indices[k] < 0.0 {
                return Err("the sparse matrix points outside itself".into());
            }
            let (row, column) = if by_columns { (other, line) } else { (line, other) };
            values[row * columns + column] += data[k];
        }
    }
    Ok(Array { shape: vec![rows, columns], values })
}

/// Landmarks on a model's triangles, as the trackers around FLAME keep them.
pub struct Embedding {
    faces: Array,
    barycentric: Array,
    indices: Array,
}

impl Embedding {
    /// Reads an `.npz`, or a `.npy` that holds a dictionary.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        if bytes.starts_with(b"PK\x03\x04") {
            let mut npz = Npz::open(Cursor::new(bytes)).map_err(|error| said(&error))?;
            return Self::gather(|name| npz.array(name, MOST_VALUES).map_err(|error| said(&error)));
        }
        let Content::Pickled(pickle) = npy::read(bytes, MOST_VALUES).map_err(|error| said(&error))? else {
            return Err("it is one array, not the three of a landmark embedding".into());
        };
        let pickle = Pickle::read(pickle, &allowed).map_err(|error| error.to_string())?;
        // A dictionary alone in an array of objects without axes.
        let items = numpy::objects(&pickle, pickle.top()).ok_or("it holds no dictionary")?;
        let [dictionary] = *items else { return Err("it holds no dictionary".into()) };
        Self::gather(|name| match pickle.entry(dictionary, name) {
            Some(id) => array(&pickle, id, 0),
            None => Ok(None),
        })
    }

    fn gather(mut find: impl FnMut(&str) -> Result<Option<Array>, String>) -> Result<Self, String> {
        let mut need = |name: &str| find(name)?.ok_or_else(|| format!("it holds no array `{name}`"));
        Ok(Self {
            faces: need("lmk_face_idx")?,
            barycentric: need("lmk_b_coords")?,
            indices: need("landmark_indices")?,
        })
    }

    fn anchors(&self, triangles: usize) -> Result<Vec<LandmarkAnchor>, String> {
        let count = self.indices.values.len();
        if self.faces.values.len() != count || self.barycentric.values.len() != 3 * count {
            return Err("the landmark embedding's arrays do not fit together".into());
        }
        let mut anchors = Vec::new();
        for (k, share) in self.barycentric.values.as_chunks::<3>().0.iter().enumerate() {
            let (index, triangle) = (self.indices.values[k], self.faces.values[k]);
            let fine = (0.0..478.0).contains(&index) && (0.0..triangles as f64).contains(&triangle);
            if !fine || share.iter().any(|value| !value.is_finite()) {
                return Err(format!("entry {k} of the landmark embedding is out of range"));
            }
            if index < 468.0 {
                let barycentric = share.map(|value| value as f32);
                anchors.push(LandmarkAnchor { index: index as u32, triangle: triangle as u32, barycentric });
            }
        }
        anchors.sort_by_key(|anchor| anchor.index);
        anchors.dedup_by_key(|anchor| anchor.index);
        Ok(anchors)
    }
}

/// `rows × width` values of an array with that many columns.
fn shaped(array: &Array, what: &str, width: usize) -> Result<usize, String> {
    match array.shape[..] {
        [rows, columns] if columns == width && rows > 0 => Ok(rows),
        _ => Err(format!("`{what}` has the shape {:?}, not rows of {width}", array.shape)),
    }
}

/// The model as ours; landmarks are the embedding's, or found by alignment.
pub fn head(raw: Raw, embedding: Option<Embedding>, name: &str) -> Result<HeadModel, String> {
    let count = shaped(&raw.template, "v_template", 3)?;
    let faces = shaped(&raw.triangles, "f", 3)?;
    if shaped(&raw.weights, "weights", JOINTS)? != count || raw.regressor.shape != [JOINTS, count] {
        return Err(format!("`weights` or `J_regressor` do not fit five joints and {count} vertices"));
    }
    let [rows, 3, modes] = raw.shapes.shape[..] else {
        return Err(format!("`shapedirs` has the shape {:?}, not vertices × 3 × modes", raw.shapes.shape));
    };
    let (identities, expressions) = match modes {
        400 => (300, 100),
        150 => (100, 50),
        _ => return Err(format!("`shapedirs` has {modes} modes; 400 (300 of identity) and 150 (100) are known")),
    };
    if rows != count {
        return Err(format!("`shapedirs` has {rows} rows for {count} vertices"));
    }
    if raw.parents.values.get(1..JOINTS) != Some(&[0.0, 1.0, 1.0, 1.0]) {
        return Err("its joints are not root, neck, jaw and two eyes".into());
    }
    let corners: Option<Vec<u32>> =
        raw.triangles.values.iter().map(|v| (0.0..count as f64).contains(v).then_some(*v as u32)).collect();
    let triangles = corners.ok_or_else(|| format!("a triangle points at a vertex beyond {count}"))?;
    let triangles: Vec<[u32; 3]> = triangles.as_chunks::<3>().0.to_vec();
    debug_assert_eq!(triangles.len(), faces);
    let template = raw.template.values.as_chunks::<3>().0;
    let joints = regressed(&raw.regressor, |vertex| template[vertex]);
    let origin: [f64; 3] =
        std::array::from_fn(|k| (joints[joint::EYE_LEFT][k] + joints[joint::EYE_RIGHT][k]) / 2.0 - EYES[k]);
    let to_head = |p: &[f64; 3]| [0, 1, 2].map(|k| (p[k] - origin[k]) as f32);
    // The file keeps a vertex's modes together, we keep a mode's vertices together.
    let mut by_mode = vec![0.0f64; raw.shapes.values.len()];
    for (row, values) in raw.shapes.values.chunks_exact(modes).enumerate() {
        values.iter().enumerate().for_each(|(mode, value)| by_mode[mode * count * 3 + row] = *value);
    }
    let mode = |mode: usize| &by_mode[mode * count * 3..(mode + 1) * count * 3];
    let basis = |from: usize, count: usize| Basis {
        count,
        data: (from..from + count).flat_map(mode).map(|value| *value as f32).collect(),
    };
    let identity_count = identities.min(MOST_IDENTITY);
    let joint_identity = (0..identity_count)
        .flat_map(|k| {
            let shifts = mode(k);
            regressed(&raw.regressor, |vertex| shifts.as_chunks::<3>().0[vertex])
        })
        .flat_map(|shift| shift.map(|value| value as f32))
        .collect();
    let weights: Vec<[f32; JOINTS]> = raw.weights.values.as_chunks::<JOINTS>().0.iter().map(normalised).collect();
    let mut head = HeadModel {
        name: name.to_owned(),
        vertices: template.iter().map(to_head).collect(),
        triangles,
        regions: vec![Region::Skin; count],
        identity: basis(0, identity_count),
        expression: basis(identities, expressions.min(MOST_EXPRESSION)),
        eyelids: Basis { count: 2, data: vec![0.0; 2 * count * 3] },
        joints: joints.iter().map(to_head).collect(),
        joint_identity,
        parents: [-1, 0, 1, 1, 1],
        weights,
        landmarks: Vec::new(),
    };
    head.validate().map_err(|error| error.to_string())?;
    head.landmarks = match embedding {
        Some(embedding) => embedding.anchors(faces)?,
        None => align::landmarks(&head),
    };
    // The published embedding has 105 landmarks; parts and lids need the whole mesh.
    let whole = if head.landmarks.len() < 250 { align::landmarks(&head) } else { head.landmarks.clone() };
    head.regions = parts::regions(&head, &whole);
    head.eyelids = lids::closing(&head, &whole);
    head.validate().map_err(|error| error.to_string())?;
    Ok(head)
}

fn normalised(row: &[f64; JOINTS]) -> [f32; JOINTS] {
    let sum: f64 = row.iter().sum();
    // A row that does not sum to about 1 is refused by `validate`.
    if (0.9..1.1).contains(&sum) { row.map(|weight| (weight / sum) as f32) } else { row.map(|weight| weight as f32) }
}

fn regressed(regressor: &Array, at: impl Fn(usize) -> [f64; 3]) -> Vec<[f64; 3]> {
    let row = |weights: &[f64]| {
        let mut sum = [0.0; 3];
        for (vertex, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            let own = at(vertex);
            (0..3).for_each(|k| sum[k] += weight * own[k]);
        }
        sum
    };
    regressor.values.chunks_exact(regressor.values.len() / JOINTS).map(row).collect()
}
