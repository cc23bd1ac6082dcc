//! Graphs that extend graphs, and `--set`.

use std::path::Path;

use heartian_graph::{Graph, GraphError, Problem, RunOptions};

use crate::nodes::{Bench, plan, registry};

const BASE: &str = r#"Graph(name: "base", doc: "Two steps.", nodes: {
    "a": (kind: "Constant", params: (values: [1.0], label: "x")),
    "b": (kind: "Add", params: (amount: 1.0, spelling: "fancy"), inputs: {"numbers": "a.numbers"}),
    "c": (kind: "Sum", inputs: {"terms": ["a.numbers", "b.numbers"]}),
}, exports: ["c.numbers"])"#;

fn write(folder: &Path, name: &str, text: &str) -> std::path::PathBuf {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    path
}

fn problems(result: Result<Graph, GraphError>) -> Vec<String> {
    match result {
        Err(GraphError::Problems(problems)) => problems.0.iter().map(Problem::one_line).collect(),
        Err(other) => vec![other.to_string()],
        Ok(graph) => match graph.plan(&registry(), &[]) {
            Ok(_) => Vec::new(),
            Err(problems) => problems.0.iter().map(Problem::one_line).collect(),
        },
    }
}

#[test]
fn an_overlay_merges_rewires_adds_and_removes() {
    let bench = Bench::new();
    write(bench.folder.path(), "base.ron", BASE);
    let overlay = r#"Graph(name: "ablation", extends: "../base.ron", remove: ["b"], exports: [], nodes: {
        "a": (params: (values: [2.0])),
        "c": (inputs: {"terms": ["a.numbers", "n.numbers"]}),
        "n": (kind: "Add", params: (amount: 3), inputs: {"numbers": "a.numbers"}),
    })"#;
    let path = write(bench.folder.path(), "sub/ablation.ron", overlay);
    let graph = Graph::load(&path).unwrap();
    assert_eq!((graph.name(), graph.doc()), ("ablation", "Two steps."));
    let plan = plan(&graph);
    assert_eq!(plan.nodes[0].values["label"], "x");
    assert!(plan.exports.is_empty());
    let done = bench.run_plan(&plan, &RunOptions::default());
    assert_eq!(done.statuses(), "a:ran n:ran c:ran");
    assert_eq!(bench.numbers(&done, "c"), [7.0]);
}

#[test]
fn another_kind_replaces_the_node_wholly() {
    let bench = Bench::new();
    write(bench.folder.path(), "base.ron", BASE);
    let overlay = r#"(extends: "base.ron", nodes: {"b": (kind: "Constant", params: (values: [9]))})"#;
    let graph = Graph::load(&write(bench.folder.path(), "o.ron", overlay)).unwrap();
    let done = bench.run_plan(&plan(&graph), &RunOptions::default());
    assert_eq!(bench.numbers(&done, "c"), [10.0]);
    assert_eq!(graph.name(), "base");
}

#[test]
fn overlay_mistakes_are_placed_in_the_overlay() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "base.ron", BASE);
    let check = |text: &str| {
        let found = problems(Graph::load(&write(folder.path(), "o.ron", text)));
        let prefix = format!("{}/", folder.path().display());
        found.into_iter().map(|line| line.replace(&prefix, "")).collect::<Vec<_>>()
    };
    assert_eq!(
        check("(extends: \"base.ron\", remove: [\"bb\", \"c\"], exports: [])"),
        ["o.ron:1:32: there is no node `bb` to remove (did you mean `b`?)"]
    );
    assert_eq!(
        check("(extends: \"base.ron\",\n remove: [\"b\"])"),
        ["base.ron:4:56: there is no node `b` (nodes: a, c)"]
    );
    assert_eq!(
        check("(extends: \"base.ron\", nodes: {\"d\": (params: (amount: 2))})"),
        ["o.ron:1:31: node `d` has no kind (nodes so far: a, b, c)"]
    );
    assert_eq!(
        check("(extends: \"o.ron\")"),
        ["o.ron:1:11: cannot extend `o.ron`: `o.ron` extends itself, through this (the path is relative to this file)"]
    );
    let missing = check("(extends: \"nothere.ron\", remove: [\"x\"], nodes: {\"d\": (params: (amount: 2))})");
    assert_eq!(missing.len(), 1, "{missing:?}");
    assert!(missing[0].starts_with("o.ron:1:11: cannot extend `nothere.ron`: No such file"), "{missing:?}");
}

#[test]
fn set_takes_ron_and_bare_strings() {
    let mut graph = Graph::parse("test.ron", BASE).unwrap();
    for argument in ["b.amount=20", "b.spelling=plain", "a.values=[1, 2.5]", "a.label=../x y.mp4", "b.rounding=Down"] {
        graph.set(argument);
    }
    let made = plan(&graph);
    assert_eq!(made.nodes[1].values["amount"], 20.0);
    assert_eq!(made.nodes[1].values["spelling"], "plain");
    assert_eq!(made.nodes[1].values["rounding"], "Down");
    assert_eq!(made.nodes[0].values["values"], serde_json::json!([1.0, 2.5]));
    assert_eq!(made.nodes[0].values["label"], "../x y.mp4");
    for (argument, value) in [("a.label=20", "20"), ("a.label=\"a=b\"", "a=b"), ("a.label=C:\\x.mp4", "C:\\x.mp4")] {
        graph.set(argument);
        assert_eq!(plan(&graph).nodes[0].values["label"], value);
    }
    graph.set("a.label=None");
    assert!(plan(&graph).nodes[0].values["label"].is_null());
}

#[test]
fn set_mistakes_point_into_the_argument() {
    let mut graph = Graph::parse("test.ron", BASE).unwrap();
    for argument in
        ["bb.amount=1", "amount=1", "", "b.amonut=1", "a.values=nonsense", "c.terms=2", "b.amount=400", "b.amount=40"]
    {
        graph.set(argument);
    }
    let found = problems(Ok(graph));
    let expected = [
        "--set:1:1: the graph has no node `bb` (did you mean `b`?)",
        "--set:1:1: this is not of the form `node.param=value` (for example `--set phase.heart_rate_bpm=96`)",
        "--set:1:1: this is not of the form `node.param=value` (for example `--set phase.heart_rate_bpm=96`)",
        "--set:1:3: node `b` (Add) has no parameter `amonut` (did you mean `amount`?)",
        "--set:1:3: node `c` (Sum) has no parameter `terms` (it takes none)",
        "--set:1:10: node `a`: parameter `values`: invalid type: string \"nonsense\", expected a sequence (The numbers.)",
    ];
    assert_eq!(found, expected);
}
