//! Why a node is a hit or a miss, what a sweep shares, what the schema says, what a picture shows.

use heartian_graph::{
    Explainer, Explanation, Forecast, Graph, History, PastNode, Picture, Plan, Run, RunOptions, Standing, Status,
    Sweep, Tint, kind_schema, schema, subjects_of_plan, subjects_of_run,
};
use serde_json::{Value, json};

use crate::nodes::{Bench, Done, plan, registry};

const CHAIN: &str = r#"Graph(name: "chain", params: {"x": 10}, nodes: {
    "a": (kind: "Constant", params: (values: [1.25, 2.5])),
    "b": (kind: "Add", params: (amount: 0.25, rounding: Down), inputs: {"numbers": "a.numbers"}),
    "c": (kind: "Add", params: (amount: $x), inputs: {"numbers": "b.numbers"}),
    "d": (kind: "Sum", inputs: {"terms": ["a.numbers", "c.numbers"]}),
})"#;

fn changed(sets: &[&str]) -> Plan {
    let mut graph = Graph::parse("test.ron", CHAIN).unwrap();
    sets.iter().for_each(|argument| graph.set(argument));
    plan(&graph)
}

fn of_plan(bench: &Bench, plan: &Plan) -> Vec<Explanation> {
    let history = History::read(&bench.cache);
    let subjects = subjects_of_plan(plan, &Run::prepare(plan, &bench.cache).preview());
    let explainer = Explainer::new(&history, &subjects);
    (0..subjects.len()).map(|index| explainer.explain(index)).collect()
}

fn of_run(bench: &Bench, done: &Done) -> Vec<Explanation> {
    let history = History::read(&bench.cache);
    let nodes: Vec<PastNode> = done
        .reports
        .iter()
        .map(|report| PastNode {
            id: report.id.to_string(),
            kind: report.kind.to_owned(),
            status: report.status,
            key: report.key,
            outputs: report.outputs.iter().map(|(port, digest)| ((*port).to_owned(), *digest)).collect(),
        })
        .collect();
    let subjects = subjects_of_run(&nodes, &history);
    let explainer = Explainer::new(&history, &subjects);
    (0..subjects.len()).map(|index| explainer.explain(index)).collect()
}

/// `node: field from → to`, a line a change, causes after what they caused.
fn lines(explanation: &Explanation) -> Vec<String> {
    let short = |value: &Option<Value>| match value {
        Some(Value::String(text)) if text.len() == 64 => "digest".to_owned(),
        Some(value) => value.to_string(),
        None => "nothing".to_owned(),
    };
    let changes = explanation.causes.iter().flat_map(|cause| cause.changes.iter().map(move |change| (cause, change)));
    changes
        .map(|(cause, change)| {
            format!("{}: {} {} → {}", cause.node, change.field, short(&change.from), short(&change.to))
        })
        .collect()
}

#[test]
fn a_first_run_has_nothing_to_compare_with() {
    let bench = Bench::new();
    let first = of_plan(&bench, &changed(&[]));
    let standings: Vec<Standing> = first.iter().map(|explanation| explanation.standing).collect();
    assert_eq!(standings, [Standing::Miss, Standing::Waits, Standing::Waits, Standing::Waits]);
    assert_eq!(first[3].waits_for, ["a", "c"]);
    assert!(first.iter().all(|explanation| explanation.causes.is_empty() && explanation.made.is_none()));
    bench.run(CHAIN);
    assert_eq!(History::read(&bench.cache).len(), 4);
    let second = of_plan(&bench, &changed(&[]));
    assert!(second.iter().all(|explanation| explanation.standing == Standing::Hit && explanation.made.is_some()));
}

#[test]
fn a_miss_names_the_parameter_and_both_values() {
    let bench = Bench::new();
    bench.run(CHAIN);
    let found = of_plan(&bench, &changed(&["x=20"]));
    let standings: Vec<Standing> = found.iter().map(|explanation| explanation.standing).collect();
    assert_eq!(standings, [Standing::Hit, Standing::Hit, Standing::Miss, Standing::Waits]);
    assert_eq!(lines(&found[2]), ["c: params.amount 10.0 → 20.0"]);
    assert_eq!(found[2].causes[0].changes[0].parameter(), Some("amount"));
    assert_eq!(found[3].waits_for, ["c"]);
    let seed = Graph::parse("test.ron", &CHAIN.replace("Graph(", "Graph(seed: 3, ")).unwrap();
    assert_eq!(lines(&of_plan(&bench, &plan(&seed))[0]), ["a: seed 0 → 3"]);
}

