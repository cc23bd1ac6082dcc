//! Graph parameters, `$name`, and graphs as nodes of graphs: what they give, and every mistake with its place.

use std::path::{Path, PathBuf};

use heartian_graph::{Graph, GraphError, Problem, RunOptions, Status};

use crate::nodes::{Bench, plan, registry};

/// Adds twice: `$step`, and ten times what the graph around says.
const TWICE: &str = r#"Graph(name: "twice", params: {"step": 1.0, "start": [1.0, 2.0]},
    inputs: {"numbers": "numbers", "extra": (artifact: "numbers", optional: true)},
    nodes: {
        "first": (kind: "Add", params: (amount: $step), inputs: {"numbers": $numbers}),
        "sum": (kind: "Sum", inputs: {"terms": ["first.numbers", "$numbers"], "extra": "$extra"}),
    },
    exports: {"total": "sum.numbers", "first": "first.numbers"})"#;

const MAIN: &str = r#"Graph(name: "main", params: {"hr": 3.0, "list": [$$]}, nodes: {
    "a": (kind: "Constant", params: (values: [1.0, 2.0])),
    "x": (kind: "twice.ron", params: (step: $hr), inputs: {"numbers": "a.numbers"}),
    "y": (kind: "twice.ron", inputs: {"numbers": "x.total", "extra": "x.first"}),
    "b": (kind: "Add", params: (amount: "$hr"), inputs: {"numbers": "y.total"}),
}, exports: ["y.total"])"#;

struct Folder(tempfile::TempDir);

impl Folder {
    fn new(files: &[(&str, &str)]) -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        files.iter().for_each(|(name, text)| drop(folder.write(name, text)));
        folder
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, text).unwrap();
        path
    }

    /// What is wrong with a file, with paths relative to the folder.
    fn problems(&self, name: &str) -> Vec<String> {
        let prefix = format!("{}/", self.0.path().display());
        let lines = problems(Graph::load(&self.0.path().join(name)));
        lines.into_iter().map(|line| line.replace(&prefix, "")).collect()
    }
}

fn problems(result: Result<Graph, GraphError>) -> Vec<String> {
    let problems = match result {
        Err(GraphError::Problems(problems)) => problems,
        Err(other) => return vec![other.to_string()],
        Ok(graph) => match graph.plan(&registry(), &[]) {
            Ok(_) => return Vec::new(),
            Err(problems) => problems,
        },
    };
    problems.0.iter().map(Problem::one_line).collect()
}

fn main_text() -> String {
    MAIN.replace(", \"list\": [$$]", "")
}

fn load(path: &Path) -> Graph {
    Graph::load(path).unwrap()
}

#[test]
fn subgraphs_are_laid_out_with_their_parameters_and_share_the_cache() {
    let folder = Folder::new(&[("twice.ron", TWICE), ("main.ron", &main_text())]);
    let bench = Bench::new();
    let graph = load(&folder.0.path().join("main.ron"));
    let made = plan(&graph);
    let ids: Vec<&str> = made.nodes.iter().map(|node| &*node.id).collect();
    assert_eq!(ids, ["a", "x/first", "x/sum", "y/first", "y/sum", "b"]);
    assert_eq!(made.nodes[made.exports[0].0].id.as_ref(), "y/sum");
    let done = bench.run_plan(&made, &RunOptions::default());
    // x: first = [4, 5], sum = [5, 7]; y: first = [6, 8], sum = [6+5+4, 8+7+5].
    assert_eq!(bench.numbers(&done, "y/sum"), [15.0, 20.0]);
    assert_eq!(bench.numbers(&done, "b"), [18.0, 23.0]);
    // The same nodes outside any subgraph are hits: no name is in a key.
    let flat = r#"(nodes: {
        "a": (kind: "Constant", params: (values: [1.0, 2.0])),
        "p": (kind: "Add", params: (amount: 3), inputs: {"numbers": "a.numbers"}),
        "q": (kind: "Sum", inputs: {"terms": ["p.numbers", "a.numbers"]}),
    })"#;
    assert_eq!(bench.run(flat).count(Status::Hit), 3);
    assert_eq!(graph.files().count(), 2);
}

