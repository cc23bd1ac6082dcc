//! A user's FLAME file, written by another hand in the published layout: read to the number from every coat, refused
//! where it lies, never executed. No real FLAME file is available to these tests.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::io::{Cursor, Write};

use proptest::prelude::*;

use super::flame::{Embedding, Raw, head};
use super::*;
use crate::FramePose;
use crate::model::{JOINTS, Region, joint};

/// A pickle as Python 2 writes it in protocol 2.
#[derive(Default)]
struct Python(Vec<u8>);

impl Python {
    fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.raw(b"U").raw(&[text.len() as u8]).raw(text.as_bytes())
    }

    fn int(&mut self, value: usize) -> &mut Self {
        self.raw(b"J").raw(&(value as i32).to_le_bytes())
    }

    /// A numpy array; the kind is `f8`, `i4` or `u4`, the bytes little-endian.
    fn array(&mut self, shape: &[usize], kind: &str, bytes: &[u8]) -> &mut Self {
        self.raw(b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01(");
        for size in shape {
            self.int(*size);
        }
        self.raw(b"tcnumpy\ndtype\n")
            .text(kind)
            .raw(b"K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89T");
        self.raw(&(bytes.len() as u32).to_le_bytes()).raw(bytes).raw(b"tb")
    }

    fn doubles(&mut self, shape: &[usize], values: &[f64]) -> &mut Self {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.array(shape, "f8", &bytes)
    }

    fn ints(&mut self, shape: &[usize], values: &[u32]) -> &mut Self {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.array(shape, "u4", &bytes)
    }

    /// An object of a chumpy array's state; `new` is how its class is called up.
    fn chumpy(&mut self, shape: &[usize], values: &[f64]) -> &mut Self {
        self.raw(b"cchumpy.ch\nCh\n)\x81}(").text("_dirty_vars").raw(b"c__builtin__\nset\n]\x85R").text("x");
        self.doubles(shape, values).text("_depends_on_deps").raw(b"Nub")
    }

    /// A scipy matrix of sparse columns from a dense one.
    fn sparse(&mut self, [rows, columns]: [usize; 2], dense: &[f64]) -> &mut Self {
        let (mut data, mut indices, mut starts) = (Vec::new(), Vec::new(), vec![0u32]);
        for column in 0..columns {
            for row in (0..rows).filter(|row| dense[row * columns + column] != 0.0) {
                data.push(dense[row * columns + column]);
                indices.push(row as u32);
            }
            starts.push(data.len() as u32);
        }
        self.raw(b"ccopy_reg\n_reconstructor\ncscipy.sparse.csc\ncsc_matrix\nc__builtin__\nobject\nN\x87R}(");
        self.text("data").doubles(&[data.len()], &data);
        self.text("indices").ints(&[indices.len()], &indices);
        self.text("indptr").ints(&[starts.len()], &starts);
        self.text("_shape").int(rows).int(columns).raw(b"\x86ub")
    }
}

/// The built-in head dressed as FLAME: 100 identity and 50 expression modes, larger by a scale, away from the origin.
struct Dressed {
    template: Vec<f64>,
    triangles: Vec<u32>,
    shapes: Vec<f64>,
    regressor: Vec<f64>,
    weights: Vec<f64>,
}

const MODES: usize = 150;
const SCALE: f64 = 1.04;
const AWAY: [f64; 3] = [0.0, -0.05, -0.03];
const PARENTS: [u32; 10] = [u32::MAX, 0, 1, 1, 1, 0, 1, 2, 3, 4];

fn dressed() -> Dressed {
    let own = HeadModel::procedural();
    let count = own.vertices.len();
    let place = |p: &[f32; 3]| [0, 1, 2].map(|k| f64::from(p[k]) * SCALE + AWAY[k]);
    let mut shapes = vec![0.0; count * 3 * MODES];
    for (basis, from) in [(&own.identity, 0), (&own.expression, 100)] {
        for mode in 0..basis.count {
            for (k, value) in basis.mode(mode).as_flattened().iter().enumerate() {
                shapes[k * MODES + from + mode] = f64::from(*value) * SCALE;
            }
        }
    }
    // A joint as the mean of the eight vertices nearest to it would be off by millimetres: eyes by their own vertices,
    // the rest by a few whose weights solve for it is more than needed; the nearest single vertex does.
    let mut regressor = vec![0.0; JOINTS * count];
    for j in 0..JOINTS {
        let region = [None, None, None, Some(Region::EyeLeft), Some(Region::EyeRight)][j];
        let ball: Vec<usize> = (0..count).filter(|v| Some(own.regions[*v]) == region).collect();
        let far = |v: usize| (0..3).map(|k| (own.vertices[v][k] - own.joints[j][k]).powi(2)).sum::<f32>();
        let nearest = (0..count).min_by(|a, b| far(*a).total_cmp(&far(*b))).unwrap();
        let used = if ball.is_empty() { vec![nearest] } else { ball };
        used.iter().for_each(|v| regressor[j * count + v] = 1.0 / used.len() as f64);
    }
    Dressed {
        template: own.vertices.iter().flat_map(place).collect(),
        triangles: own.triangles.as_flattened().to_vec(),
        shapes,
        regressor,
        weights: own.weights.as_flattened().iter().map(|w| f64::from(*w)).collect(),
    }
}

impl Dressed {
    fn count(&self) -> usize {
        self.template.len() / 3
    }

    fn pickled(&self) -> Vec<u8> {
        let (count, mut out) = (self.count(), Python::default());
        out.raw(b"\x80\x02}(").text("bs_style").text("lbs");
        out.text("v_template").chumpy(&[count, 3], &self.template);
        out.text("f").ints(&[self.triangles.len() / 3, 3], &self.triangles);
        out.text("shapedirs").chumpy(&[count, 3, MODES], &self.shapes);
        out.text("J_regressor").sparse([JOINTS, count], &self.regressor);
        out.text("weights").doubles(&[count, JOINTS], &self.weights);
        out.text("kintree_table").ints(&[2, JOINTS], &PARENTS).raw(b"u.");
        out.0
    }

    fn zipped(&self) -> Vec<u8> {
        let count = self.count();
        let triangles: Vec<f64> = self.triangles.iter().map(|v| f64::from(*v)).collect();
        let parents: Vec<f64> = PARENTS.iter().map(|v| f64::from(*v)).collect();
        npz(&[
            ("v_template", &[count, 3], &self.template),
            ("f", &[triangles.len() / 3, 3], &triangles),
            ("shapedirs", &[count, 3, MODES], &self.shapes),
            ("J_regressor", &[JOINTS, count], &self.regressor),
            ("weights", &[count, JOINTS], &self.weights),
            ("kintree_table", &[2, JOINTS], &parents),
        ])
    }
}

fn npy(shape: &[usize], values: &[f64]) -> Vec<u8> {
    let sizes: String = shape.iter().map(|size| format!("{size}, ")).collect();
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({sizes}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

fn npz(arrays: &[(&str, &[usize], &[f64])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, shape, values) in arrays {
        let fast = zip::write::SimpleFileOptions::default().compression_level(Some(1));
        zip.start_file(format!("{name}.npy"), fast).unwrap();
        zip.write_all(&npy(shape, values)).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
}

#[test]
fn a_flame_file_is_read_from_pickle_and_npz_alike() {
    let (own, dressed) = (HeadModel::procedural(), dressed());
    let found = head(Raw::read(&dressed.pickled()).unwrap(), None, "flame2020").unwrap();
    assert_eq!(found, head(Raw::read(&dressed.zipped()).unwrap(), None, "flame2020").unwrap());
    assert_eq!((found.name.as_str(), found.identity.count, found.expression.count), ("flame2020", 100, 50));
    // Sizes stay the file's, the place is ours: eyes in the middle where head space has them.
    let (eyes, own_eyes) = ([3, 4].map(|j| found.joints[j]), [3, 4].map(|j| own.joints[j]));
    assert!((distance(eyes[0], eyes[1]) / distance(own_eyes[0], own_eyes[1]) - SCALE as f32).abs() < 0.01);
    assert!((eyes[0][0] + eyes[1][0]).abs() < 1e-4 && (eyes[0][1] - 0.015).abs() < 1e-4);
    for mode in [0, 3] {
        for (a, b) in found.identity.mode(mode).iter().zip(own.identity.mode(mode)).step_by(50) {
            assert!(distance(*a, b.map(|value| value * SCALE as f32)) < 1e-6);
        }
    }
    assert_eq!(found.expression.mode(2)[100], own.expression.mode(2)[100].map(|v| (f64::from(v) * SCALE) as f32));
    assert!(found.weights.iter().zip(&own.weights).all(|(a, b)| (0..JOINTS).all(|j| (a[j] - b[j]).abs() < 1e-6)));
    assert!([Region::Lips, Region::Scalp, Region::Neck, Region::EyeLeft].iter().all(|r| found.regions.contains(r)));
}

#[test]
fn landmarks_are_the_embeddings_or_found_by_alignment() {
    let (own, dressed) = (HeadModel::procedural(), dressed());
    let aligned = head(Raw::read(&dressed.pickled()).unwrap(), None, "f").unwrap();
    assert_eq!(aligned.landmarks.len(), own.landmarks.len());
    let off: Vec<f32> = aligned
        .landmarks
        .iter()
        .filter_map(|anchor| {
            let want = own.landmarks.iter().find(|other| other.index == anchor.index)?;
            let place = aligned.landmark_position(anchor, &aligned.vertices);
            Some(distance(place, aligned.landmark_position(want, &aligned.vertices)))
        })
        .collect();
    let (mean, most) = (off.iter().sum::<f32>() / off.len() as f32, off.iter().copied().fold(0.0, f32::max));
    println!("alignment: mean {:.2} mm, most {:.2} mm", 1e3 * mean, 1e3 * most);
    assert!(mean < 2.5e-3 && most < 12e-3, "{mean} {most}");
    let lids = |head: &HeadModel, closed: f32| {
        let posed = head.pose(&FramePose { eyelids: [closed; 2], ..FramePose::rest(0) });
        let place = |index: u32| {
            let anchor = head.landmarks.iter().find(|anchor| anchor.index == index).unwrap();
            head.landmark_position(anchor, &posed)
        };
        distance(place(159), place(145)) + distance(place(386), place(374))
    };
    assert!(lids(&aligned, 1.0) < 0.6 * lids(&aligned, 0.0), "{} {}", lids(&aligned, 1.0), lids(&aligned, 0.0));

    let anchors = &own.landmarks[..105];
    let column = |value: &dyn Fn(&crate::LandmarkAnchor) -> Vec<f32>| -> Vec<f64> {
        anchors.iter().flat_map(value).map(f64::from).collect()
    };
    let faces = column(&|anchor| vec![anchor.triangle as f32]);
    let shares = column(&|anchor| anchor.barycentric.to_vec());
    let indices = column(&|anchor| vec![anchor.index as f32]);
    let file = npz(&[
        ("lmk_face_idx", &[105], &faces),
        ("lmk_b_coords", &[105, 3], &shares),
        ("landmark_indices", &[105], &indices),
    ]);
    let given = head(Raw::read(&dressed.pickled()).unwrap(), Some(Embedding::read(&file).unwrap()), "f").unwrap();
    assert_eq!(given.landmarks, anchors);
    // The same as a dictionary in a `.npy` of objects.
    let mut objects = Python::default();
    objects.raw(b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01)cnumpy\ndtype\n").text("O8");
    objects.raw(b"K\x00K\x01\x87R(K\x03U\x01|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x3ftb\x89]}(");
    objects.text("lmk_face_idx").doubles(&[105], &faces).text("lmk_b_coords").doubles(&[105, 3], &shares);
    objects.text("landmark_indices").doubles(&[105], &indices).raw(b"uatb.");
    let header = "{'descr': '|O', 'fortran_order': False, 'shape': (), }\n";
    let file =
        [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes(), &objects.0].concat();
    let given = head(Raw::read(&dressed.pickled()).unwrap(), Some(Embedding::read(&file).unwrap()), "f").unwrap();
    assert_eq!(given.landmarks, anchors);
}

fn refusal(bytes: &[u8]) -> String {
    Raw::read(bytes).and_then(|raw| head(raw, None, "x")).err().unwrap()
}

#[test]
fn nothing_in_a_pickle_is_executed() {
    let folder = tempfile::tempdir().unwrap();
    let trace = folder.path().join("trace");
    let command = format!("touch {}", trace.display());
    for (module, name) in [("posix", "system"), ("os", "system"), ("__builtin__", "eval"), ("subprocess", "Popen")] {
        let mut out = Python::default();
        out.raw(b"\x80\x02}(").text("v_template").raw(format!("c{module}\n{name}\n").as_bytes());
        out.text(&command).raw(b"\x85Ru.");
        let said = refusal(&out.0);
        assert!(said.contains(&format!("{module}.{name}")) && said.contains("nothing is executed"), "{said}");
    }
    assert!(!trace.exists());
    let path = folder.path().join("bad.pkl");
    std::fs::write(&path, b"\x80\x02cos\nsystem\nU\x02ls\x85R.").unwrap();
    let said = HeadModel::load(&HeadSource::File { model: path, landmarks: None }).unwrap_err().to_string();
    assert!(said.contains("bad.pkl") && said.contains("os.system"), "{said}");
}

/// A file of the right arrays and the wrong sizes: small, for damage.
fn small() -> Vec<u8> {
    let mut out = Python::default();
    out.raw(b"\x80\x02}(").text("v_template").chumpy(&[2, 3], &[0.5; 6]);
    out.text("f").ints(&[1, 3], &[0, 1, 0]).text("shapedirs").doubles(&[2, 3, 1], &[0.0; 6]);
    out.text("J_regressor").sparse([JOINTS, 2], &[0.5; 10]);
    out.text("weights").doubles(&[2, JOINTS], &[0.2; 10]);
    out.text("kintree_table").ints(&[2, JOINTS], &PARENTS).raw(b"u.");
    out.0
}

#[test]
fn wrong_files_are_told_by_what_is_wrong_with_them() {
    assert!(refusal(b"").contains("neither"));
    assert!(refusal(b"\x80\x02]q\x00.").contains("no dictionary"));
    assert!(refusal(b"\x80\x02}.").contains("v_template"));
    assert!(refusal(&small()).contains("shapedirs"));
    let whole = small();
    for cut in [3, whole.len() / 2, whole.len() - 1] {
        assert!(refusal(&whole[..cut]).contains("cut short"), "{}", refusal(&whole[..cut]));
    }
    let mut huge = Python::default();
    huge.raw(b"\x80\x02}(").text("v_template").doubles(&[2_000_000_000, 2_000_000_000, 2_000_000_000], &[]).raw(b"u.");
    assert!(refusal(&huge.0).contains("larger than"), "{}", refusal(&huge.0));
    let mut ring = Python::default();
    ring.raw(b"\x80\x02}(").text("v_template").raw(b"cchumpy.ch\nCh\n)\x81q\x01}(").text("x").raw(b"h\x01ubu.");
    assert!(refusal(&ring.0).contains("no array `v_template`"));
    // 64 MiB of zeros in 64 KiB.
    // (A level of 1 still packs zeros two hundredfold.)
    let bomb = npz(&[("v_template", &[1 << 23], &vec![0.0; 1 << 23])]);
    assert!(bomb.len() < 1 << 20 && refusal(&bomb).contains("no array"), "{}", refusal(&bomb));
    let missing = HeadSource::File { model: "/nowhere/flame.pkl".into(), landmarks: None };
    assert!(HeadModel::load(&missing).unwrap_err().to_string().contains("/nowhere/flame.pkl"));
    assert!(Embedding::read(&npy(&[2], &[1.0, 2.0])).is_err() && Embedding::read(b"").is_err());
}

/// Reads damaged bytes; any answer will do, a panic or a hang will not.
fn survive(bytes: &[u8]) {
    drop(Raw::read(bytes).and_then(|raw| head(raw, None, "x")));
    drop(Embedding::read(bytes));
    drop(super::stored::Stored::from_bytes(bytes).map(super::stored::Stored::into_head));
}

/// The smallest sound head file of our own.
fn stored() -> Vec<u8> {
    let head = super::stored::Stored {
        name: "x".into(),
        vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2]],
        regions: vec![Region::Skin; 3],
        weights: vec![[1.0, 0.0, 0.0, 0.0, 0.0]; 3],
        joints: vec![[0.0; 3]; JOINTS],
        identity: crate::Basis { count: 1, data: vec![0.001; 9] },
        joint_identity: vec![0.0; JOINTS * 3],
        shapes: vec![super::stored::Shape { name: "browInnerUp".into(), deltas: vec![(1, [0.0, 0.002, -0.001])] }],
        landmarks: vec![crate::LandmarkAnchor { index: 1, triangle: 0, barycentric: [1.0, 0.0, 0.0] }],
    };
    head.to_bytes().unwrap()
}

#[test]
fn a_head_file_of_our_own_comes_back() {
    let head = super::stored::Stored::from_bytes(&stored()).unwrap();
    assert!((head.shapes[0].deltas[0].1[1] - 0.002).abs() < 1e-6 && (head.identity.data[4] - 0.001).abs() < 1e-6);
    assert_eq!(head.into_head().unwrap().expression.count, 1);
    assert_eq!(joint::ROOT, 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn no_damage_brings_the_readers_down(
        damage in proptest::collection::vec((any::<u16>(), any::<u8>()), 0..6),
        cut in prop_oneof![Just(0u16), any::<u16>()],
    ) {
        for sample in [small(), stored()] {
            let mut bytes = sample;
            damage.iter().for_each(|(at, value)| { let at = usize::from(*at) % bytes.len(); bytes[at] = *value; });
            bytes.truncate(bytes.len() - usize::from(cut) % bytes.len());
            survive(&bytes);
        }
    }
}

/// The same for `$HEARTIAN_FUZZ_MINUTES`, seeded by the clock.
#[test]
#[ignore = "runs for minutes: HEARTIAN_FUZZ_MINUTES=5 cargo test -p heartian-face -- --ignored fuzz --nocapture"]
fn fuzz_for_minutes() {
    let minutes = std::env::var("HEARTIAN_FUZZ_MINUTES").ok().and_then(|text| text.parse().ok()).unwrap_or(1.0);
    let start = std::time::Instant::now();
    let mut state = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64 | 1;
    println!("seed {state}");
    let mut next = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let samples = [small(), stored()];
    let mut cases = 0u64;
    while start.elapsed().as_secs_f64() < 60.0 * minutes {
        for sample in &samples {
            let mut bytes = sample.clone();
            for _ in 0..next() % 6 {
                let at = next() as usize % bytes.len();
                bytes[at] = next() as u8;
            }
            if next() % 4 == 0 {
                bytes.truncate(next() as usize % bytes.len());
            }
            survive(&bytes);
            cases += 1;
        }
    }
    println!("{cases} files in {minutes} minutes");
}
