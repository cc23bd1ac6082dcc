//! A node whose bytes change for the same inputs must have a new `REVISION`, or old cached results pass for new ones.
//!
//! `tests/golden/revisions.json` holds, for a small run of the whole pipeline, each node's action key and the digests of
//! what it made. The key holds kind, revision, parameters and the content of the inputs: under the same key other bytes
//! mean that the code changed and the revision did not. Runs with `HEARTIAN_SIMD=baseline`, so that the bytes do not
//! depend on the processor; mathematical functions of other systems may still round otherwise, so other systems skip it.
//!
//! After raising a revision, or adding a node: `HEARTIAN_BLESS=1 cargo test --test tests revisions`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use heartian_graph::Registry;
use serde::{Deserialize, Serialize};

const TINY: [&str; 6] = [
    "frames.seconds=3",
    "frames.size=64",
    "avatar.gaussians=1500",
    "avatar.steps=60",
    "residual.steps=20",
    "turntable.seconds=0.2",
];

#[derive(Debug, Deserialize, PartialEq, Serialize)]
struct Pinned {
    kind: String,
    revision: u32,
    key: String,
    outputs: BTreeMap<String, String>,
}

#[derive(Deserialize)]
struct RunFile {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
    #[serde(flatten)]
    pinned: Pinned,
}

/// The nodes of the whole pipeline, and those that only the tracking graph has.
fn run() -> BTreeMap<String, Pinned> {
    let mut nodes = run_graph("turntable", &TINY);
    for (id, node) in run_graph("track", &TINY[..2]) {
        nodes.entry(id).or_insert(node);
    }
    nodes
}

fn run_graph(name: &str, sets: &[&str]) -> BTreeMap<String, Pinned> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
    command.current_dir(folder.path()).env("HEARTIAN_SIMD", "baseline").env_remove("HEARTIAN_CACHE");
    // Nothing installed: the digests do not depend on what this machine has.
    command.env("HEARTIAN_MODELS", folder.path().join("models"));
    command.arg("run").arg(root.join(format!("graphs/{name}.ron"))).args(["--cache", "cache", "--out", "out"]);
    sets.iter().for_each(|set| {
        command.args(["--set", set]);
    });
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let file: RunFile = serde_json::from_slice(&std::fs::read(folder.path().join("out/run.json")).unwrap()).unwrap();
    file.nodes.into_iter().map(|node| (node.id, node.pinned)).collect()
}

#[test]
fn a_node_that_changes_its_bytes_raises_its_revision() {
    if !cfg!(all(target_arch = "x86_64", target_os = "linux")) {
        println!("skipped: the digests were taken on x86-64 Linux");
        return;
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/revisions.json");
    let now = run();
    if std::env::var_os("HEARTIAN_BLESS").is_some() {
        std::fs::write(path, serde_json::to_string_pretty(&now).unwrap() + "\n").unwrap();
        return;
    }
    let pinned: BTreeMap<String, Pinned> = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let mut wrong = Vec::new();
    for (id, node) in &now {
        let Some(before) = pinned.get(id).filter(|before| before.kind == node.kind) else { continue };
        if before.key == node.key && before.outputs != node.outputs {
            let (kind, revision) = (&node.kind, node.revision);
            wrong.push(format!("{kind} makes other bytes than before; raise its REVISION {revision}, then bless"));
        } else if before.key != node.key {
            println!("{}: not compared, its inputs or parameters are not those of the digests; bless", node.kind);
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The test above sees every kind of node there is, at its present revision.
#[test]
fn every_revision_is_pinned() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/revisions.json");
    let pinned: BTreeMap<String, Pinned> = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let pinned: BTreeSet<(&str, u32)> = pinned.values().map(|node| (node.kind.as_str(), node.revision)).collect();
    let missing: Vec<&str> = Registry::all_compiled_in()
        .iter()
        .filter(|kind| !pinned.contains(&(kind.kind, kind.revision)))
        .map(|kind| kind.kind)
        .collect();
    assert!(missing.is_empty(), "not pinned at their revision: {missing:?}; see the top of this file");
}
