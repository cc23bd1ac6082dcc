//! Seeded mutation of what comes from outside: graph files, command-line settings, artifacts. Nothing may panic, hang or
//! take memory beyond measure, whatever the bytes.
//!
//! A short round is part of the suite. The long one: `HEARTIAN_FUZZ_MINUTES=10 cargo test -p heartian-graph --test tests
//! -- --ignored fuzz --nocapture`. Inputs once found to be trouble are kept in `KEPT`.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use heartian_artifact::{Artifact, Bundle, BundleReader};
use heartian_graph::{Files, Graph, GraphError, Problem, Sweep};

use crate::nodes::{Numbers, registry};

/// One input may take this long, on a busy machine.
const SLOW: Duration = Duration::from_secs(5);
/// Inputs grow no longer.
const LONGEST: usize = 1 << 16;
/// Executions of the short round.
const SHORT: u64 = 20_000;

/// Texts that were trouble once, or that look like it.
const KEPT: [&str; 12] = [
    "Graph(extends: \"/dev/zero\")",
    "Graph(extends: \".\")",
    "(nodes: {\"a\": (kind: \"/dev/zero.ron\")})",
    "(nodes: {\"a\": (kind: \"p.ron\"), \"b\": (kind: \"p.ron\", inputs: {\"x\": \"a.b\"})}, exports: [\"a.x\"])",
    "(params: {\"a\": $a}, nodes: {\"a\": (kind: \"Constant\", params: (values: $a, label: \"$a\"))})",
    "(inputs: {\"n\": \"numbers\"}, exports: {\"n\": \"$n\"}, nodes: {\"a\": (kind: \"Add\", inputs: {\"numbers\": $n})})",
    "(nodes: {\"a\": (kind: \"Constant\", params: (values: [1e999, -inf, NaN, 0x, 1__2, 0b12])))})",
    "(nodes: {\"a\": (kind: \"Constant\", params: (threads: 340282366920938463463374607431768211456))})",
    "(seed: 18446744073709551616, nodes: {\"a\": (kind: \"Maybe\")}, exports: [\".\", \"a.\", \".a\", \"a..b\", \"\"])",
    "\u{feff}(nodes: {\"\u{202e}a\": (kind: \"Maybe\")})",
    "(nodes: {\"a\": (kind: \"Sum\", inputs: {\"terms\": [\"a.numbers\", \"a.numbers\"], \"extra\": \"a.numbers\"})})",
    "$",
];

/// SplitMix64: small, and the same everywhere.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.roll() % limit.max(1) as u64) as usize
    }

    /// One seed, changed one to eight times.
    fn mutate(&mut self, seeds: &[Vec<u8>], words: &[&[u8]]) -> Vec<u8> {
        let mut bytes = seeds[self.below(seeds.len())].clone();
        for _ in 0..=self.below(8) {
            let at = self.below(bytes.len() + 1);
            let end = (at + self.below(32)).min(bytes.len());
            match self.below(8) {
                0 if at < bytes.len() => bytes[at] ^= 1 << self.below(8),
                1 if at < bytes.len() => bytes[at] = self.roll() as u8,
                2 => drop(bytes.drain(at..end)),
                3 => drop(bytes.splice(at..at, words[self.below(words.len())].iter().copied())),
                4 => drop(bytes.splice(at..end, words[self.below(words.len())].iter().copied())),
                5 => {
                    let piece = bytes[at..end].to_vec();
                    let to = self.below(bytes.len() + 1);
                    bytes.splice(to..to, piece.repeat(1 + self.below(20)));
                }
                6 => {
                    let other = &seeds[self.below(seeds.len())];
                    let from = self.below(other.len() + 1);
                    bytes.truncate(at);
                    bytes.extend_from_slice(&other[from..]);
                }
                _ => bytes.truncate(end),
            }
        }
        bytes.truncate(LONGEST);
        bytes
    }
}