#[test]
fn parameters_are_set_from_the_command_line_and_by_overlays() {
    let folder = Folder::new(&[("twice.ron", TWICE), ("main.ron", &main_text())]);
    let value = |graph: &Graph, id: &str| {
        let made = plan(graph);
        let node = made.nodes.iter().find(|node| &*node.id == id).unwrap();
        node.values["amount"].as_f64().unwrap()
    };
    let mut graph = load(&folder.0.path().join("main.ron"));
    assert_eq!((value(&graph, "x/first"), value(&graph, "y/first"), value(&graph, "b")), (3.0, 1.0, 3.0));
    graph.set("hr=7");
    assert_eq!((value(&graph, "x/first"), value(&graph, "y/first"), value(&graph, "b")), (7.0, 1.0, 7.0));
    graph.set("y.step=$hr");
    graph.set("b.amount=$hr");
    assert_eq!((value(&graph, "y/first"), value(&graph, "b")), (7.0, 7.0));
    graph.set("y/first.amount=-2");
    assert_eq!(value(&graph, "y/first"), -2.0);
    let overlay = r#"(extends: "main.ron", params: {"hr": 9}, nodes: {"y": (params: (step: 5))})"#;
    let graph = load(&folder.write("over.ron", overlay));
    assert_eq!((value(&graph, "x/first"), value(&graph, "y/first"), value(&graph, "b")), (9.0, 5.0, 9.0));
    let target = graph.plan(&registry(), &["x".to_owned()]).unwrap();
    assert_eq!(target.nodes.len(), 3);
}

#[test]
fn names_inside_lists_and_plain_dollars() {
    let text = r#"(params: {"low": 1.5, "name": "x"}, nodes: {
        "a": (kind: "Constant", params: (values: [$low, 2.0, "$low"], label: "$$name")),
        "b": (kind: "Constant", params: (label: "$5 a piece")),
        "c": (kind: "Constant", params: (label: $name)),
    })"#;
    let made = plan(&Graph::parse("g.ron", text).unwrap());
    assert_eq!(made.nodes[0].values["values"], serde_json::json!([1.5, 2.0, 1.5]));
    let labels: Vec<_> = made.nodes.iter().map(|node| node.values["label"].as_str().unwrap()).collect();
    assert_eq!(labels, ["$name", "$5 a piece", "x"]);
}

#[test]
fn mistakes_with_parameters_are_placed_where_the_name_is_used() {
    let found = problems(Graph::parse(
        "g.ron",
        r#"(params: {"hr": "fast", "big": 1000, "r": $hr, "1x": 3}, nodes: {
    "a": (kind: "Constant", params: (values: [1.0, $hrr])),
    "b": (kind: "Add", params: (amount: $hr), inputs: {"numbers": "a.numbers"}),
    "c": (kind: "Add", params: (amount: $big, rounding: $hr), inputs: {"numbers": "a.numbers"}),
    "d": (kind: "Add", params: (amount: $big), inputs: {"numbers": $hr}),
})"#,
    ));
    let expected = [
        "g.ron:1:43: the graph's parameter `r` refers to another (give it a plain value)",
        "g.ron:1:48: `1x` cannot be a parameter's name (use letters, digits and `_`, so that `$name` can be written)",
        "g.ron:2:52: the graph has no parameter `hrr` (did you mean `hr`?)",
        "g.ron:3:41: node `b`: parameter `amount`: invalid type: string \"fast\", expected f64 (What is added.)",
        "g.ron:4:57: node `c`: parameter `rounding`: unknown variant `fast`, expected `Exact` or `Down` \
         (Whether the sum is rounded.)",
        "g.ron:5:41: node `d`: parameter `amount` is 1000; it must be from -100 to 100 units (What is added.)",
        "g.ron:5:68: the graph has no input `hr` (declare it: `inputs: {\"hr\": \"artifact type\"}`)",
    ];
    assert_eq!(found, expected);
    let none = problems(Graph::parse("g.ron", "(nodes: {\"a\": (kind: \"Constant\", params: (label: $who))})"));
    let help = "declare it: `params: {\"who\": ..}`; `\"$$who\"` is the plain text";
    assert_eq!(none, [format!("g.ron:1:50: the graph has no parameter `who` ({help})")]);
    let graph = Graph::parse("g.ron", "(params: {\"hr\": 1}, nodes: {\"a\": (kind: \"Constant\")})");
    let mut graph = graph.unwrap();
    graph.set("rh=2");
    assert_eq!(problems(Ok(graph)), ["--set:1:1: the graph has no parameter `rh` (parameters: hr)"]);
}

