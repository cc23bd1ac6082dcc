//! Several nodes at once: within resources, with the same bytes, and without one failure spoiling the rest.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use heartian_graph::{Cancel, Event, Graph, Observer, Plan, RunOptions, Status};

use crate::bulk::{block, registry};
use crate::nodes::{Bench, Done};

/// Who runs now, and every set of nodes that ever ran together.
#[derive(Default)]
struct Together {
    now: Mutex<BTreeSet<String>>,
    seen: Mutex<BTreeSet<BTreeSet<String>>>,
}

impl Observer for Together {
    fn event(&self, event: &Event<'_>) {
        let mut now = self.now.lock().unwrap();
        match event {
            Event::Started { node, .. } => now.insert((*node).to_owned()),
            Event::Finished { node, .. } => now.remove(*node),
            _ => false,
        };
        self.seen.lock().unwrap().insert(now.clone());
    }
}

pub fn bulk_plan(text: &str, sets: &[&str]) -> Plan {
    let mut graph = Graph::parse("bulk.ron", text).unwrap();
    sets.iter().for_each(|set| graph.set(set));
    graph.plan(&registry(), &[]).unwrap_or_else(|problems| panic!("{problems:?}"))
}

fn watch(text: &str, options: RunOptions) -> (Done, BTreeSet<BTreeSet<String>>) {
    let together = Arc::new(Together::default());
    let options = RunOptions { observer: together.clone(), ..options };
    let done = Bench::new().run_plan(&bulk_plan(text, &[]), &options);
    let seen = together.seen.lock().unwrap().clone();
    (done, seen)
}

fn wide(params: &str) -> String {
    let nodes =
        (0..6).map(|seed| format!("\"n{seed}\": (kind: \"Bulk\", params: (seed: {seed}, pause: 40, {params})),"));
    format!("(nodes: {{{}}})", nodes.collect::<String>())
}

fn most(seen: &BTreeSet<BTreeSet<String>>) -> usize {
    seen.iter().map(BTreeSet::len).max().unwrap()
}

#[test]
fn nodes_run_together_as_far_as_resources_allow() {
    let options = |jobs, memory_bytes| RunOptions { jobs, memory_bytes, ..RunOptions::default() };
    let cases = [
        ("", options(3, u64::MAX), 3),
        ("", options(1, u64::MAX), 1),
        ("", options(0, u64::MAX), 1),
        ("threads: 2", options(4, u64::MAX), 2),
        ("threads: 100", options(4, u64::MAX), 1),
        ("memory: 300", options(6, 1000), 3),
        ("memory: 3000", options(6, 1000), 1),
        ("gpu: true", options(6, u64::MAX), 1),
    ];
    for (params, options, expected) in cases {
        let (done, seen) = watch(&wide(params), options);
        assert_eq!(done.count(Status::Ran), 6);
        assert_eq!(most(&seen), expected, "{params}: {seen:?}");
    }
}

#[test]
fn the_number_of_jobs_changes_no_byte() {
    let digests = |jobs| -> Vec<_> {
        let options = RunOptions { jobs, ..RunOptions::default() };
        let done = Bench::new().run_plan(&bulk_plan(&block("bytes: 5000"), &[]), &options);
        assert_eq!(done.count(Status::Ran), 10);
        done.reports.into_iter().map(|report| (report.id, report.outputs)).collect()
    };
    let one = digests(1);
    assert!(one.windows(2).all(|pair| pair[0].1 != pair[1].1));
    assert_eq!(one, digests(2));
    assert_eq!(one, digests(16));
}

#[test]
fn twins_in_one_graph_run_once() {
    let nodes = (0..5).map(|id| format!("\"n{id}\": (kind: \"Bulk\", params: (pause: 20)),")).collect::<String>();
    let (done, _) = watch(&format!("(nodes: {{{nodes}}})"), RunOptions { jobs: 4, ..RunOptions::default() });
    assert_eq!((done.count(Status::Ran), done.count(Status::Hit)), (1, 4), "{}", done.statuses());
}