/// Feeds mutated seeds to `target`: so many, or for so many minutes. Gives how many.
fn campaign(seeds: &[Vec<u8>], words: &[&[u8]], long: bool, target: &dyn Fn(&[u8])) -> u64 {
    let minutes = std::env::var("HEARTIAN_FUZZ_MINUTES").ok().and_then(|text| text.parse::<f64>().ok()).unwrap_or(10.0);
    let seed = std::env::var("HEARTIAN_FUZZ_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(1);
    let (start, mut dice, mut done) = (Instant::now(), Dice(seed), 0u64);
    let go_on = |done: u64| if long { start.elapsed().as_secs_f64() < minutes * 60.0 } else { done < SHORT };
    while go_on(done) {
        let input = dice.mutate(seeds, words);
        let begun = Instant::now();
        let survived = catch_unwind(AssertUnwindSafe(|| target(&input))).is_ok();
        let shown = String::from_utf8_lossy(&input);
        assert!(survived, "execution {done} panicked on {input:?}\n{shown}");
        // Once may be the machine's doing; three times is the input's.
        let again = || {
            let begun = Instant::now();
            target(&input);
            begun.elapsed() >= SLOW
        };
        assert!(begun.elapsed() < SLOW || !(again() && again()), "execution {done} is slow on {shown}");
        done += 1;
    }
    let peak = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = peak.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("peak memory unknown").to_owned();
    println!("{done} executions in {:.1} min, {peak}", start.elapsed().as_secs_f64() / 60.0);
    done
}

fn read_graph(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let problems = match Graph::parse("p.ron", &text) {
        Ok(mut graph) => {
            let setting: String = text.chars().rev().take(24).collect();
            graph.set(&format!("a.{setting}"));
            graph.set(&setting);
            graph.plan(&registry(), &[]).err()
        }
        Err(GraphError::Problems(problems)) => Some(problems),
        Err(_) => None,
    };
    // One line shows every place; the full report is slow and is drawn for the first only.
    let lines: Vec<String> = problems.iter().flat_map(|problems| &problems.0).take(50).map(Problem::one_line).collect();
    assert!(problems.is_none() || !lines.is_empty());
    if let Some(problem) = problems.as_ref().and_then(|problems| problems.0.first()) {
        let mut shown = String::new();
        let theme = miette::GraphicalTheme::unicode_nocolor();
        miette::GraphicalReportHandler::new_themed(theme).render_report(&mut shown, problem).unwrap();
    }
    let _ = Sweep::parse(&[text.chars().take(200).collect()], false);
}

fn read_artifact(bytes: &[u8]) {
    let Ok(reader) = BundleReader::new(bytes) else { return };
    for name in reader.tensor_names() {
        // What is read can hold no more than the file does.
        let sizes = [
            reader.tensor::<u8>(&name).map(|(_, values)| values.len()),
            reader.tensor::<f32>(&name).map(|(_, values)| values.len() * 4),
            reader.tensor::<f64>(&name).map(|(_, values)| values.len() * 8),
            reader.tensor::<u16>(&name).map(|(_, values)| values.len() * 2),
        ];
        assert!(sizes.into_iter().flatten().all(|size| size <= bytes.len()), "{name}");
    }
    let _ = reader.meta::<Vec<String>>("label");
    let _ = Files::from_bundle(reader);
    let _ = BundleReader::new(bytes).map(Numbers::from_bundle);
}

fn graph_seeds() -> Vec<Vec<u8>> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../graphs");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().flatten().map(|entry| entry.path()).collect();
    files.sort();
    let texts = files.iter().filter(|path| path.extension().is_some_and(|end| end == "ron"));
    let mut seeds: Vec<Vec<u8>> = texts.map(|path| std::fs::read(path).unwrap()).collect();
    seeds.extend(KEPT.iter().map(|text| text.as_bytes().to_vec()));
    seeds.push(
        br#"Graph(name: "n", params: {"x": 1.5}, nodes: {
            "a": (kind: "Constant", params: (values: [1, -2.5e3, $x], label: Some("\u{e9}\n"), threads: 0xff)),
            "b": (kind: "Add", params: (amount: $x, rounding: Down), inputs: {"numbers": "a.numbers"}), // end
            "c": (kind: "Sum", inputs: {"terms": ["a.numbers", "b.numbers"], "extra": "b.numbers"}), /* end */
        }, exports: {"sum": "c.numbers"})"#
            .to_vec(),
    );
    seeds
}