#[test]
fn an_input_that_changed_leads_to_the_node_that_caused_it() {
    let bench = Bench::new();
    bench.run(CHAIN);
    // `b` rounds, so `c` stays a hit; `d` reads `a` itself.
    let done = bench.run_with(CHAIN, &["a.values=[1.5, 2.25]"], &RunOptions::default());
    assert_eq!(done.statuses(), "a:ran b:ran c:hit d:ran");
    let found = of_run(&bench, &done);
    assert_eq!(lines(&found[0]), ["a: params.values [1.25,2.5] → [1.5,2.25]"]);
    assert_eq!(
        lines(&found[3])[..2],
        ["d: inputs.terms[0] digest → digest", "a: params.values [1.25,2.5] → [1.5,2.25]"]
    );
    assert_eq!(found[2].standing, Standing::Hit);
    // Two steps up.
    let deep = bench.run_with(CHAIN, &["b.amount=3.5"], &RunOptions::default());
    assert_eq!(deep.statuses(), "a:hit b:ran c:ran d:ran");
    let found = of_run(&bench, &deep);
    let expected =
        ["d: inputs.terms[1] digest → digest", "c: inputs.numbers[0] digest → digest", "b: params.amount 0.25 → 3.5"];
    assert_eq!(lines(&found[3]), expected);
}

#[test]
fn changed_files_are_named_by_their_parameter() {
    let bench = Bench::new();
    let path = bench.path("one.bin");
    std::fs::write(&path, [1, 2]).unwrap();
    let text = format!("(nodes: {{\"r\": (kind: \"ReadFile\", params: (path: r\"{}\"))}})", path.display());
    bench.run(&text);
    std::fs::write(&path, [1, 3]).unwrap();
    let found = of_plan(&bench, &plan(&Graph::parse("test.ron", &text).unwrap()));
    assert_eq!(lines(&found[0]), ["r: sources.path[0] digest → digest"]);
    assert_eq!(found[0].causes[0].changes[0].parameter(), Some("path"));
}

#[test]
fn damaged_records_explain_nothing_and_harm_nothing() {
    let bench = Bench::new();
    bench.run(CHAIN);
    for path in crate::nodes::cache_files(&bench).into_keys() {
        std::fs::write(path, b"{}\n[[[[").unwrap();
    }
    assert!(History::read(&bench.cache).is_empty());
}

#[test]
fn a_sweep_knows_what_its_points_share() {
    let bench = Bench::new();
    bench.run(CHAIN);
    let sweep =
        Sweep::parse(&["x=[10, 20, 30]".to_owned(), "b.spelling=[\"plain\", \"fancy\"]".to_owned()], false).unwrap();
    let mut plans = Vec::new();
    for point in 0..sweep.points.len() {
        let mut graph = Graph::parse("test.ron", CHAIN).unwrap();
        sweep.settings(point).iter().for_each(|setting| graph.set_from("--over", setting));
        plans.push(plan(&graph));
    }
    let previews: Vec<_> = plans.iter().map(|plan| (plan, Run::prepare(plan, &bench.cache).preview())).collect();
    let forecast = Forecast::of(&previews, &History::read(&bench.cache));
    // a once; b twice, one cached; c and d six times, each cached at the first point. At the other spelling of b its
    // bytes are not known yet, so c and d wait there; c runs at two points of the first.
    let counts = (forecast.points, forecast.nodes, forecast.distinct, forecast.cached, forecast.runs, forecast.waits);
    assert_eq!(counts, (6, 24, 1 + 2 + 6 + 6, 4, 1 + 2, 2 + 3 + 3));
    assert!(forecast.untimed.is_empty() && forecast.seconds >= 0.0);
    for plan in &plans {
        bench.run_plan(plan, &RunOptions::default());
    }
    let previews: Vec<_> = plans.iter().map(|plan| (plan, Run::prepare(plan, &bench.cache).preview())).collect();
    let after = Forecast::of(&previews, &History::read(&bench.cache));
    // Both spellings give the same bytes: the waiting nodes were hits.
    assert_eq!((after.distinct, after.cached, after.runs, after.waits), (1 + 2 + 3 + 3, 9, 0, 0));
}

