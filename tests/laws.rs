//! Laws of all nodes, proved by walking the registry.

use std::collections::{BTreeMap, BTreeSet};

use heartian_graph::{Graph, NodeKind, ParamDoc, Port, Registry};

fn kinds() -> Vec<NodeKind> {
    let all = Registry::all_compiled_in();
    assert!(!all.is_empty(), "no node is linked");
    all
}

fn is_snake(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
}

/// A doc line says something: it starts a sentence or a word, and ends like one.
fn is_documented(doc: &str) -> bool {
    let doc = doc.trim();
    doc.len() >= 8 && doc.ends_with(['.', ')', '!', '?'])
}

#[test]
fn kinds_are_unique_and_well_named() {
    let mut seen = BTreeSet::new();
    for kind in kinds() {
        assert!(seen.insert(kind.kind), "two nodes are called {}", kind.kind);
        let camel = kind.kind.starts_with(|c: char| c.is_ascii_uppercase())
            && kind.kind.chars().all(|c| c.is_ascii_alphanumeric());
        assert!(camel, "{} is not UpperCamelCase", kind.kind);
        assert!(kind.revision >= 1, "{} has no revision", kind.kind);
    }
}

#[test]
fn everything_is_documented() {
    let mut silent = Vec::new();
    for kind in kinds() {
        if !is_documented(kind.doc) {
            silent.push(kind.kind.to_owned());
        }
        let ports = kind.inputs.iter().chain(kind.outputs).map(|port| (port.name, port.doc.to_owned()));
        let params = kind.params.iter().map(|param| (param.name, param.text()));
        silent.extend(
            ports.chain(params).filter(|(_, doc)| !is_documented(doc)).map(|(name, _)| format!("{}.{name}", kind.kind)),
        );
    }
    assert!(silent.is_empty(), "these need a doc line that ends in a full stop: {silent:?}");
}

#[test]
fn ports_are_unique_and_named_alike() {
    for kind in kinds() {
        assert!(!kind.outputs.is_empty(), "{} makes nothing", kind.kind);
        for ports in [kind.inputs, kind.outputs] {
            let names: BTreeSet<&str> = ports.iter().map(|port| port.name).collect();
            assert_eq!(names.len(), ports.len(), "{} repeats a port", kind.kind);
            assert!(names.iter().all(|name| is_snake(name)), "{}: {names:?}", kind.kind);
        }
        assert!(kind.outputs.iter().all(|port| !port.many), "{}: an output carries one value", kind.kind);
    }
}

/// One name, one on-disk form: two crates that disagree would read each other's artifacts wrongly.
#[test]
fn artifact_types_agree_on_their_version() {
    let mut versions: BTreeMap<&str, (u32, &str)> = BTreeMap::new();
    for kind in kinds() {
        for Port { artifact, .. } in kind.inputs.iter().chain(kind.outputs) {
            let (version, by) = *versions.entry(artifact.name).or_insert((artifact.version, kind.kind));
            assert_eq!(version, artifact.version, "`{}` differs between {by} and {}", artifact.name, kind.kind);
        }
    }
}

#[test]
fn defaults_are_valid_and_complete() {
    for kind in kinds() {
        let node = kind.default_node();
        let values = node.values().unwrap();
        let documented: BTreeSet<&str> = kind.params.iter().map(|param| param.name).collect();
        assert_eq!(values.keys().map(String::as_str).collect::<BTreeSet<_>>(), documented, "{}", kind.kind);
        assert_eq!(documented.len(), kind.params.len(), "{} repeats a parameter", kind.kind);
        assert_eq!(node.validate(), [], "{}", kind.kind);
        for source in node.sources() {
            assert!(documented.contains(source.parameter), "{}: {source:?} names no parameter", kind.kind);
        }
        for ParamDoc { name, range, choices, .. } in kind.params {
            assert!(is_snake(name), "{}.{name}", kind.kind);
            let Some(number) = values[*name].as_f64() else { continue };
            let inside = range.is_none_or(|(least, greatest)| (least..=greatest).contains(&number));
            assert!(inside && choices.is_empty(), "{}.{name} is {number}", kind.kind);
        }
    }
}

/// Defaults written out as a graph file would write them plan to the very same node.
#[test]
fn defaults_survive_being_written_out() {
    for kind in kinds().iter().filter(|kind| kind.inputs.iter().all(|port| !port.required)) {
        let values = kind.default_node().values().unwrap();
        let params: Vec<String> = values.iter().map(|(name, value)| format!("{name}: {}", ron_of(value))).collect();
        let text = format!("(nodes: {{\"n\": (kind: \"{}\", params: ({}))}})", kind.kind, params.join(", "));
        let plan = Graph::parse("defaults.ron", &text).unwrap().plan(&Registry::compiled_in(), &[]);
        match plan {
            Ok(plan) => assert_eq!(plan.nodes[0].values, values, "{}", kind.kind),
            Err(problems) => {
                panic!("{:?}", problems.0.iter().map(heartian_graph::Problem::one_line).collect::<Vec<_>>())
            }
        }
    }
}

fn ron_of(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Null => "None".to_owned(),
        serde_json::Value::Array(values) => format!("[{}]", values.iter().map(ron_of).collect::<Vec<_>>().join(", ")),
        serde_json::Value::Object(map) => {
            let fields: Vec<String> = map.iter().map(|(name, value)| format!("{name}: {}", ron_of(value))).collect();
            format!("({})", fields.join(", "))
        }
        other => other.to_string(),
    }
}