fn artifact_seeds() -> Vec<Vec<u8>> {
    let (bytes, words, floats) = ([1u8, 2, 3, 4, 5, 6], [7u16, 8], [0.5f64, f64::NAN]);
    let plain = Bundle::new().tensor("b", &[2, 3], &bytes).unwrap().tensor("w", &[2, 1], &words).unwrap();
    let plain = plain.meta("label", &["x", "y"]).unwrap().to_bytes().unwrap();
    let files = Files::new().with("a/b.txt", b"text".to_vec()).unwrap().to_bundle().unwrap().to_bytes().unwrap();
    let numbers = Bundle::new().tensor("values", &[2], &floats).unwrap().to_bytes().unwrap();
    vec![plain, files, numbers, Bundle::new().to_bytes().unwrap(), vec![0; 8], vec![255; 16]]
}

const GRAPH_WORDS: [&[u8]; 30] = [
    b"(",
    b")",
    b"[",
    b"]",
    b"{",
    b"}",
    b":",
    b",",
    b"\"",
    b"\\",
    b"$",
    b"$x",
    b"\"$x\"",
    b"nodes",
    b"kind",
    b"params",
    b"inputs",
    b"exports",
    b"extends",
    b"remove",
    b"\"a.numbers\"",
    b"\"p.ron\"",
    b"r#\"",
    b"/*",
    b"//",
    b"-1e400",
    b"0x",
    b"\xf0\x9f",
    b"Some(",
    b"'",
];
const ARTIFACT_WORDS: [&[u8]; 12] = [
    b"\"shape\":[18446744073709551615,2]",
    b"\"dtype\":\"F64\"",
    b"\"data_offsets\":[0,18446744073709551615]",
    b"[",
    b"{",
    b"\"__metadata__\":{\"heartian\":\"{}\"}",
    b"\\u0000",
    b"\xff\xff\xff\xff\xff\xff\xff\x7f",
    b"\0\0\0\0\0\0\0\0",
    b"0",
    b"\"",
    b"../x",
];

#[test]
fn mutated_graphs_are_read_or_refused() {
    KEPT.iter().for_each(|text| read_graph(text.as_bytes()));
    assert_eq!(campaign(&graph_seeds(), &GRAPH_WORDS, false, &read_graph), SHORT);
}

#[test]
fn mutated_artifacts_are_read_or_refused() {
    assert_eq!(campaign(&artifact_seeds(), &ARTIFACT_WORDS, false, &read_artifact), SHORT);
    // Deep JSON in the metadata, and a header that promises more than there is.
    let deep = format!("{{\"__metadata__\":{{\"heartian\":\"{{\\\"a\\\":{}\"}}}}", "[".repeat(50_000));
    let mut bytes = (deep.len() as u64).to_le_bytes().to_vec();
    bytes.extend(deep.as_bytes());
    assert!(BundleReader::new(&bytes).is_err());
    assert!(BundleReader::new(&(99_000_000u64).to_le_bytes()).is_err());
}

#[test]
#[ignore = "takes HEARTIAN_FUZZ_MINUTES, 10 unless told"]
fn fuzz_graphs() {
    assert!(campaign(&graph_seeds(), &GRAPH_WORDS, true, &read_graph) > 0);
}

#[test]
#[ignore = "takes HEARTIAN_FUZZ_MINUTES, 10 unless told"]
fn fuzz_artifacts() {
    assert!(campaign(&artifact_seeds(), &ARTIFACT_WORDS, true, &read_artifact) > 0);
}
