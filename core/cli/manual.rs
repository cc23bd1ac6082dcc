//! `heartian nodes`: the manual, made from the nodes' own doc lines.

use std::fmt::Write;
use std::process::ExitCode;

use heartian_graph::{NodeKind, ParamDoc, Port};
use miette::{Result, miette};
use serde_json::Value;

use crate::plugins;
use crate::summary::table;

/// Prints the list of kinds, or one kind's manual.
pub fn print(kind: Option<&str>) -> Result<ExitCode> {
    let registry = plugins::registry()?;
    let Some(name) = kind else {
        let widest = registry.iter().map(|kind| kind.kind.len()).max().unwrap_or(0);
        for kind in registry.iter() {
            let name = format!("  {:widest$}  ", kind.kind);
            print!("{}", wrapped(&name, &first_sentence(kind.doc)));
        }
        println!("\n`heartian nodes KIND` prints the manual of one.");
        return Ok(ExitCode::SUCCESS);
    };
    let found = registry.get(name).or_else(|| registry.iter().find(|kind| kind.kind.eq_ignore_ascii_case(name)));
    let Some(kind) = found else {
        let known: Vec<&str> = registry.iter().map(|kind| kind.kind).collect();
        return Err(miette!(help = format!("kinds: {}", known.join(", ")), "there is no kind of node `{name}`"));
    };
    print!("{}", page(kind));
    Ok(ExitCode::SUCCESS)
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
