//! Real processes on one cache: killed at any moment, started together, and out of room.
//!
//! The child is this test program itself, told by an environment variable which cache to run on.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use heartian_graph::{Cache, Run, RunOptions};

use crate::bulk::block;
use crate::nodes::Bench;
use crate::parallel::bulk_plan;

const CACHE: &str = "HEARTIAN_TEST_CACHE";
const PARAMS: &str = "HEARTIAN_TEST_PARAMS";
/// Some work, some bytes, states on the way: about a tenth of a second.
const WORK: &str = "bytes: 60000, steps: 4, pause: 2";
const KILLS: u32 = 50;

/// Does nothing unless it is the child.
#[test]
fn child() {
    let (Ok(cache), Ok(params)) = (std::env::var(CACHE), std::env::var(PARAMS)) else { return };
    let cache = Cache::open(Path::new(&cache)).unwrap();
    let plan = bulk_plan(&block(&params), &[]);
    let options = RunOptions { jobs: 2, checkpoint_every: Duration::ZERO, keep_going: true, ..RunOptions::default() };
    for report in Run::prepare(&plan, &cache).execute(&options) {
        let digest = report.outputs.get("out").map_or("none".to_owned(), ToString::to_string);
        println!("NODE {} {} {digest}", report.id, report.status.word());
        if let Some(error) = report.error {
            println!("ERROR {}", error.message);
        }
    }
}

fn prepare(bench: &Bench, params: &str, mut command: Command) -> Command {
    command.args(["--exact", "processes::child", "--nocapture"]).env(CACHE, bench.cache.root()).env(PARAMS, params);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

fn start(bench: &Bench) -> Child {
    prepare(bench, WORK, Command::new(std::env::current_exe().unwrap())).spawn().unwrap()
}

/// Status and digest by node.
fn said(text: &str) -> BTreeMap<String, (String, String)> {
    let lines = text.lines().filter_map(|line| line.split_once("NODE ")).map(|(_, rest)| rest);
    lines
        .map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            (words[0].to_owned(), (words[1].to_owned(), words[2].to_owned()))
        })
        .collect()
}

fn finish(child: Child) -> BTreeMap<String, (String, String)> {
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let found = said(&String::from_utf8(output.stdout).unwrap());
    assert_eq!(found.len(), 10);
    found
}

fn digests(nodes: &BTreeMap<String, (String, String)>) -> Vec<&str> {
    nodes.values().map(|(_, digest)| digest.as_str()).collect()
}

fn count(nodes: &BTreeMap<String, (String, String)>, status: &str) -> usize {
    nodes.values().filter(|(found, _)| found == status).count()
}

#[test]
fn a_run_killed_at_any_moment_leaves_a_cache_that_the_next_run_uses() {
    let whole = Bench::new();
    let begun = Instant::now();
    let expected = finish(start(&whole));
    let seconds = begun.elapsed().as_secs_f64();
    assert_eq!(count(&expected, "ran"), 10);
    let mut random = 20u64;
    let mut cut = [0; 3];
    let mut bench = Bench::new();
    for kill in 0..KILLS {
        // Every other kill meets what earlier ones left; the others a cold cache.
        if kill % 2 == 0 {
            bench = Bench::new();
        }
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let share = (random >> 40) as f64 / f64::from(1 << 24);
        let mut child = start(&bench);
        std::thread::sleep(Duration::from_secs_f64(share * seconds));
        child.kill().unwrap();
        child.wait().unwrap();
        let left = bench.cache.verify();
        assert!(left.damaged_artifacts.is_empty() && left.damaged_records.is_empty(), "{left:?}");
        cut[if left.records == 0 { 0 } else { 1 + usize::from(left.records == 10) }] += 1;
        if kill % 2 == 1 || kill % 4 == 0 {
            let next = finish(start(&bench));
            assert_eq!(digests(&next), digests(&expected));
            assert!(count(&next, "hit") as u64 >= left.records, "{next:?} after {left:?}");
        }
    }
    println!("killed before the first node was finished, between, after the last: {cut:?}");
    assert!(cut[1] > 0, "no kill met a run in the middle: {cut:?}");
}

#[test]
fn two_runs_started_together_compute_each_node_once() {
    for _ in 0..3 {
        let bench = Bench::new();
        let both = [start(&bench), start(&bench)].map(finish);
        assert_eq!(digests(&both[0]), digests(&both[1]));
        let ran: usize = both.iter().map(|nodes| count(nodes, "ran")).sum();
        assert_eq!(ran, 10, "{both:?}");
    }
}

/// The shell's limit on the size of files makes the system refuse to write more, as a full disk does.
#[cfg(unix)]
#[test]
fn out_of_room_is_a_clean_error() {
    let bench = Bench::new();
    let mut shell = Command::new("sh");
    shell.args(["-c", "trap '' XFSZ; ulimit -f 64; exec \"$0\" \"$@\""]).arg(std::env::current_exe().unwrap());
    let output = prepare(&bench, "bytes: 300000", shell).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let nodes = said(&text);
    assert_eq!((count(&nodes, "failed"), count(&nodes, "skipped")), (1, 9), "{text}");
    assert!(text.contains("ERROR the cache cannot write"), "{text}");
    let left = bench.cache.usage();
    assert_eq!((left.artifacts, left.unused, left.records), (0, 0, 0), "nothing half written");
    assert_eq!(std::fs::read_dir(bench.cache.root().join("tmp")).unwrap().count(), 0);
    let child = prepare(&bench, "bytes: 300000", Command::new(std::env::current_exe().unwrap())).spawn().unwrap();
    assert_eq!(count(&finish(child), "ran"), 10);
}
