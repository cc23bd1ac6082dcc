//! Every class of mistake in a graph file, with its words, line and column; all at once.

use heartian_graph::{Graph, GraphError, Problem};

use crate::nodes::registry;

fn check(text: &str) -> Vec<String> {
    let problems = match Graph::parse("g.ron", text) {
        Err(GraphError::Problems(problems)) => problems,
        Err(other) => return vec![other.to_string()],
        Ok(graph) => match graph.plan(&registry(), &[]) {
            Ok(_) => return Vec::new(),
            Err(problems) => problems,
        },
    };
    problems.0.iter().map(Problem::one_line).collect()
}

#[test]
fn everything_wrong_is_said_at_once_in_the_order_of_the_file() {
    let found = check(
        r#"Graph(name: "bad", nodes: {
    "a": (kind: "Constnat"),
    "b": (kind: "Constant", params: (valeus: [1], threads: -1)),
    "c": (kind: "Add", params: (amount: "much", rounding: Up), inputs: {"numbers": "b.number"}),
    "d": (kind: "Spell", inputs: {"numbers": "bb.numbers"}),
    "e": (kind: "Add", params: (amount: 1000), inputs: {"numbers": "d.word"}),
    "f": (kind: "Sum", inputs: {"term": "b.numbers"}),
    "g": (kind: "Add", inputs: {"numbers": ["b.numbers", "e.numbers"]}),
})"#,
    );
    let expected = [
        "g.ron:2:17: there is no kind of node `Constnat` (did you mean `Constant`?)",
        "g.ron:3:38: node `b` (Constant) has no parameter `valeus` (did you mean `values`?)",
        "g.ron:3:60: node `b`: parameter `threads`: invalid value: integer `-1`, expected usize (Does not matter.)",
        "g.ron:4:41: node `c`: parameter `amount`: invalid type: string \"much\", expected f64 (What is added.)",
        "g.ron:4:59: node `c`: parameter `rounding`: unknown variant `Up`, expected `Exact` or `Down` \
         (Whether the sum is rounded.)",
        "g.ron:4:84: node `b` (Constant) has no output `number` (did you mean `numbers`?)",
        "g.ron:5:46: there is no node `bb` (did you mean `b`?)",
        "g.ron:6:41: node `e`: parameter `amount` is 1000; it must be from -100 to 100 units (What is added.)",
        "g.ron:6:68: `d.word` gives `word`, but `e.numbers` takes `numbers` \
         (outputs that fit: b.numbers, c.numbers, f.numbers, g.numbers)",
        "g.ron:7:5: node `f` (Sum) needs its input `terms` (`terms` carries `numbers`: What is added. \
         (outputs that fit: b.numbers, c.numbers, e.numbers, g.numbers))",
        "g.ron:7:33: node `f` (Sum) has no input `term` (did you mean `terms`?)",
        "g.ron:8:58: `g.numbers` takes one wire, not 2",
    ];
    assert_eq!(found, expected);
}

/// A part that cannot be read is reported with the rest, and invents no second mistake.
#[test]
fn structural_and_other_mistakes_are_said_together() {
    let found = check(
        r#"(nodes: {
    "a": (kind: "Constant", params: [1]),
    "b": (kind: "Add", inputs: {"numbers": 3}),
    "c": (kind: "Add", inputs: {"numbers": "b.nombres"}, extra: 1),
    "d": (params: (amount: 1)),
    "e": (kind: "Add", inputs: {"numbers": "d.numbers"}, params: (amount: "x")),
}, nam: "n")"#,
    );
    let expected = [
        "g.ron:2:37: expected parameters in parentheses, `(name: value)`, found a list",
        "g.ron:3:44: expected \"node.port\" or a list of them, found a number",
        "g.ron:4:58: a node has no field `extra` (fields: kind, params, inputs)",
        "g.ron:5:5: node `d` has no kind (nodes so far: a, b, c)",
        "g.ron:6:75: node `e`: parameter `amount`: invalid type: string \"x\", expected f64 (What is added.)",
        "g.ron:7:4: a graph has no field `nam` (did you mean `name`?)",
    ];
    assert_eq!(found, expected);
}

#[test]
fn cycles_are_printed_as_their_path() {
    let found = check(
        r#"(nodes: {
    "z": (kind: "Add", inputs: {"numbers": "c.numbers"}),
    "a": (kind: "Add", inputs: {"numbers": "c.numbers"}),
    "b": (kind: "Add", inputs: {"numbers": "a.numbers"}),
    "c": (kind: "Add", inputs: {"numbers": "b.numbers"}),
})"#,
    );
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].contains("these nodes wait for one another: a → b → c → a"), "{found:?}");
    let itself = check(r#"(nodes: {"a": (kind: "Add", inputs: {"numbers": "a.numbers"})})"#);
    assert_eq!(
        itself,
        ["g.ron:1:10: these nodes wait for one another: a → a (a graph flows one way; cut one of these wires)"]
    );
}

