//! Looking after a cache: listing, checking every byte, making room, and auditing nodes.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};

use heartian_graph::{
    Context, GcOptions, Graph, Inputs, Node, NodeError, NodeKind, Outputs, Port, Registry, Run, RunOptions, Status,
    Verdict, params,
};

use crate::bulk::{Bytes, block};
use crate::nodes::{Bench, Done, cache_files};
use crate::parallel::bulk_plan;

fn run(bench: &Bench, params: &str) -> Done {
    bench.run_plan(&bulk_plan(&block(params), &[]), &RunOptions::default())
}

fn flip_last_byte(path: &std::path::Path) {
    let modified = std::fs::metadata(path).unwrap().modified().unwrap();
    let mut bytes = std::fs::read(path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(path, bytes).unwrap();
    std::fs::File::options().write(true).open(path).unwrap().set_modified(modified).unwrap();
}

/// Size and modification time are as before; the run looks at the change time, which cannot be set back.
#[cfg(unix)]
#[test]
fn a_flipped_byte_is_noticed_and_only_its_node_runs() {
    let bench = Bench::new();
    let first = run(&bench, "bytes: 100000");
    let d = first.reports.iter().find(|report| &*report.id == "d").unwrap().outputs["out"];
    flip_last_byte(&bench.cache.blob_path(&d));
    let again = run(&bench, "bytes: 100000");
    assert_eq!(again.statuses(), "a:hit b:hit c:hit d:ran e:hit f:hit g:hit h:hit i:hit j:hit");
    assert_eq!(run(&bench, "bytes: 100000").count(Status::Hit), 10);
}

/// The same where the change time tells nothing: what a node reads is digested, always.
#[test]
fn a_flipped_byte_is_noticed_when_it_is_read() {
    let bench = Bench::new();
    let first = run(&bench, "bytes: 1000");
    let path = bench.cache.blob_path(&first.reports[3].outputs["out"]);
    flip_last_byte(&path);
    assert!(bench.cache.open_verified(&first.reports[3].outputs["out"]).unwrap().is_none());
    assert!(!path.exists());
}

#[test]
fn a_node_that_writes_the_same_bytes_stops_the_rerun() {
    let bench = Bench::new();
    run(&bench, "bytes: 1000");
    let changed = bench.run_plan(&bulk_plan(&block("bytes: 1000"), &["c.flavour=7"]), &RunOptions::default());
    assert_eq!(changed.statuses(), "a:hit b:hit c:ran d:hit e:hit f:hit g:hit h:hit i:hit j:hit");
}

#[test]
fn everything_is_listed_and_counted() {
    let bench = Bench::new();
    run(&bench, "bytes: 1000");
    let entries = bench.cache.entries();
    assert_eq!(entries.len(), 10);
    assert!(entries.iter().all(|entry| entry.kind == "Bulk" && entry.size() > 1000));
    let usage = bench.cache.usage();
    let files: u64 = cache_files(&bench).values().map(|bytes| bytes.len() as u64).sum();
    assert_eq!(usage.total(), files);
    assert_eq!((usage.kinds["Bulk"], usage.unused), ((10, usage.artifacts), 0));
    assert!(bench.cache.typical_seconds()["Bulk"] >= 0.0);
}

#[test]
fn a_check_finds_every_damage_and_removes_it() {
    let bench = Bench::new();
    let first = run(&bench, "bytes: 1000");
    let digest = first.reports[4].outputs["out"];
    flip_last_byte(&bench.cache.blob_path(&digest));
    let key = first.reports[6].key.unwrap();
    let record =
        cache_files(&bench).into_keys().find(|path| path.to_string_lossy().contains(&key.to_string())).unwrap();
    flip_last_byte(&record);
    let report = bench.cache.verify();
    assert_eq!((report.records, report.artifacts, report.incomplete_records), (10, 10, 1));
    assert_eq!((report.damaged_artifacts, report.damaged_records), (vec![digest], vec![key]));
    let report = bench.cache.verify();
    assert_eq!((report.records, report.artifacts), (9, 9));
    assert!(report.damaged_artifacts.is_empty() && report.damaged_records.is_empty());
    assert_eq!(run(&bench, "bytes: 1000").count(Status::Ran), 2);
}

#[test]
fn room_is_made_by_runs_and_by_size() {
    let bench = Bench::new();
    for bytes in [1000, 2000, 3000] {
        run(&bench, &format!("bytes: {bytes}"));
        // Runs are told apart by time.
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    run(&bench, "bytes: 1000");
    let dry = bench.cache.gc(&GcOptions { keep_runs: Some(1), dry_run: true, ..GcOptions::default() });
    assert_eq!((dry.dropped_records, dry.dropped_artifacts), (20, 20));
    assert_eq!(bench.cache.entries().len(), 30, "a dry run drops nothing");
    let by_size = bench.cache.gc(&GcOptions { max_bytes: Some(43_000), ..GcOptions::default() });
    // 10 × about 1 kB used last and 10 × 3 kB fit, the 2 kB ones were used longest ago.
    assert!(by_size.kept_bytes <= 43_000 && by_size.dropped_records == 10, "{by_size:?}");
    assert_eq!(run(&bench, "bytes: 3000").count(Status::Hit), 10);
    let by_runs = bench.cache.gc(&GcOptions { keep_runs: Some(1), ..GcOptions::default() });
    assert_eq!((by_runs.dropped_records, by_runs.kept_records), (10, 10));
    assert_eq!(run(&bench, "bytes: 3000").count(Status::Hit), 10);
    let nothing = bench.cache.gc(&GcOptions { max_bytes: Some(0), ..GcOptions::default() });
    assert_eq!((nothing.kept_records, nothing.kept_bytes), (0, 0));
    assert_eq!(run(&bench, "bytes: 3000").count(Status::Ran), 10);
}

/// Collecting everything that can be collected, again and again, while a run goes on: it ends right.
#[test]
fn making_room_beside_a_run_harms_it_not() {
    let (bench, whole) = (Bench::new(), Bench::new());
    let expected = run(&whole, "bytes: 20000");
    let (started, ended) = (AtomicU64::new(0), AtomicU64::new(0));
    let done = std::thread::scope(|scope| {
        scope.spawn(|| {
            while ended.load(Ordering::Relaxed) == 0 {
                bench.cache.gc(&GcOptions { keep_runs: Some(0), max_bytes: Some(0), dry_run: false });
                started.fetch_add(1, Ordering::Relaxed);
            }
        });
        while started.load(Ordering::Relaxed) == 0 {
            std::thread::yield_now();
        }
        let done = run(&bench, "bytes: 20000, steps: 5, pause: 2");
        ended.store(1, Ordering::Relaxed);
        done
    });
    assert_eq!(done.count(Status::Ran), 10, "{} {:?}", done.statuses(), done.problems);
    let steps = whole.run_plan(&bulk_plan(&block("bytes: 20000, steps: 5"), &[]), &RunOptions::default());
    let outputs = |done: &Done| done.reports.iter().map(|report| report.outputs.clone()).collect::<Vec<_>>();
    assert_eq!(outputs(&done), outputs(&steps));
    assert_ne!(outputs(&done), outputs(&expected));
}

params! {
    /// Never gives the same bytes twice.
    pub struct Dice {}
}

impl Node for Dice {
    const KIND: &'static str = "Dice";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one::<Bytes>("out", "The bytes.")];
    fn run(&self, _: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        static THROWS: AtomicU64 = AtomicU64::new(0);
        Ok(Outputs::new().put("out", Bytes(THROWS.fetch_add(1, Ordering::Relaxed).to_le_bytes().to_vec())))
    }
}

#[test]
fn an_audit_finds_the_node_that_is_no_function() {
    let bench = Bench::new();
    let registry = Registry::of([NodeKind::of::<crate::bulk::Bulk>(), NodeKind::of::<Dice>()]);
    let text = block("bytes: 100").replace("nodes: {", "nodes: {\"dice\": (kind: \"Dice\"),");
    let text = text.replace("\"in\": []", "\"in\": [\"dice.out\"]");
    let plan = Graph::parse("audit.ron", &text).unwrap().plan(&registry, &[]).unwrap_or_else(|_| panic!());
    let run = Run::prepare(&plan, &bench.cache);
    let options = RunOptions::default();
    assert!(run.audit(1.0, 0, &options).is_empty(), "nothing is cached yet");
    bench.run_plan(&plan, &options);
    let all = run.audit(1.0, 0, &options);
    let differ: Vec<&str> =
        all.iter().filter(|node| matches!(node.verdict, Verdict::Differs(_))).map(|n| &*n.id).collect();
    assert_eq!((all.len(), differ), (11, vec!["dice"]));
    assert!(all.iter().all(|node| !matches!(node.verdict, Verdict::Failed(_))));
    let some = |choice| run.audit(0.3, choice, &options).iter().map(|node| node.id.clone()).collect::<BTreeSet<_>>();
    assert_eq!(some(1).len(), 3);
    assert!((2..9).any(|choice| some(choice) != some(1)), "another choice takes another sample");
    assert_eq!(run.audit(0.0, 0, &options).len(), 1);
    assert_eq!(bench.run_plan(&plan, &options).count(Status::Hit), 11, "an audit stores nothing");
}
