//! Both sides of the conversation and the reader of descriptions, against bytes of every kind.
//!
//! The suite runs a few seconds of it; `HEARTIAN_FUZZ_SECONDS=600 cargo test -p heartian-graph --release plugin_fuzz --
//! --ignored --nocapture` runs it for ten minutes. What it found stands as cases of their own at the end.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::borrow::Cow;
use std::io::Cursor;
use std::time::{Duration, Instant};

use proptest::prelude::*;

use crate::registry::Registry;

use super::converse::{Broken, describe, greet, run};
use super::description::Description;
use super::frame::{Frame, FrameError, Message, Trouble, read, write};
use super::native::{Events, Job, JobInput};
use super::serve::{Served, serve};

/// Most that the outputs of a node may have here.
const LIMIT: u64 = 1 << 16;

/// Counts what it hears.
#[derive(Default)]
struct Heard {
    bytes: u64,
    outputs: u64,
    warnings: u64,
}

impl Events for Heard {
    fn output(&mut self, _: &str, _: &str, bytes: Cow<'_, [u8]>) -> bool {
        self.bytes += bytes.len() as u64;
        self.outputs += 1;
        true
    }
    fn progress(&mut self, _: u64, _: u64, _: Option<(&str, f64)>) -> bool {
        true
    }
    fn warning(&mut self, _: &str) {
        self.warnings += 1;
    }
}

/// A library that does as it is told.
struct Echo;

impl Served for Echo {
    fn describe(&self) -> Result<Vec<u8>, Trouble> {
        Ok(DESCRIPTION.as_bytes().to_vec())
    }
    fn run(&self, job: &Job<'_>, events: &mut dyn Events) -> Result<(), Trouble> {
        for input in &job.inputs {
            events.progress(1, 2, Some(("psnr_db", f64::NAN)));
            events.warning("a doubt");
            events.output(&input.port, &input.artifact, Cow::Borrowed(&input.bytes));
        }
        if job.kind.is_empty() { Err(Trouble::new("no kind")) } else { Ok(()) }
    }
}

const DESCRIPTION: &str = r#"{"format": 1, "name": "n", "version": "1", "kinds": [{"kind": "K", "revision": 1,
    "inputs": [{"name": "in", "type": "org.example.a/1", "many": true, "required": false}],
    "outputs": [{"name": "out", "type": "org.example.a/1"}],
    "params": [{"name": "p", "type": "f32", "default": 1.5, "least": 0, "greatest": 2, "unit": "s"},
               {"name": "q", "type": "String", "default": "A", "choices": ["A", "B"]},
               {"name": "r", "type": "u8", "list": true, "default": [1, 2], "keyed": false},
               {"name": "s", "type": "String", "default": "", "file": true}]}]}"#;

fn job() -> Job<'static> {
    let input = JobInput { port: "in".into(), artifact: "org.example.a/1".into(), bytes: Cow::Borrowed(b"abc") };
    Job { kind: "K", params: "{}", seed: 1, threads: 2, inputs: vec![input] }
}

fn framed(messages: &[(Message, &[u8])]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (message, body) in messages {
        write(&mut bytes, message, body).unwrap();
    }
    bytes
}

/// What a library says to the host.
fn answers() -> Vec<u8> {
    let output = Message::Output { port: "out".into(), artifact: "org.example.a/1".into() };
    framed(&[
        (Message::Progress { step: 1, total: 2, metric: Some(("m".into(), f64::NAN.to_bits())) }, b""),
        (Message::Warning { text: "hm".into() }, b""),
        (output, b"some bytes of an output"),
        (Message::Failed(Trouble::new("no").remedy("do")), b""),
        (Message::Done, b""),
    ])
}

/// What a host says to a library.
fn requests() -> Vec<u8> {
    let mut bytes = framed(&[(Message::Describe, b"")]);
    run(&mut Cursor::new(answers()), &mut bytes, &job(), (LIMIT, &mut Heard::default())).unwrap().unwrap_err();
    bytes
}

/// Everything that reads foreign bytes, on these bytes.
fn read_all(bytes: &[u8]) {
    let mut heard = Heard::default();
    let _ = run(&mut Cursor::new(bytes), &mut Vec::new(), &job(), (LIMIT, &mut heard));
    assert!(heard.bytes <= LIMIT && heard.outputs <= LIMIT / 64 + 1 && heard.warnings <= 1000);
    let _ = greet(&mut Cursor::new(bytes));
    let _ = describe(&mut Cursor::new(bytes), &mut Vec::new());
    let _ = serve(&mut Cursor::new(bytes), &mut Vec::new(), &Echo);
    if let Ok(description) = Description::read(bytes) {
        let _ = description.kinds(&Registry::default());
    }
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let word = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        word ^ (word >> 31)
    }
    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// A valid text with a few changes: bytes set, flipped, removed, doubled, numbers made great, two texts spliced.
fn mutated(seeds: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    let mut bytes = seeds[random.below(seeds.len())].clone();
    for _ in 0..=random.below(6) {
        let at = random.below(bytes.len());
        let end = (at + random.below(24)).min(bytes.len());
        match random.below(7) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..end)),
            2 => bytes.extend_from_within(at..end),
            3 if !bytes.is_empty() => bytes[at] = random.next() as u8,
            4 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            5 => bytes[at..end].fill(*[0x00, 0xff, b'9', b'"'].get(random.below(4)).unwrap_or(&0)),
            _ => {
                let other = &seeds[random.below(seeds.len())];
                bytes.splice(at..end, other[random.below(other.len())..].iter().copied());
            }
        }
    }
    bytes
}