#[test]
fn each_other_mistake_has_its_words() {
    let cases: [(&str, &str); 24] = [
        ("", "g.ron:1:1: expected a value, the text ends"),
        ("Graph(", "g.ron:1:6: this is never closed; `)` is missing"),
        ("Graph(name: \"x)", "g.ron:1:13: this string is never closed; `\"` is missing"),
        ("Graph(name: \"x\"\n  doc: \"y\")", "g.ron:2:3: expected `,` or `)`, found `d`"),
        ("Graph(name: \"é\", nodes: {\"a\" (kind: 3)})", "g.ron:1:30: expected `:`, found `(`"),
        ("Grahp(nodes: {})", "g.ron:1:1: expected `Graph(..)`, found `Grahp`"),
        ("(nodes: {}) x", "g.ron:1:13: expected the end of the text, found `x`"),
        ("(nodes: {})", "g.ron:1:1: the graph has no nodes"),
        ("(nods: {})", "g.ron:1:2: a graph has no field `nods` (did you mean `nodes`?)"),
        ("(nodes: [])", "g.ron:1:9: expected a map of nodes, found a list"),
        ("(seed: -1)", "g.ron:1:8: expected a whole number from 0 to 2^64 − 1, found a number"),
        ("(name: \"a\", name: \"b\")", "g.ron:1:13: field `name` is given twice"),
        ("(nodes: {\"a\": (kind: \"Maybe\"), \"a\": (kind: \"Maybe\")})", "g.ron:1:32: node `a` is given twice"),
        (
            "(nodes: {\"a\": (kind: \"Maybe\", parms: ())})",
            "g.ron:1:31: a node has no field `parms` (did you mean `params`?)",
        ),
        ("(nodes: {\"a\": (params: ())})", "g.ron:1:10: node `a` has no kind"),
        ("(nodes: {\"a\": (kind: Maybe)})", "g.ron:1:22: expected a kind of node as a string, found a bare word"),
        (
            "(nodes: {\"a.b\": (kind: \"Maybe\")})",
            "g.ron:1:10: `a.b` cannot be a node's id (use letters, digits, `_` and `-`)",
        ),
        (
            "(nodes: {\"a\": (kind: \"Constant\", params: (values: []))})",
            "g.ron:1:51: node `a`: parameter `values`: is empty; give at least one number",
        ),
        (
            "(nodes: {\"a\": (kind: \"Constant\", params: (values: [1, NaN]))})",
            "g.ron:1:55: node `a`: parameter `values` must be a finite number",
        ),
        (
            "(nodes: {\"a\": (kind: \"Constant\", params: (label: word))})",
            "g.ron:1:50: node `a`: parameter `label`: expected a string, found the bare word `word`; write \"word\" (Names the numbers.)",
        ),
        (
            "(exports: [\"b.numbers\"], nodes: {\"a\": (kind: \"Maybe\")})",
            "g.ron:1:12: there is no node `b` (nodes: a)",
        ),
        (
            "(nodes: {\"a\": (kind: \"Maybe\"), \"b\": (kind: \"Add\", inputs: {\"numbers\": \"a\"})})",
            "g.ron:1:71: `a` names no output; write \"node.port\" (did you mean `a.numbers`?)",
        ),
        (
            "(nodes: {\"a\": (kind: \"Maybe\"), \"b\": (kind: \"Add\", params: (spelling: \"fanci\"), inputs: {\"numbers\": \"a.numbers\"})})",
            "g.ron:1:70: node `b`: parameter `spelling` is `fanci`; it must be one of plain, fancy (did you mean `fancy`?) (How the sum is spelt.)",
        ),
        (
            "(nodes: {\"a\": (kind: \"ReadFile\", params: (path: \"/no/such\"))})",
            "g.ron:1:49: node `a`: parameter `path` names `/no/such`, which cannot be read: No such file or directory (os error 2) (give a file)",
        ),
    ];
    for (text, expected) in cases {
        let found = check(text);
        assert!(found.len() == 1 && found[0].starts_with(expected), "{text}\n{found:?}\n{expected}");
    }
}

#[test]
fn unknown_targets_are_proposed() {
    let graph = Graph::parse("g.ron", "(nodes: {\"render\": (kind: \"Maybe\")})").unwrap();
    let problems = graph.plan(&registry(), &["rendr".to_owned()]).err().unwrap();
    assert_eq!(problems.0[0].one_line(), "--target:1:1: the graph has no node `rendr` (did you mean `render`?)");
}

#[test]
fn a_missing_file_says_what_to_check() {
    let error = Graph::load(std::path::Path::new("no/such/graph.ron")).unwrap_err();
    assert!(error.to_string().starts_with("cannot read the graph `no/such/graph.ron`"), "{error}");
}

/// The fancy report shows file, line, column and the source line underlined.
#[test]
fn reports_underline_the_source() {
    let graph = Graph::parse("graphs/g.ron", "(nodes: {\n    \"a\": (kind: \"Constnat\"),\n})").unwrap();
    let problems = graph.plan(&registry(), &[]).err().unwrap();
    let mut text = String::new();
    let theme = miette::GraphicalTheme::unicode_nocolor();
    miette::GraphicalReportHandler::new_themed(theme).render_report(&mut text, &problems).unwrap();
    for part in ["[graphs/g.ron:2:17]", "\"a\": (kind: \"Constnat\")", "╰", "did you mean `Constant`?"] {
        assert!(text.contains(part), "{text}");
    }
}
