//! A model written by hand runs to the number worked out by hand; damaged models are errors; the installed networks,
//! where there are any, behave on a real frame.
#![expect(clippy::unwrap_used, reason = "tests")]

use proptest::prelude::*;

use super::*;
use crate::models::FaceNets;

/// A FlatBuffers value, enough to write a model with.
enum Value {
    Byte(i8),
    Int(i32),
    Ints(Vec<i32>),
    Bytes(Vec<u8>),
    Table(Vec<(usize, Value)>),
    Tables(Vec<Vec<(usize, Value)>>),
}

/// Appends a table and all below it; returns where it lies. Parents come first: offsets point forward.
fn write(out: &mut Vec<u8>, fields: &[(usize, Value)]) -> usize {
    let slots = fields.iter().map(|(id, _)| id + 1).max().unwrap_or(0);
    let vtable = out.len();
    let table = vtable + 4 + 2 * slots;
    let mut offsets = vec![0u16; slots];
    fields.iter().enumerate().for_each(|(i, (id, _))| offsets[*id] = 4 + 4 * i as u16);
    out.extend((4 + 2 * slots as u16).to_le_bytes());
    out.extend((4 + 4 * fields.len() as u16).to_le_bytes());
    offsets.iter().for_each(|offset| out.extend(offset.to_le_bytes()));
    out.extend(((table - vtable) as i32).to_le_bytes());
    out.resize(out.len() + 4 * fields.len(), 0);
    for (i, (_, value)) in fields.iter().enumerate() {
        let at = table + 4 + 4 * i;
        let word = match value {
            Value::Byte(byte) => i32::from(*byte),
            Value::Int(int) => *int,
            other => (write_vector(out, other) - at) as i32,
        };
        out[at..at + 4].copy_from_slice(&word.to_le_bytes());
    }
    table
}

fn write_vector(out: &mut Vec<u8>, value: &Value) -> usize {
    let start = out.len();
    match value {
        Value::Ints(ints) => {
            out.extend((ints.len() as u32).to_le_bytes());
            ints.iter().for_each(|int| out.extend(int.to_le_bytes()));
        }
        Value::Bytes(bytes) => {
            out.extend((bytes.len() as u32).to_le_bytes());
            out.extend(bytes);
        }
        Value::Tables(tables) => {
            out.extend((tables.len() as u32).to_le_bytes());
            out.resize(out.len() + 4 * tables.len(), 0);
            for (i, fields) in tables.iter().enumerate() {
                let at = start + 4 + 4 * i;
                let offset = (write(out, fields) - at) as u32;
                out[at..at + 4].copy_from_slice(&offset.to_le_bytes());
            }
        }
        Value::Table(fields) => return write(out, fields),
        Value::Byte(_) | Value::Int(_) => unreachable!("scalars are stored in the table"),
    }
    start
}

