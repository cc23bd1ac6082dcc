//! The reader against hostile text, and against the `ron` crate.

use heartian_graph::{Graph, GraphError, Problem};
use proptest::prelude::*;

use crate::nodes::registry;

/// Reads and checks whatever it is given; places must lie in the text.
fn survive(text: &str) {
    let problems = match Graph::parse("p.ron", text) {
        Ok(graph) => graph.plan(&registry(), &[]).err(),
        Err(GraphError::Problems(problems)) => Some(problems),
        Err(_) => None,
    };
    for problem in problems.iter().flat_map(|problems| &problems.0) {
        let _ = problem.one_line();
        let mut rendered = String::new();
        let handler = miette::GraphicalReportHandler::new_themed(miette::GraphicalTheme::unicode_nocolor());
        handler.render_report(&mut rendered, problem as &Problem).unwrap();
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

    #[test]
    fn any_text_is_read_or_refused(text in "\\PC{0,60}") {
        survive(&text);
    }

    #[test]
    fn any_pile_of_ron_tokens_is_read_or_refused(tokens in proptest::collection::vec(prop_oneof![
        Just("("), Just(")"), Just("["), Just("]"), Just("{"), Just("}"), Just(":"), Just(","), Just("\""), Just("\\"),
        Just("Graph"), Just("nodes"), Just("kind"), Just("\"a\""), Just("\"Add\""), Just("\"a.numbers\""), Just("params"),
        Just("inputs"), Just("'"), Just("r#\""), Just("#!["), Just("//"), Just("/*"), Just("*/"), Just("\n"), Just("-"),
        Just("1e"), Just("0x"), Just("9.5"), Just("\\u{"), Just("é"), Just("Some"), Just(" "), Just("extends"),
    ], 0..40)) {
        survive(&tokens.concat());
    }

    #[test]
    fn any_setting_is_taken_or_refused(start in prop_oneof![Just(""), Just("a.values="), Just("a."), Just("a.label=")],
                                       rest in "\\PC{0,20}") {
        let mut graph = Graph::parse("p.ron", "(nodes: {\"a\": (kind: \"Constant\")})").unwrap();
        graph.set(&format!("{start}{rest}"));
        for problem in graph.plan(&registry(), &[]).err().iter().flat_map(|problems| &problems.0) {
            prop_assert!(!problem.one_line().is_empty());
        }
    }

    #[test]
    fn a_damaged_graph_is_read_or_refused(at in 0usize..200, with in "\\PC{0,3}", cut in 0usize..6) {
        let text = "Graph(name: \"n\", nodes: {\"a\": (kind: \"Constant\", params: (values: [1, -2.5e3], label: Some(\"é\"))), \
                    \"b\": (kind: \"Sum\", inputs: {\"terms\": [\"a.numbers\", \"a.numbers\"]})}) // end";
        let characters: Vec<char> = text.chars().collect();
        let at = at.min(characters.len());
        let rest = characters[at..].iter().skip(cut);
        let damaged: String = characters[..at].iter().copied().chain(with.chars()).chain(rest.copied()).collect();
        survive(&damaged);
    }
}

#[test]
fn depth_is_bounded() {
    for text in
        ["(".repeat(100_000), "[".repeat(100_000), "{".repeat(100_000), "A(".repeat(100_000), "/*".repeat(100_000)]
    {
        survive(&text);
    }
    survive(&format!(
        "(nodes: {{\"a\": (kind: \"Constant\", params: (values: {}1{}))}})",
        "[".repeat(60),
        "]".repeat(60)
    ));
}

#[test]
fn wide_texts_are_read_in_linear_time() {
    let start = std::time::Instant::now();
    let list = "1, ".repeat(300_000);
    survive(&format!("(nodes: {{\"a\": (kind: \"Constant\", params: (values: [{list}]))}})"));
    survive(&"//".repeat(300_000));
    survive(&"(".repeat(20).repeat(1000));
    assert!(start.elapsed().as_secs() < 20, "{:?}", start.elapsed());
}