/// The report of a `$name` shows both ends.
#[test]
fn a_name_shows_where_its_value_was_given() {
    let text = "(params: {\"hr\": \"fast\"}, nodes: {\n \"a\": (kind: \"Add\", params: (amount: $hr))})";
    let problems = Graph::parse("g.ron", text).unwrap().plan(&registry(), &[]).err().unwrap();
    let mut shown = String::new();
    let theme = miette::GraphicalTheme::unicode_nocolor();
    miette::GraphicalReportHandler::new_themed(theme).render_report(&mut shown, &problems).unwrap();
    assert!(shown.contains("`$hr` is given here") && shown.contains("takes f64, in units"), "{shown}");
}

#[test]
fn an_overlay_that_adds_a_parameter_nobody_uses_has_misspelt_it() {
    let folder = Folder::new(&[("twice.ron", TWICE), ("main.ron", &main_text())]);
    folder.write("o.ron", "(extends: \"main.ron\", params: {\"hrr\": 9})");
    assert_eq!(folder.problems("o.ron"), ["o.ron:1:32: no node uses the parameter `hrr` (did you mean `hr`?)"]);
}

#[test]
fn mistakes_inside_a_subgraph_point_into_its_file_and_are_said_once() {
    let folder = Folder::new(&[(
        "part/bad.ron",
        r#"(inputs: {"numbers": "numbers", "n": "nombers"}, params: {"step": 1.0}, nodes: {
    "first": (kind: "Ad", inputs: {"numbers": $numbers}),
    "sum": (kind: "Sum", inputs: {"terms": ["frst.numbers", $nmbers]}),
    "spell": (kind: "Spell", inputs: {"numbers": "sum.number"}),
    "add": (kind: "Add", params: (amount: $stp)),
}, exports: {"total": "sum.numbers", "lost": "sun.numbers"})"#,
    )]);
    folder.write(
        "main.ron",
        r#"(nodes: {
    "a": (kind: "Constant"),
    "x": (kind: "part/bad.ron", params: (stepp: 1), inputs: {"numbers": "a.numbers", "m": "a.numbers"}),
    "y": (kind: "part/bad.ron", inputs: {"numbers": "a.numbers", "n": "a.numbers"}),
    "z": (kind: "Sum", inputs: {"terms": ["y.totl", "x", "y.lost"]}),
})"#,
    );
    let expected = [
        "main.ron:3:42: node `x` (part/bad.ron) has no parameter `stepp` (did you mean `step`?)",
        "main.ron:3:86: node `x` (part/bad.ron) has no input `m` (inputs: numbers, n)",
        "main.ron:5:43: node `y` (part/bad.ron) has no output `totl` (did you mean `total`?)",
        "main.ron:5:53: `x` names no output; write \"node.port\" (did you mean `x.total` or `x.lost`?)",
        "part/bad.ron:1:38: no node reads or writes an artifact of type `nombers` (did you mean `numbers`?)",
        "part/bad.ron:2:21: there is no kind of node `Ad` (did you mean `Add`?)",
        "part/bad.ron:3:45: there is no node `frst` (did you mean `first`?)",
        "part/bad.ron:3:61: the graph has no input `nmbers` (did you mean `numbers`?)",
        "part/bad.ron:4:50: node `sum` (Sum) has no output `number` (did you mean `numbers`?)",
        "part/bad.ron:5:5: node `add` (Add) needs its input `numbers` (`numbers` carries `numbers`: Numbers. \
         (outputs that fit: sum.numbers))",
        "part/bad.ron:5:43: `part/bad.ron` has no parameter `stp` (did you mean `step`?)",
        "part/bad.ron:6:46: there is no node `sun` (did you mean `sum`?)",
    ];
    assert_eq!(folder.problems("main.ron"), expected);
}

#[test]
fn wires_over_the_border_of_a_subgraph_have_types() {
    let folder = Folder::new(&[("twice.ron", TWICE)]);
    folder.write(
        "main.ron",
        r#"(nodes: {
    "a": (kind: "Constant"),
    "s": (kind: "Spell", inputs: {"numbers": "a.numbers"}),
    "x": (kind: "twice.ron", inputs: {"numbers": "s.word"}),
    "y": (kind: "twice.ron"),
    "z": (kind: "twice.ron", inputs: {"numbers": ["a.numbers", "a.numbers"]}),
    "w": (kind: "word.ron", inputs: {"word": "s.word"}),
})"#,
    );
    folder.write(
        "word.ron",
        "(inputs: {\"word\": \"word\"}, nodes: {\n \"b\": (kind: \"Add\", inputs: {\"numbers\": $word})})",
    );
    let expected = [
        "main.ron:4:50: `s.word` gives `word`, but `x.numbers` takes `numbers` (outputs that fit: a.numbers)",
        "main.ron:5:5: node `y` (twice.ron) needs its input `numbers` (outputs that fit: a.numbers)",
        "main.ron:6:64: `z.numbers` takes one wire, not 2",
        "word.ron:2:41: `$word` gives `word`, but `b.numbers` takes `numbers`",
    ];
    // An unfed input is one mistake, not one for each node behind it.
    assert_eq!(folder.problems("main.ron"), expected);
}