#[test]
fn the_schema_says_types_units_ranges_and_words() {
    let registry = registry();
    let add = kind_schema(registry.get("Add").unwrap());
    let amount = &add["properties"]["amount"];
    assert_eq!(amount["anyOf"][0], json!({"type": "number", "minimum": -100.0, "maximum": 100.0}));
    assert_eq!((&amount["x-unit"], &amount["default"]), (&json!("units"), &json!(0.0)));
    assert_eq!(amount["description"], "What is added.");
    assert_eq!(add["properties"]["rounding"]["anyOf"][0], json!({"enum": ["Exact", "Down"]}));
    assert_eq!(add["properties"]["spelling"]["anyOf"][0], json!({"type": "string", "enum": ["plain", "fancy"]}));
    let constant = kind_schema(registry.get("Constant").unwrap());
    let values = &constant["properties"]["values"]["anyOf"][0];
    assert_eq!(*values, json!({"type": "array", "items": {"type": "number", "minimum": -1e6, "maximum": 1e6}}));
    assert_eq!(constant["properties"]["label"]["anyOf"][0], json!({"anyOf": [{"type": "string"}, {"type": "null"}]}));
    assert_eq!(constant["properties"]["threads"]["x-keyed"], false);
    let all = schema(&registry);
    assert_eq!(all["$schema"], "https://json-schema.org/draft/2020-12/schema");
    let kinds = &all["properties"]["nodes"]["additionalProperties"]["properties"]["kind"]["anyOf"][0]["enum"];
    assert_eq!(kinds.as_array().unwrap().len(), registry.iter().count());
    for kind in registry.iter() {
        assert_eq!(all["$defs"][kind.kind]["properties"]["kind"]["const"], kind.kind);
    }
}

#[test]
fn pictures_show_every_node_wire_and_colour() {
    let made = changed(&[]);
    let tints = [Tint::Hit, Tint::Hit, Tint::Ran, Tint::Waits];
    let picture = Picture::of(&made, &|at| tints[at]);
    let (dot, mermaid, svg) = (picture.dot(), picture.mermaid(), picture.svg());
    assert_eq!(dot.matches(" -> ").count(), 4);
    assert_eq!(mermaid.matches("-->").count(), 4);
    assert_eq!(svg.matches("<rect ").count(), 1 + 4 + 3);
    assert_eq!(svg.matches(">numbers</text>").count(), 4);
    for id in ["a", "b", "c", "d"] {
        assert!(svg.contains(&format!(">{id}</text>")) && dot.contains(&format!("\"{id}\\n")));
    }
    let open = svg.matches('<').count();
    assert_eq!(open, svg.matches('>').count());
    let hostile = Graph::parse("t.ron", "(name: \"<&\\\"\", nodes: {\"a<b>\\\"&\": (kind: \"Constant\")})").unwrap();
    let hostile = Picture::of(&plan(&hostile), &|_| Tint::Plain);
    assert!(hostile.svg().contains("a&lt;b&gt;&quot;&amp;") && hostile.dot().contains("a<b>\\\"&"));
    assert!(!hostile.mermaid().contains("a<b"));
}

#[test]
fn failures_are_told_from_what_was_not_reached() {
    let bench = Bench::new();
    let text = r#"(nodes: {
        "t": (kind: "Trouble"),
        "b": (kind: "Add", inputs: {"numbers": "t.numbers"}),
    })"#;
    let done = bench.run(text);
    assert_eq!(done.count(Status::Failed), 1);
    let found = of_run(&bench, &done);
    assert_eq!((found[0].standing, found[1].standing), (Standing::Miss, Standing::Unknown));
}
