//! Long chains and wide fans, without recursion and in little time.

use std::fmt::Write;
use std::time::Instant;

use heartian_graph::{Graph, RunOptions, Status};

use crate::nodes::{Bench, plan};

fn chain(length: usize) -> String {
    let mut text =
        String::from("Graph(name: \"chain\", nodes: {\"n0\": (kind: \"Constant\", params: (label: \"x\")),\n");
    for index in 1..length {
        let _ = writeln!(
            text,
            "\"n{index}\": (kind: \"Add\", params: (amount: 1), inputs: {{\"numbers\": \"n{}.numbers\"}}),",
            index - 1
        );
    }
    text + "})"
}

#[test]
fn a_chain_of_100_000_nodes_plans() {
    let graph = Graph::parse("chain.ron", &chain(100_000)).unwrap();
    let plan = plan(&graph);
    assert_eq!(plan.nodes.len(), 100_000);
    assert_eq!(&*plan.nodes[99_999].id, "n99999");
    let one = graph.plan(&crate::nodes::registry(), &["n70000".to_owned()]).unwrap();
    assert_eq!(one.nodes.len(), 70_001);
}

#[test]
fn a_cycle_of_100_000_nodes_is_found() {
    let text = chain(100_000).replace(
        "kind: \"Constant\", params: (label: \"x\")",
        "kind: \"Add\", inputs: {\"numbers\": \"n99999.numbers\"}",
    );
    let problems = Graph::parse("chain.ron", &text).unwrap().plan(&crate::nodes::registry(), &[]).err().unwrap();
    assert_eq!(problems.0.len(), 1);
    assert!(problems.0[0].one_line().len() < 600);
}

/// As many mistakes as nodes are counted, and shown only in part, without comparing all with all.
#[test]
fn a_graph_that_is_wrong_everywhere_is_refused_at_once() {
    let start = Instant::now();
    let text = chain(30_000).replace(".numbers\"", ".nombers\"").replace("amount: 1", "amuont: 1");
    let problems = Graph::parse("chain.ron", &text).unwrap().plan(&crate::nodes::registry(), &[]).err().unwrap();
    assert_eq!(problems.0.len(), 2 * 29_999);
    assert!(start.elapsed().as_secs() < 30, "{:?}", start.elapsed());
}

/// Measured, not only passed: run with `--nocapture` to see the times.
#[test]
fn a_thousand_nodes_run_and_hit_quickly() {
    let bench = Bench::new();
    let text = chain(1000);
    for expected in [Status::Ran, Status::Hit] {
        let start = Instant::now();
        let graph = Graph::parse("chain.ron", &text).unwrap();
        let done = bench.run_plan(&plan(&graph), &RunOptions::default());
        assert_eq!(done.count(expected), 1000);
        println!("1000 nodes {}: {:?}", expected.word(), start.elapsed());
        assert!(start.elapsed().as_secs() < 20);
    }
}