#[test]
fn a_part_alone_says_that_it_is_a_part() {
    let folder = Folder::new(&[("twice.ron", TWICE)]);
    let found = folder.problems("twice.ron");
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].starts_with("twice.ron:2:14: the graph's input `numbers` is fed by nobody (this file is a part"));
}

#[test]
fn rings_and_missing_files_are_refused_with_the_nearest_name() {
    let folder = Folder::new(&[("twice.ron", TWICE)]);
    folder.write("a.ron", "(nodes: {\"b\": (kind: \"b.ron\")}, exports: [\"b.numbers\"])");
    folder.write("b.ron", "(nodes: {\"a\": (kind: \"a.ron\")}, exports: [\"a.numbers\"])");
    let ring = folder.problems("a.ron");
    assert_eq!(ring.len(), 1, "{ring:?}");
    assert!(ring[0].starts_with("b.ron:1:22: `a.ron` contains itself, through this"), "{ring:?}");
    folder.write(
        "m.ron",
        "(nodes: {\"b\": (kind: \"twise.ron\"), \"c\": (kind: \"Sum\", inputs: {\"terms\": \"b.x\"})})",
    );
    let missing = folder.problems("m.ron");
    assert_eq!(missing.len(), 1, "{missing:?}");
    assert!(missing[0].starts_with("m.ron:1:22: cannot read the subgraph `twise.ron`: No such file"), "{missing:?}");
    assert!(missing[0].ends_with("(did you mean `twice.ron`? the path is relative to this file)"), "{missing:?}");
    let path = folder.0.path().join("twcie.ron");
    let report = format!("{:?}", miette::Report::new(Graph::load(&path).unwrap_err()));
    assert!(report.contains("did you mean `twice.ron`?"), "{report}");
}

/// Ten files, each of ten of the next: refused, not laid out for ever.
#[test]
fn explosions_are_bounded() {
    let folder = Folder::new(&[("f0.ron", "(nodes: {\"a\": (kind: \"Constant\")})")]);
    for depth in 1..=9 {
        let inner = depth - 1;
        let nodes: String = (0..10).map(|index| format!("\"n{index}\": (kind: \"f{inner}.ron\"),")).collect();
        folder.write(&format!("f{depth}.ron"), &format!("(nodes: {{{nodes}}})"));
    }
    assert_eq!(plan(&load(&folder.0.path().join("f3.ron"))).nodes.len(), 1000);
    let found = folder.problems("f9.ron");
    assert!(found[0].contains("more than 1000000 nodes"), "{found:?}");
    // Lists of lists of lists, by parameters handed inwards.
    folder.write("l0.ron", "(params: {\"v\": 1}, nodes: {\"a\": (kind: \"Constant\", params: (values: $v))})");
    for depth in 1..=9 {
        let list = "$v, ".repeat(30);
        let (inner, own) = (depth - 1, if depth == 9 { "1" } else { "0" });
        let text =
            format!("(params: {{\"v\": {own}}}, nodes: {{\"i\": (kind: \"l{inner}.ron\", params: (v: [{list}]))}})");
        folder.write(&format!("l{depth}.ron"), &text);
    }
    let found = folder.problems("l9.ron");
    assert!(found.len() == 1 && found[0].contains("stands for more than 4000000 values"), "{found:?}");
}

/// Several groups of nodes that wait for one another: each is shown.
#[test]
fn every_cycle_is_reported() {
    let add =
        |id: &str, from: &str| format!("\"{id}\": (kind: \"Add\", inputs: {{\"numbers\": \"{from}.numbers\"}}),\n");
    let text = format!("(nodes: {{\n{}{}{}{}}})", add("a", "b"), add("b", "a"), add("c", "c"), add("d", "a"));
    let found = problems(Graph::parse("g.ron", &text));
    let help = "(a graph flows one way; cut one of these wires)";
    assert_eq!(
        found,
        [
            format!("g.ron:2:1: these nodes wait for one another: a → b → a {help}"),
            format!("g.ron:4:1: these nodes wait for one another: c → c {help}")
        ]
    );
}
