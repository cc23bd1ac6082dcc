//! Arrays written by another program's rules are read to the number; lies, bombs and strangers are refused; no damage
//! whatever brings a reader down.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::io::{Cursor, Write};

use npyz::WriterBuilder;
use proptest::prelude::*;
use zip::write::SimpleFileOptions;

use crate::npy::{self, Content, Npz};
use crate::{Archive, Array, ForeignError, Object, Pickle, numpy};

/// A `.npy` file by the independent crate `npyz`.
fn written(shape: &[u64], order: npyz::Order, values: &[f64]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer =
        npyz::WriteOptions::new().default_dtype().shape(shape).order(order).writer(&mut bytes).begin_nd().unwrap();
    writer.extend(values.iter().copied()).unwrap();
    writer.finish().unwrap();
    bytes
}

fn zipped(members: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let packed = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    for (name, bytes) in members {
        zip.start_file(*name, packed).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// A header of our own, which may lie.
fn raw_npy(header: &str, data: &[u8]) -> Vec<u8> {
    let len = (header.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00".as_slice(), &len, header.as_bytes(), data].concat()
}

#[test]
fn arrays_come_out_row_major_from_either_order_and_byte_order() {
    let values: Vec<f64> = (0..6).map(f64::from).collect();
    let c = npy::array(&written(&[2, 3], npyz::Order::C, &values), 6).unwrap();
    assert_eq!(c, Array { shape: vec![2, 3], values: values.clone() });
    let fortran = npy::array(&written(&[2, 3], npyz::Order::Fortran, &[0., 3., 1., 4., 2., 5.]), 6).unwrap();
    assert_eq!(fortran, c);
    let big = raw_npy("{'descr': '>i2', 'fortran_order': False, 'shape': (2,), }", &[0, 7, 0xff, 0xfe]);
    assert_eq!(npy::array(&big, 9).unwrap(), Array { shape: vec![2], values: vec![7.0, -2.0] });
    let one = raw_npy("{'descr': '|b1', 'fortran_order': False, 'shape': (), }", &[1]);
    assert_eq!(npy::array(&one, 1).unwrap(), Array { shape: vec![], values: vec![1.0] });
    let none = npy::array(&written(&[0, 3], npyz::Order::C, &[]), 6).unwrap();
    assert_eq!(none, Array { shape: vec![0, 3], values: vec![] });
    let object = raw_npy("{'descr': '|O', 'fortran_order': False, 'shape': (), }", b"pickle");
    assert_eq!(npy::read(&object, 1).unwrap(), Content::Pickled(b"pickle"));
}

#[test]
fn lying_headers_and_bombs_cost_no_memory() {
    let refusal = |bytes: &[u8], most| npy::array(bytes, most).unwrap_err();
    let header = |shape: &str| format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    let huge = refusal(&raw_npy(&header("(4294967296, 4294967296, 4)"), &[]), usize::MAX);
    assert!(matches!(huge, ForeignError::TooLarge { .. }), "{huge}");
    assert!(matches!(refusal(&raw_npy(&header("(1000000,)"), &[]), 10), ForeignError::TooLarge { .. }));
    assert!(matches!(refusal(&raw_npy(&header("(3,)"), &[0; 16]), 10), ForeignError::Damaged { .. }));
    assert!(matches!(refusal(&raw_npy(&header("(-3,)"), &[0; 16]), 10), ForeignError::Damaged { .. }));
    let record = "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }";
    assert!(matches!(refusal(&raw_npy(record, &[0; 8]), 10), ForeignError::Refused { .. }));
    let text = raw_npy("{'descr': '<U5', 'fortran_order': False, 'shape': (1,), }", &[0; 20]);
    assert!(matches!(refusal(&text, 10), ForeignError::Refused { .. }));
    assert!(matches!(refusal(b"\x93NUMPY\x02\x00\xff\xff\xff\xff", 10), ForeignError::TooLarge { .. }));
    // 64 MiB of zeros in 64 KiB, behind a header that claims eight values, and behind one that tells the truth.
    for shape in ["(8,)", "(8388608,)"] {
        let bomb = zipped(&[("a.npy", &raw_npy(&header(shape), &vec![0; 64 << 20]))]);
        let error = Npz::open(Cursor::new(&bomb)).unwrap().array("a", 1000).unwrap_err();
        assert!(matches!(error, ForeignError::TooLarge { .. }), "{error}");
    }
    let mut archive = Archive::open(Cursor::new(zipped(&[("x", &[7; 9])]))).unwrap();
    assert_eq!(archive.member("x", 9).unwrap(), [7; 9]);
    assert!(archive.member("x", 8).unwrap_err().to_string().contains("longer than 8 bytes"));
    assert!(matches!(archive.member("y", 8), Err(ForeignError::Damaged { .. })));
    assert!(Archive::open(Cursor::new(b"no zip".as_slice())).is_err());
}

#[test]
fn npz_members_are_found_by_name() {
    let file = zipped(&[("a.npy", &written(&[2], npyz::Order::C, &[1.0, 2.0])), ("note.txt", b"x")]);
    let mut npz = Npz::open(Cursor::new(&file)).unwrap();
    assert_eq!(npz.names().collect::<Vec<_>>(), ["a"]);
    assert_eq!(npz.array("a", 2).unwrap().unwrap().values, [1.0, 2.0]);
    assert_eq!(npz.array("b", 2).unwrap(), None);
}

/// A numpy array as Python 2 pickles it, with the given class path.
fn pickled_array(module: &str, shape: &[u8], data: &[u8]) -> Vec<u8> {
    let mut out = b"\x80\x02c".to_vec();
    out.extend(module.bytes());
    out.extend(b"\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01(");
    shape.iter().for_each(|size| out.extend([b'K', *size]));
    out.extend(b"tcnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89T");
    out.extend((data.len() as u32).to_le_bytes());
    out.extend(data);
    out.extend(b"tb.");
    out
}

#[test]
fn arrays_in_pickles_are_read_by_their_names_only() {
    let data: Vec<u8> = [1.5f64, -2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    for module in ["numpy.core.multiarray", "numpy._core.multiarray"] {
        let bytes = pickled_array(module, &[1, 2], &data);
        let pickle = Pickle::read(&bytes, &numpy::is_numpy).unwrap();
        let array = numpy::array(&pickle, pickle.top(), 2).unwrap().unwrap();
        assert_eq!(array, Array { shape: vec![1, 2], values: vec![1.5, -2.0] });
        assert!(matches!(numpy::array(&pickle, pickle.top(), 1), Err(ForeignError::TooLarge { .. })));
    }
    let lying = pickled_array("numpy.core.multiarray", &[200, 200, 200], &data);
    let pickle = Pickle::read(&lying, &numpy::is_numpy).unwrap();
    assert!(matches!(numpy::array(&pickle, pickle.top(), 1 << 30), Err(ForeignError::Damaged { .. })));
    let error = Pickle::read(&pickled_array("os", &[1], &data), &numpy::is_numpy).unwrap_err();
    assert!(error.to_string().contains("`os._reconstruct`"), "{error}");
}

#[test]
fn a_pickle_is_replayed_and_never_run() {
    let any = |_: &str, _: &str| true;
    // {'a': [1, None, True], b'b': (2.5, 'x')} in Python 2's spelling, with a set and a bytes object of Python 3.
    let bytes = b"\x80\x02}q\x00(U\x01a](K\x01N\x88eU\x01bG@\x04\x00\x00\x00\x00\x00\x00X\x01\x00\x00\x00x\x86u.";
    let pickle = Pickle::read(bytes, &any).unwrap();
    let list = pickle.entry(pickle.top(), "a").unwrap();
    assert_eq!(pickle.items(list).unwrap().len(), 3);
    let pair = pickle.items(pickle.entry(pickle.top(), "b").unwrap()).unwrap();
    assert_eq!((pickle.get(pair[0]), pickle.text(pair[1])), (&Object::Float(2.5), Some("x")));
    // The two bytes of the UTF-8 form of é stand for one byte.
    let encoded = b"\x80\x02c_codecs\nencode\nX\x02\x00\x00\x00\xc3\xa9X\x06\x00\x00\x00latin1\x86R.";
    let pickle = Pickle::read(encoded, &numpy::is_numpy).unwrap();
    assert_eq!(pickle.bytes(pickle.top()).unwrap().as_ref(), [0xe9]);
    let system = b"\x80\x02cos\nsystem\nX\x02\x00\x00\x00ls\x85R.";
    // Even allowed, it is only data.
    let pickle = Pickle::read(system, &any).unwrap();
    assert!(matches!(pickle.get(pickle.top()), Object::Made { .. }));
    let error = Pickle::read(system, &numpy::is_numpy).unwrap_err();
    assert!(error.to_string().contains("`os.system`") && error.to_string().contains("nothing is executed"), "{error}");
    for broken in [b"".as_slice(), b"\x80", b"\x80\x02.", b"\x80\x02K\x01", b"\x80\x02h\x05.", b"\x80\x02i", b"tt."] {
        assert!(Pickle::read(broken, &any).is_err(), "{broken:?}");
    }
}

/// Every reader on damaged bytes; any answer will do, a panic or a hang will not.
fn survive(bytes: &[u8]) {
    drop(npy::read(bytes, 1 << 16));
    if let Ok(mut npz) = Npz::open(Cursor::new(bytes)) {
        let names: Vec<String> = npz.names().map(str::to_owned).collect();
        names.iter().for_each(|name| drop(npz.array(name, 1 << 16)));
    }
    if let Ok(pickle) = Pickle::read(bytes, &numpy::is_numpy) {
        drop(numpy::array(&pickle, pickle.top(), 1 << 16));
        let _ = numpy::objects(&pickle, pickle.top());
        drop(pickle.bytes(pickle.top()));
    }
}

fn samples() -> [Vec<u8>; 3] {
    let npy = written(&[2, 2], npyz::Order::Fortran, &[1.0; 4]);
    let npz = zipped(&[("a.npy", &npy), ("b.npy", &npy)]);
    [npy, npz, pickled_array("numpy.core.multiarray", &[1, 2], &[0; 16])]
}

fn damaged(sample: &[u8], damage: &[(u16, u8)], cut: u16) -> Vec<u8> {
    let mut bytes = sample.to_vec();
    for (at, value) in damage {
        let at = usize::from(*at) % bytes.len();
        bytes[at] = *value;
    }
    bytes.truncate(bytes.len() - usize::from(cut) % bytes.len());
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]
    #[test]
    fn no_damage_brings_a_reader_down(
        damage in proptest::collection::vec((any::<u16>(), any::<u8>()), 0..6),
        cut in prop_oneof![Just(0u16), any::<u16>()],
        noise in proptest::collection::vec(any::<u8>(), 0..64),
    ) {
        samples().iter().for_each(|sample| survive(&damaged(sample, &damage, cut)));
        survive(&noise);
        survive(&[b"\x93NUMPY\x01\x00".as_slice(), &noise].concat());
    }
}

/// The same for `$HEARTIAN_FUZZ_MINUTES`, seeded by the clock; prints the seed.
#[test]
#[ignore = "runs for minutes: HEARTIAN_FUZZ_MINUTES=5 cargo test -p heartian-foreign -- --ignored fuzz --nocapture"]
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
    let samples = samples();
    let mut cases = 0u64;
    while start.elapsed().as_secs_f64() < 60.0 * minutes {
        for sample in &samples {
            let damage: Vec<(u16, u8)> = (0..next() % 6).map(|_| (next() as u16, next() as u8)).collect();
            survive(&damaged(sample, &damage, if next() % 4 == 0 { next() as u16 } else { 0 }));
            cases += 1;
        }
        let noise: Vec<u8> = (0..next() % 200).map(|_| next() as u8).collect();
        survive(&noise);
        cases += 1;
    }
    println!("{cases} files in {minutes} minutes");
}