#[test]
fn all_failures_are_named_and_spare_the_other_branches() {
    let bench = Bench::new();
    let options = RunOptions { keep_going: true, jobs: 3, ..RunOptions::default() };
    let plan = bulk_plan(&block("bytes: 10"), &["d.fails_at=0", "f.fails_at=0"]);
    let done = bench.run_plan(&plan, &options);
    let expected = "a:ran b:ran c:ran d:failed e:ran f:failed g:skipped h:skipped i:skipped j:skipped";
    assert_eq!(done.statuses(), expected);
    let said: Vec<String> = done.problems.iter().map(heartian_graph::Problem::one_line).collect();
    assert!(said.len() == 2 && said[0].contains("`d`") && said[1].contains("`f`"), "{said:?}");
    let mended = bench.run_plan(&bulk_plan(&block("bytes: 10"), &[]), &options);
    assert_eq!(mended.statuses(), "a:hit b:hit c:hit d:ran e:hit f:ran g:ran h:ran i:ran j:ran");
}

/// Asks to stop when a node starts.
struct StopAt(&'static str, Cancel);

impl Observer for StopAt {
    fn event(&self, event: &Event<'_>) {
        if matches!(event, Event::Started { node, .. } if *node == self.0) {
            self.1.request();
        }
    }
}

#[test]
fn a_stopped_node_resumes_where_it_was_with_the_same_bytes() {
    let (whole, cut) = (Bench::new(), Bench::new());
    let text = block("bytes: 500, steps: 40, pause: 1");
    let expected = whole.run_plan(&bulk_plan(&text, &[]), &RunOptions::default());
    // Killed in the middle of `e`: an error after a few kept states stands for the kill, which leaves the same files.
    let options = RunOptions { checkpoint_every: Duration::ZERO, jobs: 1, ..RunOptions::default() };
    let killed = cut.run_plan(&bulk_plan(&text, &["e.fails_at=25"]), &options);
    assert_eq!(killed.statuses(), "a:ran b:ran c:ran d:ran e:failed f:skipped g:skipped h:skipped i:skipped j:skipped");
    let (listener, listening) = crate::nodes::listened();
    let resumed = cut.run_plan(&bulk_plan(&text, &["e.fails_at=25"]), &listening);
    assert_eq!(resumed.statuses(), "a:hit b:hit c:hit d:hit e:ran f:ran g:ran h:ran i:ran j:ran");
    let outputs = |done: &Done| done.reports.iter().map(|report| report.outputs.clone()).collect::<Vec<_>>();
    assert_eq!(outputs(&resumed), outputs(&expected));
    let lines = listener.lines.lock().unwrap();
    let first = lines.iter().find(|line| line.contains("Progress { node: \"e\"")).unwrap();
    assert!(first.contains("step: 26") && first.contains("25.0"), "{first}");
    assert_eq!(cut.cache.usage().checkpoints, 0, "finished nodes keep no state");
}

/// Ctrl-C keeps the state of the moment, however rarely states are kept otherwise.
#[test]
fn a_request_to_stop_keeps_the_state() {
    let bench = Bench::new();
    let text = "(nodes: {\"n\": (kind: \"Bulk\", params: (steps: 1000000, pause: 1))})";
    let cancel = Cancel::default();
    let observer = Arc::new(StopAt("n", cancel.clone()));
    let done = bench.run_plan(&bulk_plan(text, &[]), &RunOptions { cancel, observer, ..RunOptions::default() });
    assert_eq!(done.statuses(), "n:failed");
    assert!(bench.cache.usage().checkpoints > 0);
    assert!(done.problems[0].one_line().contains("cancelled"));
}

/// A state that was damaged on disk is no state.
#[test]
fn a_damaged_state_is_not_resumed() {
    let bench = Bench::new();
    let text = "(nodes: {\"n\": (kind: \"Bulk\", params: (steps: 9, fails_at: 5))})";
    let options = RunOptions { checkpoint_every: Duration::ZERO, ..RunOptions::default() };
    assert_eq!(bench.run_plan(&bulk_plan(text, &[]), &options).statuses(), "n:failed");
    for (path, mut bytes) in crate::nodes::cache_files(&bench) {
        if path.extension().is_some_and(|extension| extension == "state") {
            *bytes.last_mut().unwrap() ^= 1;
            std::fs::write(path, bytes).unwrap();
        }
    }
    assert_eq!(
        bench.run_plan(&bulk_plan(text, &[]), &options).statuses(),
        "n:failed",
        "it starts over, and fails again"
    );
    assert_eq!(bench.run_plan(&bulk_plan(text, &[]), &options).statuses(), "n:ran");
}