/// 2×2 image → 1×1 convolution with half-float weight 2 and bias −1 → ReLU → padding by one column.
fn small_model() -> Vec<u8> {
    use Value::{Byte, Bytes, Int, Ints, Table, Tables};
    let tensor =
        |shape: &[i32], kind: i8, buffer: i32| vec![(0, Ints(shape.to_vec())), (1, Byte(kind)), (2, Int(buffer))];
    let code = |number: i32| vec![(3, Int(number))];
    let layer = |code: i32, inputs: &[i32], output: i32, options: Option<Vec<(usize, Value)>>| {
        let mut fields = vec![(0, Int(code)), (1, Ints(inputs.to_vec())), (2, Ints(vec![output]))];
        fields.extend(options.map(|options| (4, Table(options))));
        fields
    };
    let pads: Vec<u8> = [0i32, 0, 0, 0, 0, 1, 0, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let graph = vec![
        (
            0,
            Tables(vec![
                tensor(&[1, 2, 2, 1], 0, 0),
                tensor(&[1, 1, 1, 1], 1, 1),
                tensor(&[1, 1, 1, 1], 0, 0),
                tensor(&[1], 0, 2),
                tensor(&[1, 2, 2, 1], 0, 0),
                tensor(&[4, 2], 2, 3),
                tensor(&[1, 2, 3, 1], 0, 0),
            ]),
        ),
        (1, Ints(vec![0])),
        (2, Ints(vec![6])),
        (
            3,
            Tables(vec![
                layer(0, &[1], 2, None),
                layer(1, &[0, 2, 3], 4, Some(vec![(0, Byte(0)), (1, Int(1)), (2, Int(1)), (3, Byte(1))])),
                layer(2, &[4, 5], 6, None),
            ]),
        ),
    ];
    let buffers = vec![
        vec![],
        vec![(0, Bytes(0x4000u16.to_le_bytes().to_vec()))],
        vec![(0, Bytes((-1.0f32).to_le_bytes().to_vec()))],
        vec![(0, Bytes(pads))],
    ];
    let model = [(1, Tables(vec![code(6), code(3), code(34)])), (2, Tables(vec![graph])), (4, Tables(buffers))];
    let mut out = b"\0\0\0\0TFL3".to_vec();
    let root = write(&mut out, &model) as u32;
    out[..4].copy_from_slice(&root.to_le_bytes());
    out
}

#[test]
fn a_hand_written_model_gives_the_hand_computed_answer() {
    let net = Net::parse(&small_model()).unwrap();
    let output = net.run(vec![0.0, 1.0, 2.0, 3.5]).unwrap().remove(0);
    assert_eq!(output, Tensor { shape: vec![1, 2, 3, 1], data: vec![0.0, 1.0, 0.0, 3.0, 6.0, 0.0] });
    assert!(matches!(net.run(vec![0.0; 3]), Err(NetError::Shape { .. })));
    assert!(matches!(Net::parse(b"not a model at all"), Err(NetError::Malformed(_))));
    assert!(matches!(Net::parse(b""), Err(NetError::Malformed(_))));
}

/// Parses and, where that works, runs: any outcome but a panic or a hang is fine.
fn survive(bytes: &[u8]) {
    if let Ok(net) = Net::parse(bytes)
        && let Ok(shape) = net.input_shape()
    {
        let count: usize = shape.iter().product();
        let _ = net.run(vec![0.5; count.min(1 << 20)]);
    }
}

proptest! {
    #[test]
    fn mutated_models_never_panic(edits in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6)) {
        let mut bytes = small_model();
        for (at, value) in edits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        survive(&bytes);
    }

    #[test]
    fn cut_models_never_panic(length in 0usize..700) {
        let bytes = small_model();
        survive(&bytes[..length.min(bytes.len())]);
    }
}

fn installed() -> Option<FaceNets> {
    let nets = FaceNets::load();
    if let Err(error) = &nets {
        println!("skipped: {error}");
    }
    nets.ok()
}

#[test]
fn nothing_is_seen_in_noise_and_degenerate_images() {
    let Some(nets) = installed() else { return };
    let mut follower = FaceFollower::new(&nets.detector, &nets.landmarks);
    for (width, height) in [(1, 1), (320, 1), (64, 48)] {
        let data = (0..width * height * 3).map(|i: usize| (i.wrapping_mul(2_654_435_761) >> 7) as u8).collect();
        let image = heartian_space::Rgb8Image { width, height, data };
        assert_eq!(follower.next(&image).unwrap(), None);
        assert_eq!(nets.person.probability(&image).unwrap().len(), width * height);
    }
    let empty = heartian_space::Rgb8Image { width: 0, height: 0, data: Vec::new() };
    assert_eq!(follower.next(&empty).unwrap(), None);
}

#[test]
fn installed_networks_survive_damage() {
    let Ok(directory) = crate::models::directory() else { return };
    let Ok(bytes) = std::fs::read(directory.join("face_detection_short_range.tflite")) else {
        println!("skipped: the face detection network is not installed");
        return;
    };
    for seed in 0..60usize {
        let mut broken = bytes.clone();
        for k in 0..8 {
            let at = (seed * 7919 + k * 104_729) % broken.len().min(40_000);
            let at = if k % 2 == 0 { at } else { broken.len() - 1 - at };
            broken[at] = (seed * 31 + k * 57) as u8;
        }
        survive(&broken);
    }
}
