//! Weight files: what is read, what is refused and how it is said, and that no damage whatever brings anything down.

use std::io::{Cursor, Write};

use proptest::prelude::*;
use zip::write::SimpleFileOptions;

use crate::bench::seeded_weights;
use crate::{Architecture, DecoderError, Network, Options, Tensor, Weights};

/// A pickle under construction.
#[derive(Default)]
struct Pickle(Vec<u8>);

impl Pickle {
    fn code(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.code(b"X").code(&(text.len() as u32).to_le_bytes()).code(text.as_bytes())
    }

    fn int(&mut self, value: i32) -> &mut Self {
        self.code(b"J").code(&value.to_le_bytes())
    }

    fn ints(&mut self, values: &[i32]) -> &mut Self {
        self.code(b"(");
        for value in values {
            self.int(*value);
        }
        self.code(b"t")
    }

    /// A tensor as `torch.save` writes it; sizes may lie.
    fn tensor(&mut self, class: &str, key: &str, len: i32, [offset, shape, strides]: [&[i32]; 3]) -> &mut Self {
        self.code(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        self.text("storage")
            .code(format!("ctorch\n{class}\n").as_bytes())
            .text(key)
            .text("cuda:0")
            .int(len)
            .code(b"tQ");
        self.int(offset[0]).ints(shape).ints(strides).code(b"\x89ccollections\nOrderedDict\n)RtR")
    }
}

/// An archive of a pickle's body, wrapped as an ordered dictionary, and storages.
fn archive(body: &Pickle, storages: &[(&str, &[u8])]) -> Vec<u8> {
    let mut pickle = Pickle::default();
    pickle.code(b"\x80\x02ccollections\nOrderedDict\n)R(").code(&body.0).code(b"u.");
    raw_archive(&pickle.0, storages)
}

fn raw_archive(pickle: &[u8], storages: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    zip.start_file("net/data.pkl", stored).unwrap();
    zip.write_all(pickle).unwrap();
    for (key, bytes) in storages {
        let deflated = stored.compression_method(zip::CompressionMethod::Deflated);
        zip.start_file(format!("net/data/{key}"), deflated).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// The weights of a network as a `.pth` file, with the prefix that several GPUs leave.
fn saved(weights: &Weights) -> Vec<u8> {
    let mut body = Pickle::default();
    let mut storages = Vec::new();
    for (index, name) in weights.names().enumerate() {
        let tensor = weights.get(name).unwrap();
        let shape: Vec<i32> = tensor.shape.iter().map(|n| *n as i32).collect();
        let strides: Vec<i32> = (0..shape.len()).map(|axis| shape[axis + 1..].iter().product()).collect();
        body.text(&format!("module.{name}"));
        body.tensor("FloatStorage", &index.to_string(), tensor.data.len() as i32, [&[0], &shape, &strides]);
        storages.push((index.to_string(), bytes_of(&tensor.data)));
    }
    let storages: Vec<(&str, &[u8])> = storages.iter().map(|(key, bytes)| (key.as_str(), bytes.as_slice())).collect();
    archive(&body, &storages)
}

fn refusal(bytes: &[u8]) -> String {
    Weights::from_bytes(bytes).unwrap_err().to_string()
}

#[test]
fn views_shared_storages_and_narrow_numbers_are_read() {
    let mut body = Pickle::default();
    body.text("a").tensor("FloatStorage", "0", 6, [&[0], &[2, 3], &[3, 1]]);
    body.text("turned").tensor("FloatStorage", "0", 6, [&[0], &[3, 2], &[1, 3]]);
    body.text("part").tensor("FloatStorage", "0", 6, [&[4], &[2], &[1]]);
    body.text("half").tensor("HalfStorage", "1", 2, [&[0], &[2], &[1]]);
    body.text("brain").tensor("BFloat16Storage", "2", 1, [&[0], &[], &[]]);
    body.text("count").tensor("LongStorage", "3", 1, [&[0], &[], &[]]);
    body.text("epoch").int(7);
    let file = archive(
        &body,
        &[("0", &bytes_of(&[1., 2., 3., 4., 5., 6.])), ("1", &[0, 0x3c, 0, 0xc0]), ("2", &[0x80, 0x3f])],
    );
    let weights = Weights::from_bytes(&file).unwrap();
    let values = |name: &str| weights.get(name).unwrap().data.clone();
    assert_eq!(weights.get("turned").unwrap().shape, [3, 2]);
    assert_eq!(values("turned"), [1., 4., 2., 5., 3., 6.]);
    assert_eq!((values("part"), values("half"), values("brain")), (vec![5., 6.], vec![1., -2.], vec![1.]));
    assert_eq!(weights.len(), 5);
}

#[test]
fn a_saved_network_loads_from_either_form() {
    let weights = seeded_weights(Architecture::FactorizePhys).unwrap();
    let network = Network::from_bytes(&saved(&weights), &Options::default()).unwrap();
    assert_eq!(network.architecture(), Architecture::FactorizePhys);
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = weights
        .names()
        .map(|name| {
            (name.to_owned(), weights.get(name).unwrap().shape.clone(), bytes_of(&weights.get(name).unwrap().data))
        })
        .collect();
    let views = tensors.iter().map(|(name, shape, bytes)| {
        (name, safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape.clone(), bytes).unwrap())
    });
    let file = safetensors::serialize(views, None).unwrap();
    assert_eq!(Network::from_bytes(&file, &Options::default()).unwrap().architecture(), Architecture::FactorizePhys);
}

#[test]
fn disagreements_with_the_network_are_named() {
    type List = Vec<(String, Tensor)>;
    let change = |architecture, edit: &dyn Fn(&mut List)| {
        let weights = seeded_weights(architecture).unwrap();
        let mut list: List = weights.names().map(|n| (n.to_owned(), weights.get(n).unwrap().clone())).collect();
        edit(&mut list);
        Network::new(&Weights::from_tensors(list).unwrap(), &Options::default()).unwrap_err()
    };
    for architecture in Architecture::ALL {
        let gone = match architecture {
            Architecture::TsCan => "motion_conv1.weight",
            Architecture::PhysFormer => "transformer2.blocks.3.attn.proj_q.1.running_var",
            Architecture::FactorizePhys => "rppg_head.final_layer.2.weight",
            Architecture::PhysNet => "ConvBlock9.0.bias",
        };
        let missing = change(architecture, &|list| list.retain(|(name, _)| name != gone));
        assert!(matches!(&missing, DecoderError::Missing { name, .. } if name == gone), "{missing}");
        let extra = change(architecture, &|list| {
            list.push(("classifier.weight".to_owned(), Tensor { shape: vec![], data: vec![1.0] }))
        });
        assert!(matches!(&extra, DecoderError::Extra { name, .. } if name == "classifier.weight"), "{extra}");
        let shape = change(architecture, &|list| list.iter_mut().for_each(|(_, tensor)| tensor.shape.push(1)));
        assert!(matches!(&shape, DecoderError::Shape { .. }), "{shape}");
    }
    let other = Options { architecture: Some(Architecture::PhysNet), ..Options::default() };
    let error = Network::new(&seeded_weights(Architecture::TsCan).unwrap(), &other).unwrap_err().to_string();
    assert!(error.contains("ConvBlock1.0.weight") && error.contains("PhysNet"), "{error}");
    let none = Network::new(&Weights::from_tensors([]).unwrap(), &Options::default());
    assert!(matches!(none, Err(DecoderError::Unrecognised { .. })));
}

#[test]
fn what_is_no_weight_file_is_refused_with_the_remedy() {
    assert!(refusal(b"").contains(".pth"));
    assert!(refusal(b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.").contains("torch.save"));
    assert!(refusal(b"PK\x03\x04rest").contains("zip"));
    assert!(refusal(b"\x10\x00\x00\x00\x00\x00\x00\x00{\"a\":nonsense...}").contains("safetensors"));
    assert!(refusal(&archive(&Pickle::default(), &[])).contains("no tensor"));
    let whole = saved(&seeded_weights(Architecture::FactorizePhys).unwrap());
    assert!(refusal(&whole[..whole.len() / 2]).contains("zip"));
    assert!(matches!(Weights::load(std::path::Path::new("/nowhere/x.pth")), Err(DecoderError::File { .. })));
}

#[test]
fn nothing_is_executed_and_nothing_unknown_is_named() {
    for global in ["cos\nsystem\n", "cbuiltins\neval\n", "c__main__\nNet\n"] {
        let pickle = [b"\x80\x02", global.as_bytes(), b"X\x02\x00\x00\x00ls\x85R."].concat();
        let message = refusal(&raw_archive(&pickle, &[]));
        assert!(message.contains("not on the list") && message.contains("nothing is executed"), "{message}");
    }
}

#[test]
fn lying_sizes_cost_no_memory() {
    let case = |len: i32, view: [&[i32]; 3], stored: &[u8]| {
        let mut body = Pickle::default();
        body.text("a").tensor("FloatStorage", "0", len, view);
        refusal(&archive(&body, &[("0", stored)]))
    };
    let four = bytes_of(&[1.0; 4]);
    assert!(case(4, [&[0], &[2, 3], &[3, 1]], &four).contains("outside its storage"));
    assert!(case(4, [&[4], &[1], &[1]], &four).contains("outside its storage"));
    assert!(case(i32::MAX, [&[0], &[4], &[1]], &four).contains("too large"));
    assert!(case(4, [&[0], &[i32::MAX, i32::MAX, i32::MAX], &[0, 0, 0]], &four).contains("too large"));
    assert!(case(4, [&[0], &[4], &[-1]], &four).contains("does not describe"));
    assert!(case(5, [&[0], &[5], &[1]], &four).contains("4 values instead of 5"));
    // 64 MiB of zeros in a few kilobytes: read only as far as the four values that are announced.
    assert!(case(4, [&[0], &[4], &[1]], &vec![0; 64 << 20]).contains("longer than 16 bytes"));
    assert!(case(4, [&[0], &[4], &[1]], &bytes_of(&[1.0, f32::NAN, 0.0, 0.0])).contains("NaN at 1"));
    // A list within a list, a hundred thousand deep, and one that holds itself.
    let deep = [b"\x80\x02".as_slice(), &b")\x85".repeat(100_000), b"."].concat();
    assert!(refusal(&raw_archive(&deep, &[])).contains("no dictionary"));
    let ring = b"\x80\x02]q\x00h\x00a.";
    assert!(refusal(&raw_archive(ring, &[])).contains("no dictionary"));
}

/// A small file that every part of the reader takes part in.
fn small_file() -> Vec<u8> {
    let mut body = Pickle::default();
    body.text("module.a").tensor("FloatStorage", "0", 6, [&[0], &[2, 3], &[3, 1]]);
    body.text("module.b").tensor("HalfStorage", "1", 2, [&[0], &[2], &[1]]);
    body.text("module.n").tensor("LongStorage", "2", 1, [&[0], &[], &[]]);
    archive(&body, &[("0", &bytes_of(&[0.5; 6])), ("1", &[0, 0x3c, 0, 0xc0])])
}

/// Damages `file` as the numbers say and reads it; any answer will do, a panic or a hang will not.
fn read_damaged(file: &[u8], damage: &[(u16, u8)], cut: u16) {
    let mut bytes = file.to_vec();
    for (at, value) in damage {
        let at = usize::from(*at) % bytes.len();
        bytes[at] = *value;
    }
    bytes.truncate(bytes.len() - usize::from(cut) % bytes.len());
    if let Ok(weights) = Weights::from_bytes(&bytes) {
        drop(Network::new(&weights, &Options::default()));
    }
}

/// A pickle's bytes, damaged before they are put into a sound archive, so that the damage gets past the zip's checksum.
fn read_damaged_pickle(pickle: &[u8], damage: &[(u16, u8)], cut: u16) {
    let mut bytes = pickle.to_vec();
    for (at, value) in damage {
        let at = usize::from(*at) % bytes.len();
        bytes[at] = *value;
    }
    bytes.truncate(bytes.len() - usize::from(cut) % bytes.len());
    drop(Weights::from_bytes(&raw_archive(&bytes, &[("0", &[0; 24]), ("1", &[0; 4])])));
}

fn small_pickle() -> Vec<u8> {
    let mut zip = zip::ZipArchive::new(Cursor::new(small_file())).unwrap();
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut zip.by_name("net/data.pkl").unwrap(), &mut bytes).unwrap();
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn no_damage_brings_the_reader_down(
        damage in proptest::collection::vec((any::<u16>(), any::<u8>()), 0..6),
        cut in prop_oneof![Just(0u16), any::<u16>()],
        noise in proptest::collection::vec(any::<u8>(), 0..64),
    ) {
        let file = small_file();
        read_damaged(&file, &damage, cut);
        read_damaged_pickle(&small_pickle(), &damage, cut);
        drop(Weights::from_bytes(&noise));
        drop(Weights::from_bytes(&raw_archive(&noise, &[])));
        let mut headed = (noise.len() as u64).to_le_bytes().to_vec();
        headed.push(b'{');
        headed.extend(&noise);
        drop(Weights::from_bytes(&headed));
    }
}

/// The same for `$HEARTIAN_FUZZ_MINUTES`, with seeds of the clock; prints the seed of each minute's start.
#[test]
#[ignore = "runs for minutes: HEARTIAN_FUZZ_MINUTES=10 cargo test -p heartian-decoder -- --ignored fuzz"]
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
    let (file, pickle) = (small_file(), small_pickle());
    let mut cases = 0u64;
    while start.elapsed().as_secs_f64() < 60.0 * minutes {
        let damage: Vec<(u16, u8)> = (0..next() % 6).map(|_| (next() as u16, next() as u8)).collect();
        let cut = if next() % 4 == 0 { next() as u16 } else { 0 };
        read_damaged(&file, &damage, cut);
        read_damaged_pickle(&pickle, &damage, cut);
        let noise: Vec<u8> = (0..next() % 200).map(|_| next() as u8).collect();
        drop(Weights::from_bytes(&raw_archive(&noise, &[])));
        cases += 3;
    }
    println!("{cases} files in {minutes} minutes");
}
