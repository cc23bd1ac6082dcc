//! `heartian nodes`: the manual, made from the nodes' own doc lines.

use std::fmt::Write;
use std::process::ExitCode;

use heartian_graph::{NodeKind, ParamDoc, Port, Registry};
use miette::{IntoDiagnostic, Result, miette};
use serde_json::{Value, json};

use crate::plugins;
use crate::summary::table;

/// Prints the list of kinds, or one kind's manual.
pub fn print(kind: Option<&str>, json: bool) -> Result<ExitCode> {
    let registry = plugins::registry()?;
    if json {
        let kinds: Vec<&NodeKind> = match kind {
            Some(name) => vec![find(registry, name)?],
            None => registry.iter().collect(),
        };
        let all: Vec<Value> = kinds.into_iter().map(describe).collect();
        let one = kind.and_then(|_| all.first().cloned());
        return print_json(&one.unwrap_or(Value::Array(all)));
    }
    let Some(name) = kind else {
        let widest = registry.iter().map(|kind| kind.kind.len()).max().unwrap_or(0);
        for kind in registry.iter() {
            let name = format!("  {:widest$}  ", kind.kind);
            print!("{}", wrapped(&name, &first_sentence(kind.doc)));
        }
        println!("\n`heartian nodes KIND` prints the manual of one.");
        return Ok(ExitCode::SUCCESS);
    };
    print!("{}", page(find(registry, name)?));
    Ok(ExitCode::SUCCESS)
}

/// Prints the JSON Schema of graph files, or of one kind's parameters.
pub fn schema(kind: Option<&str>) -> Result<ExitCode> {
    let registry = plugins::registry()?;
    match kind {
        Some(name) => print_json(&heartian_graph::kind_schema(find(registry, name)?)),
        None => print_json(&heartian_graph::schema(registry)),
    }
}

fn print_json(value: &Value) -> Result<ExitCode> {
    println!("{}", serde_json::to_string_pretty(value).into_diagnostic()?);
    Ok(ExitCode::SUCCESS)
}

fn find<'r>(registry: &'r Registry, name: &str) -> Result<&'r NodeKind> {
    let found = registry.get(name).or_else(|| registry.iter().find(|kind| kind.kind.eq_ignore_ascii_case(name)));
    found.ok_or_else(|| {
        let known: Vec<&str> = registry.iter().map(|kind| kind.kind).collect();
        miette!(help = format!("kinds: {}", known.join(", ")), "there is no kind of node `{name}`")
    })
}

/// All that a program may want to know of a kind.
fn describe(kind: &NodeKind) -> Value {
    let port = |port: &Port| {
        json!({"name": port.name, "artifact": port.artifact.name, "version": port.artifact.version, "doc": port.doc,
               "many": port.many, "required": port.required})
    };
    let defaults = kind.default_node().values().unwrap_or_default();
    let param = |param: &ParamDoc| {
        let bound = |value: f64| value.is_finite().then_some(value);
        json!({"name": param.name, "type": param.type_name, "doc": param.text(), "unit": param.unit,
               "default": defaults.get(param.name), "minimum": param.range.and_then(|range| bound(range.0)),
               "maximum": param.range.and_then(|range| bound(range.1)), "choices": param.choices, "keyed": param.keyed})
    };
    json!({
        "kind": kind.kind,
        "revision": kind.revision,
        "implementation": kind.implementation,
        "doc": paragraph(kind.doc),
        "inputs": kind.inputs.iter().map(port).collect::<Vec<_>>(),
        "outputs": kind.outputs.iter().map(port).collect::<Vec<_>>(),
        "params": kind.params.iter().map(param).collect::<Vec<_>>(),
        "schema": heartian_graph::kind_schema(kind),
    })
}

fn paragraph(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Wider lines are broken.
const WIDTH: usize = 100;

/// `first` and then the words, broken into lines that start below where the words start.
fn wrapped(first: &str, words: &str) -> String {
    let indent = first.chars().count();
    let (mut text, mut column) = (first.to_owned(), indent);
    for word in words.split_whitespace() {
        let length = word.chars().count();
        if column > indent && column + 1 + length > WIDTH {
            let _ = write!(text, "\n{:indent$}", "");
            column = indent;
        } else if column > indent {
            text.push(' ');
            column += 1;
        }
        text.push_str(word);
        column += length;
    }
    text.push('\n');
    text
}

fn first_sentence(doc: &str) -> String {
    let text = paragraph(doc);
    text.split_once(". ").map_or(text.clone(), |(sentence, _)| format!("{sentence}."))
}

pub fn page(kind: &NodeKind) -> String {
    let mut text = format!("{} (revision {})\n\n{}", kind.kind, kind.revision, wrapped("", kind.doc));
    for (title, ports) in [("Inputs", kind.inputs), ("Outputs", kind.outputs)] {
        if !ports.is_empty() {
            let _ = write!(text, "\n{title}\n{}", table(&ports.iter().map(port_row).collect::<Vec<_>>(), &[]));
        }
    }
    if kind.params.is_empty() {
        return text;
    }
    let defaults = kind.default_node().values().unwrap_or_default();
    let _ = write!(text, "\nParameters\n");
    for param in kind.params {
        let default = defaults.get(param.name).map_or(String::new(), as_ron);
        let _ = writeln!(text, "  {}: {default}{}", param.name, bounds(param));
        text.push_str(&wrapped("      ", &param.text()));
    }
    text
}

fn port_row(port: &Port) -> Vec<String> {
    let many = if port.many { "list of " } else { "" };
    let optional = if port.required { "" } else { ", optional" };
    vec![port.name.to_owned(), format!("{many}{}{optional}", port.artifact.name), port.doc.to_owned()]
}

fn bounds(param: &ParamDoc) -> String {
    let unit = param.unit.map_or(String::new(), |unit| format!(" {unit}"));
    let range = match param.range {
        Some((least, greatest)) if least.is_finite() && greatest.is_finite() => format!(", {least} to {greatest}"),
        Some((least, _)) if least.is_finite() => format!(", at least {least}"),
        Some((_, greatest)) => format!(", at most {greatest}"),
        None => String::new(),
    };
    let choices =
        if param.choices.is_empty() { String::new() } else { format!(", one of {}", param.choices.join(", ")) };
    let unkeyed = if param.keyed { "" } else { ", does not change the output" };
    format!("{unit}{range}{choices}{unkeyed}")
}

/// A default as a graph file would say it; near enough for reading.
fn as_ron(value: &Value) -> String {
    match value {
        Value::Null => "None".to_owned(),
        Value::Array(values) => format!("[{}]", values.iter().map(as_ron).collect::<Vec<_>>().join(", ")),
        Value::Object(map) => {
            let fields: Vec<String> = map.iter().map(|(name, value)| format!("{name}: {}", as_ron(value))).collect();
            format!("({})", fields.join(", "))
        }
        Value::Number(number) if number.is_f64() => number.as_f64().map_or(String::new(), ParamDoc::show),
        other => other.to_string(),
    }
}
