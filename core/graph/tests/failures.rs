//! Nodes that fail, panic, forget an output or are told to stop.

use std::sync::Arc;

use heartian_graph::{Cancel, RunOptions, Status};

use crate::nodes::{Bench, Listener};

const BRANCHES: &str = r#"(nodes: {
    "a": (kind: "Constant"),
    "bad": (kind: "Trouble", params: (how: "fail"), inputs: {"numbers": "a.numbers"}),
    "after": (kind: "Add", inputs: {"numbers": "bad.numbers"}),
    "aside": (kind: "Add", inputs: {"numbers": "a.numbers"}),
})"#;

#[test]
fn a_failure_names_node_parameter_remedy_and_place() {
    let done = Bench::new().run_with(BRANCHES, &[], &RunOptions { jobs: 1, ..RunOptions::default() });
    assert_eq!(done.statuses(), "a:ran bad:failed after:skipped aside:skipped");
    assert_eq!(
        done.problems[0].one_line(),
        "test.ron:3:44: node `bad` (Trouble), parameter `how`: it was told to fail (tell it otherwise)"
    );
}

#[test]
fn keep_going_runs_what_does_not_depend_on_the_failure() {
    let bench = Bench::new();
    let done = bench.run_with(BRANCHES, &[], &RunOptions { keep_going: true, ..RunOptions::default() });
    assert_eq!(done.statuses(), "a:ran bad:failed after:skipped aside:ran");
    assert_eq!(
        bench
            .run(&BRANCHES.replace("\"bad\": (kind: \"Trouble\", params: (how: \"fail\")", "\"bad\": (kind: \"Add\""))
            .statuses(),
        "a:hit bad:hit after:hit aside:hit"
    );
}

#[test]
fn panics_and_forgotten_outputs_are_errors_of_the_node() {
    let bench = Bench::new();
    for (how, words) in [("panic", "the node panicked: index 7 is no good"), ("forget", "output `numbers` is unusable")]
    {
        let done = bench.run_with(BRANCHES, &[&format!("bad.how={how}")], &RunOptions::default());
        assert_eq!(done.count(Status::Failed), 1);
        assert!(done.problems[0].one_line().contains(words), "{}", done.problems[0].one_line());
    }
    assert_eq!(bench.run(BRANCHES).reports[0].status, Status::Hit);
}

#[test]
fn a_request_to_stop_keeps_what_is_finished() {
    let bench = Bench::new();
    let cancel = Cancel::default();
    let listener = Listener { stop_at_progress: Some(cancel.clone()), ..Listener::default() };
    let options =
        RunOptions { cancel, observer: Arc::new(listener), keep_going: true, jobs: 1, ..RunOptions::default() };
    let done = bench.run_with(BRANCHES, &["bad.how=wait"], &options);
    assert_eq!(done.statuses(), "a:ran bad:failed after:skipped aside:skipped");
    assert!(done.problems[0].one_line().contains("cancelled"));
    assert_eq!(bench.run(BRANCHES).reports[0].status, Status::Hit);
}

#[test]
fn a_source_that_vanishes_after_the_check_fails_its_node() {
    let bench = Bench::new();
    let path = bench.path("gone.bin");
    std::fs::write(&path, [1]).unwrap();
    let text = format!("(nodes: {{\"r\": (kind: \"ReadFile\", params: (path: r\"{}\"))}})", path.display());
    let plan = crate::nodes::plan(&heartian_graph::Graph::parse("test.ron", &text).unwrap());
    std::fs::remove_file(&path).unwrap();
    let done = bench.run_plan(&plan, &RunOptions::default());
    assert_eq!(done.statuses(), "r:failed");
    assert!(done.problems[0].one_line().contains("parameter `path`"), "{}", done.problems[0].one_line());
}
