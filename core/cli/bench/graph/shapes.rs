//! The graphs that are measured, as RON, and a Makefile of the same shape.

use std::fmt::Write;

/// One block: a → b → c → {d, e, f} → g → h → i → j, each node with what it reads.
const BLOCK: [(&str, &[&str]); 10] = [
    ("a", &[]),
    ("b", &["a"]),
    ("c", &["b"]),
    ("d", &["c"]),
    ("e", &["c"]),
    ("f", &["c"]),
    ("g", &["d", "e", "f"]),
    ("h", &["g"]),
    ("i", &["h"]),
    ("j", &["i"]),
];

/// How blocks hang together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Each block's `a` reads the last one's `j`.
    Deep,
    /// Blocks know nothing of each other.
    Wide,
}

impl Shape {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Deep => "deep",
            Self::Wide => "wide",
        }
    }
}

/// Every node of some blocks: its id, what it reads, and a seed of its own.
fn nodes(blocks: usize, shape: Shape) -> impl Iterator<Item = (String, Vec<String>, usize)> {
    (0..blocks).flat_map(move |block| {
        BLOCK.iter().enumerate().map(move |(index, (id, from))| {
            let mut from: Vec<String> = from.iter().map(|id| format!("{id}{block}")).collect();
            if index == 0 && block > 0 && shape == Shape::Deep {
                from.push(format!("j{}", block - 1));
            }
            (format!("{id}{block}"), from, block * BLOCK.len() + index + 1)
        })
    })
}

/// Blocks of `Blob` nodes of so many bytes each.
pub fn blocks(blocks: usize, shape: Shape, bytes: u64) -> String {
    graph(shape.name(), nodes(blocks, shape), bytes)
}

/// A chain of so many `Blob` nodes.
pub fn chain(length: usize, bytes: u64) -> String {
    let nodes = (0..length).map(|at| {
        let from = at.checked_sub(1).map(|before| format!("n{before}"));
        (format!("n{at}"), from.into_iter().collect(), at + 1)
    });
    graph("chain", nodes, bytes)
}

fn graph(name: &str, nodes: impl Iterator<Item = (String, Vec<String>, usize)>, bytes: u64) -> String {
    let mut text = format!("Graph(\n    name: \"{name}\",\n    nodes: {{\n");
    for (id, from, seed) in nodes {
        let from: Vec<String> = from.iter().map(|id| format!("\"{id}.out\"")).collect();
        let inputs =
            if from.is_empty() { String::new() } else { format!(", inputs: {{\"in\": [{}]}}", from.join(", ")) };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "        \"{id}\": (kind: \"Blob\", params: (bytes: {bytes}, seed: {seed}){inputs}),");
    }
    text + "    },\n)\n"
}

/// The same blocks for make: a node's recipe reads its inputs and writes as many bytes.
pub fn makefile(blocks: usize, shape: Shape, bytes: u64) -> String {
    let mut rules = String::new();
    let mut all = String::from("all:");
    for (id, from, _) in nodes(blocks, shape) {
        let _ = write!(all, " {id}.bin");
        let from: Vec<String> = from.iter().map(|id| format!("{id}.bin")).collect();
        let from = from.join(" ");
        let _ =
            writeln!(rules, "{id}.bin: {from}\n\t@cat {from} /dev/null > /dev/null; head -c {bytes} /dev/zero > $@");
    }
    format!("{all}\n{rules}")
}