fn seeds() -> Vec<Vec<u8>> {
    vec![answers(), requests(), framed(&[(Message::Ready, b"")]), DESCRIPTION.as_bytes().to_vec()]
}

fn fuzz(duration: Duration) -> u64 {
    let (seeds, start, mut random, mut rounds) = (seeds(), Instant::now(), Random(rounds_seed()), 0);
    while start.elapsed() < duration {
        for _ in 0..256 {
            read_all(&mutated(&seeds, &mut random));
        }
        rounds += 256;
    }
    rounds
}

/// Every run goes elsewhere; the number is printed when one fails.
fn rounds_seed() -> u64 {
    let named = std::env::var("HEARTIAN_FUZZ_SEED").ok().and_then(|seed| seed.parse().ok());
    let seed = named.unwrap_or_else(|| std::time::UNIX_EPOCH.elapsed().unwrap_or_default().as_nanos() as u64);
    println!("HEARTIAN_FUZZ_SEED={seed}");
    seed
}

#[test]
fn plugin_fuzz_for_a_moment() {
    fuzz(Duration::from_millis(500));
}

#[test]
#[ignore = "long; HEARTIAN_FUZZ_SECONDS says how long"]
fn plugin_fuzz_for_long() {
    let seconds = std::env::var("HEARTIAN_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok()).unwrap_or(600);
    println!("{} inputs", fuzz(Duration::from_secs(seconds)));
}

fn any_message() -> impl Strategy<Value = Message> {
    let text = || ".{0,20}";
    prop_oneof![
        Just(Message::Describe),
        Just(Message::Ready),
        Just(Message::Done),
        (text(), text(), any::<u64>(), any::<u32>(), any::<usize>())
            .prop_map(|(kind, params, seed, threads, inputs)| Message::Run { kind, params, seed, threads, inputs }),
        (text(), text()).prop_map(|(port, artifact)| Message::Output { port, artifact }),
        (any::<u64>(), any::<u64>(), any::<Option<u64>>(), text()).prop_map(|(step, total, bits, name)| {
            Message::Progress { step, total, metric: bits.map(|bits| (name, bits)) }
        }),
        (text(), any::<Option<bool>>(), any::<bool>()).prop_map(|(message, remedy, cancelled)| {
            let remedy = remedy.map(|word| word.to_string());
            Message::Failed(Trouble { message, remedy, parameter: None, cancelled })
        }),
    ]
}

proptest! {
    #[test]
    fn frames_survive_a_round_trip(message in any_message(), body in prop::collection::vec(any::<u8>(), 0..200)) {
        let bytes = framed(&[(message.clone(), &body), (Message::Ready, b"")]);
        let mut reader = Cursor::new(bytes);
        prop_assert_eq!(read(&mut reader, 200).unwrap(), Frame { message, body });
        prop_assert_eq!(read(&mut reader, 0).unwrap().message, Message::Ready);
        prop_assert!(matches!(read(&mut reader, 0), Err(FrameError::Closed)));
    }

    #[test]
    fn any_bytes_are_read_without_harm(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        read_all(&bytes);
        read_all(&[&b"HtP1"[..], &bytes].concat());
    }
}

/// A length that is claimed is not believed.
#[test]
fn a_claimed_length_costs_nothing() {
    let mut bytes = framed(&[(Message::Done, b"")]);
    bytes[8..16].copy_from_slice(&(u64::MAX / 2).to_le_bytes());
    assert!(matches!(read(&mut Cursor::new(&bytes), u64::MAX), Err(FrameError::Closed)));
    assert!(matches!(read(&mut Cursor::new(&bytes), LIMIT), Err(FrameError::Malformed(_))));
    bytes[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(read(&mut Cursor::new(&bytes), u64::MAX), Err(FrameError::Malformed(_))));
    let flood = framed(&vec![(Message::Output { port: String::new(), artifact: String::new() }, &b""[..]); 5000]);
    let mut heard = Heard::default();
    let ended = run(&mut Cursor::new(flood), &mut Vec::new(), &job(), (LIMIT, &mut heard));
    assert!(heard.outputs <= LIMIT / 64 + 1, "{ended:?} after {} outputs", heard.outputs);
}

/// The two sides understand one another.
#[test]
fn a_conversation_ends_well() {
    let mut answer = Vec::new();
    serve(&mut Cursor::new(requests()), &mut answer, &Echo).unwrap();
    let mut reader = Cursor::new(answer);
    greet(&mut reader).unwrap().unwrap();
    let document = describe(&mut reader, &mut Vec::new()).unwrap().unwrap();
    assert_eq!(Description::read(&document).unwrap().kinds(&Registry::default()).unwrap().len(), 1);
    let mut heard = Heard::default();
    run(&mut reader, &mut Vec::new(), &job(), (LIMIT, &mut heard)).unwrap().unwrap();
    assert_eq!((heard.bytes, heard.outputs, heard.warnings), (3, 1, 1));
    assert!(matches!(greet(&mut reader), Err(Broken::Gone)));
}
