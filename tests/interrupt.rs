//! Ctrl-C and `kill -9` on the command itself, in the middle of a long node.
#![cfg(unix)]

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// A training that takes longer than the test lets it, after a recording that does not.
const SETS: [&str; 4] = ["frames.seconds=2", "frames.size=48", "avatar.gaussians=300", "avatar.steps=100000"];

struct Bench(tempfile::TempDir);

impl Bench {
    fn command(&self, sets: &[&str]) -> Command {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
        command.current_dir(self.0.path()).arg("run").arg(root.join("graphs/full.ron"));
        command.args(["--target", "avatar", "--cache", "cache", "--out", "out", "--checkpoint-every", "0"]);
        for set in sets {
            command.args(["--set", set]);
        }
        command
    }

    /// Starts the training, and waits until it keeps states.
    fn training(&self, sets: &[&str]) -> Child {
        let child = self.command(sets).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let begun = Instant::now();
        while self.states() == 0 {
            assert!(begun.elapsed() < Duration::from_secs(120), "it never keeps a state");
            std::thread::sleep(Duration::from_millis(20));
        }
        child
    }

    /// Digests of what the training made.
    fn made(&self) -> Value {
        let record = std::fs::read(self.0.path().join("out/run.json")).unwrap();
        let record: Value = serde_json::from_slice(&record).unwrap();
        record["nodes"].as_array().unwrap().iter().find(|node| node["id"] == "avatar").unwrap()["outputs"].clone()
    }

    fn states(&self) -> usize {
        let shards = std::fs::read_dir(self.0.path().join("cache/checkpoints")).into_iter().flatten().flatten();
        shards.map(|shard| std::fs::read_dir(shard.path()).into_iter().flatten().count()).sum()
    }
}

#[test]
fn ctrl_c_keeps_what_is_finished_and_ends_soon() {
    let bench = Bench(tempfile::tempdir().unwrap());
    let mut child = bench.training(&SETS);
    let asked = Instant::now();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let status = child.wait().unwrap();
    println!("ended {:?} after Ctrl-C", asked.elapsed());
    // A second is promised; a busy machine is forgiven some more.
    assert!(asked.elapsed() < Duration::from_secs(10), "{:?}", asked.elapsed());
    assert_eq!(status.code(), Some(130));
    assert_eq!(bench.states(), 1, "the training's state is kept");
    let again = bench.command(&[&SETS[..3], &["avatar.steps=20"]].concat()).output().unwrap();
    assert!(again.status.success(), "{}", String::from_utf8_lossy(&again.stderr));
    let metrics = std::fs::read(bench.0.path().join("out/metrics.json")).unwrap();
    let metrics: Value = serde_json::from_slice(&metrics).unwrap();
    let status =
        |id| metrics["nodes"].as_array().unwrap().iter().find(|node| node["id"] == id).unwrap()["status"].clone();
    assert_eq!([status("frames"), status("track"), status("avatar")], ["hit", "hit", "ran"]);
}

#[test]
fn a_killed_training_goes_on_and_makes_the_same_bytes() {
    let sets = [&SETS[..3], &["avatar.steps=400"]].concat();
    let (cut, whole) = (Bench(tempfile::tempdir().unwrap()), Bench(tempfile::tempdir().unwrap()));
    let mut child = cut.training(&sets);
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(cut.states(), 1, "it was killed on its way");
    for bench in [&cut, &whole] {
        let output = bench.command(&sets).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(bench.states(), 0);
    }
    assert!(whole.made().as_object().is_some_and(|outputs| outputs.len() == 2));
    assert_eq!(cut.made(), whole.made());
}
