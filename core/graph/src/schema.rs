//! JSON Schema (draft 2020-12) of graph files and of every node's parameters.
//!
//! A graph file is RON; its schema is that of the JSON with the same content: structs and maps are objects, enum
//! variants are words.

use serde_json::{Map, Value, json};

use crate::node::Port;
use crate::params::ParamDoc;
use crate::registry::{NodeKind, Registry};
use crate::syntax::{Span, Spanned, Tree};

const DRAFT: &str = "https://json-schema.org/draft/2020-12/schema";

/// The schema of a whole graph file, with one definition a kind of node under `$defs`.
pub fn schema(registry: &Registry) -> Value {
    let kinds: Vec<&str> = registry.iter().map(|kind| kind.kind).collect();
    let definitions = registry.iter().map(|kind| (kind.kind.to_owned(), node(kind)));
    let mut definitions: Map<String, Value> = definitions.collect();
    definitions.insert("reference".to_owned(), reference());
    definitions.insert("wire".to_owned(), wire());
    let of_kind = |kind: &&str| {
        json!({
            "if": {"properties": {"kind": {"const": kind}}, "required": ["kind"]},
            "then": {"$ref": format!("#/$defs/{kind}")},
        })
    };
    let subgraph = json!({"type": "string", "pattern": "\\.ron$", "description": "A graph file, as a node."});
    json!({
        "$schema": DRAFT,
        "title": "Heartian graph",
        "description": "Typed nodes wired into a dataflow graph.",
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "name": {"type": "string", "description": "The graph's name; that of the file when left out."},
            "doc": {"type": "string", "description": "What it is for."},
            "seed": {"type": "integer", "minimum": 0, "maximum": u64::MAX, "default": 0, "description": "The seed all nodes may use."},
            "extends": {"type": "string", "description": "The graph file that this one changes, relative to this file."},
            "remove": {"type": "array", "items": {"type": "string"}, "description": "Ids of nodes of the extended graph to leave out."},
            "params": {"type": "object", "description": "Values that nodes use as `$name`."},
            "inputs": {"type": "object", "description": "Inputs of a graph that is a node of others: artifact types by name.", "additionalProperties": {"anyOf": [
                {"type": "string"},
                {"type": "object", "additionalProperties": false, "required": ["artifact"], "properties": {
                    "artifact": {"type": "string"}, "optional": {"type": "boolean", "default": false}, "many": {"type": "boolean", "default": false},
                }},
            ]}},
            "exports": {"description": "Outputs written as files, and given by a graph that is a node of others: a list of \"node.port\", or a map from names to them.", "anyOf": [
                {"type": "array", "items": {"type": "string"}},
                {"type": "object", "additionalProperties": {"type": "string"}},
            ]},
            "nodes": {"type": "object", "propertyNames": {"pattern": "^[^.=/\\s]+$"}, "additionalProperties": {
                "type": "object",
                "additionalProperties": false,
                "properties": {
                    "kind": {"anyOf": [{"enum": kinds}, subgraph]},
                    "params": {"type": "object"},
                    "inputs": {"type": "object", "additionalProperties": {"$ref": "#/$defs/wire"}},
                },
                "allOf": kinds.iter().map(of_kind).collect::<Vec<_>>(),
            }},
        },
        "$defs": definitions,
    })
}

fn reference() -> Value {
    json!({"type": "string", "pattern": "^\\$[A-Za-z_][A-Za-z0-9_]*$", "description": "A parameter of the graph."})
}

fn wire() -> Value {
    let output = json!({"type": "string", "description": "\"node.port\", or \"$input\" inside a graph with inputs."});
    json!({"anyOf": [output, {"type": "array", "items": output}]})
}

/// The schema of one kind's parameters.
pub fn kind_schema(kind: &NodeKind) -> Value {
    let Value::Object(mut schema) = params(kind) else { return Value::Null };
    schema.insert("$schema".to_owned(), json!(DRAFT));
    schema.insert("title".to_owned(), json!(kind.kind));
    schema.insert("$defs".to_owned(), json!({"reference": reference()}));
    Value::Object(schema)
}

fn params(kind: &NodeKind) -> Value {
    let defaults = kind.default_node().values().unwrap_or_default();
    let property = |doc: &ParamDoc| (doc.name.to_owned(), param(kind, doc, defaults.get(doc.name)));
    json!({
        "type": "object",
        "description": paragraph(kind.doc),
        "additionalProperties": false,
        "properties": kind.params.iter().map(property).collect::<Map<_, _>>(),
    })
}

/// A node of this kind in a graph file. An overlay may leave anything out, so no input is required here.
fn node(kind: &NodeKind) -> Value {
    let port = |port: &Port| {
        let doc = format!("{} (`{}`{})", port.doc, port.artifact.name, if port.required { "" } else { ", optional" });
        (port.name.to_owned(), json!({"$ref": "#/$defs/wire", "description": doc}))
    };
    let output = |port: &Port| json!({"name": port.name, "artifact": port.artifact.name, "version": port.artifact.version, "description": port.doc, "required": port.required});
    json!({
        "type": "object",
        "description": paragraph(kind.doc),
        "properties": {
            "kind": {"const": kind.kind},
            "params": params(kind),
            "inputs": {"type": "object", "additionalProperties": false, "properties": kind.inputs.iter().map(port).collect::<Map<_, _>>()},
        },
        "x-revision": kind.revision,
        "x-outputs": kind.outputs.iter().map(output).collect::<Vec<_>>(),
    })
}

fn param(kind: &NodeKind, doc: &ParamDoc, default: Option<&Value>) -> Value {
    let mut shape = shape(&doc.type_name.replace(' ', ""), &|value| words(kind, doc.name, value), default);
    limit(&mut shape, doc);
    let mut schema = json!({"anyOf": [shape, {"$ref": "#/$defs/reference"}], "description": doc.text()});
    let Some(fields) = schema.as_object_mut() else { return schema };
    fields.extend(default.map(|default| ("default".to_owned(), default.clone())));
    fields.extend(doc.unit.map(|unit| ("x-unit".to_owned(), json!(unit))));
    if !doc.keyed {
        fields.insert("x-keyed".to_owned(), json!(false));
    }
    schema
}

/// The words that an enum parameter takes, found by offering it one that no enum has.
fn words(kind: &NodeKind, name: &str, wrap: &dyn Fn(Spanned) -> Spanned) -> &'static [&'static str] {
    let offered = Spanned { span: Span::default(), tree: Tree::Text("\u{0}".to_owned()) };
    kind.build(&[(name, &wrap(offered))]).err().map_or(&[], |error| error.words)
}

type Words<'a> = dyn Fn(&dyn Fn(Spanned) -> Spanned) -> &'static [&'static str] + 'a;

/// From the field's Rust type; what that does not say is taken from the words an enum knows, then from the default.
fn shape(name: &str, words: &Words<'_>, default: Option<&Value>) -> Value {
    let inside = |outer: &str| name.strip_prefix(outer).and_then(|rest| rest.strip_suffix('>'));
    if let Some(inner) = inside("Option<") {
        return json!({"anyOf": [shape(inner, words, default.filter(|value| !value.is_null())), {"type": "null"}]});
    }
    let list = |tree: Spanned| Spanned { span: tree.span, tree: Tree::List(vec![tree]) };
    let first = default.and_then(|value| value.get(0));
    if let Some(inner) = inside("Vec<") {
        let words = |wrap: &dyn Fn(Spanned) -> Spanned| words(&|tree| list(wrap(tree)));
        return json!({"type": "array", "items": shape(inner, &words, first)});
    }
    if let Some((inner, length)) = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')?.rsplit_once(';')) {
        let length = default.and_then(Value::as_array).map(Vec::len).or(length.parse().ok());
        let mut array = json!({"type": "array", "items": shape(inner, &|_| &[], first)});
        if let (Some(length), Some(fields)) = (length, array.as_object_mut()) {
            fields.insert("minItems".to_owned(), json!(length));
            fields.insert("maxItems".to_owned(), json!(length));
        }
        return array;
    }
    match name {
        "f64" | "f32" => json!({"type": "number"}),
        "bool" => json!({"type": "boolean"}),
        "String" => json!({"type": "string"}),
        "u8" | "u16" | "u32" | "u64" | "usize" => json!({"type": "integer", "minimum": 0}),
        "i8" | "i16" | "i32" | "i64" | "isize" => json!({"type": "integer"}),
        _ => match words(&|tree| tree) {
            [] => of_value(default),
            words if default.is_some_and(Value::is_object) => json!({"anyOf": [{"enum": words}, {"type": "object"}]}),
            words => json!({"enum": words}),
        },
    }
}

fn of_value(value: Option<&Value>) -> Value {
    match value {
        Some(Value::Bool(_)) => json!({"type": "boolean"}),
        Some(Value::Number(number)) if number.is_f64() => json!({"type": "number"}),
        Some(Value::Number(_)) => json!({"type": "integer"}),
        Some(Value::String(_)) => json!({"type": "string"}),
        Some(Value::Array(_)) => json!({"type": "array"}),
        Some(Value::Object(_)) => json!({"type": "object"}),
        _ => json!({}),
    }
}

/// Ranges and choices, on the numbers and words inside.
fn limit(shape: &mut Value, doc: &ParamDoc) {
    let Some(fields) = shape.as_object_mut() else { return };
    match fields.get("type").and_then(Value::as_str) {
        Some("number" | "integer") => {
            let (least, greatest) = doc.range.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
            let whole = fields.get("type") == Some(&json!("integer"));
            let number = |x: f64| if whole && x.fract() == 0.0 && x.abs() < 1e15 { json!(x as i64) } else { json!(x) };
            for (name, bound) in [("minimum", least), ("maximum", greatest)] {
                if bound.is_finite() {
                    fields.insert(name.to_owned(), number(bound));
                }
            }
        }
        Some("string") if !doc.choices.is_empty() => {
            fields.insert("enum".to_owned(), json!(doc.choices));
        }
        _ => {}
    }
    for name in ["items", "anyOf"] {
        match fields.get_mut(name) {
            Some(Value::Array(inner)) => inner.iter_mut().for_each(|inner| limit(inner, doc)),
            Some(inner) => limit(inner, doc),
            None => {}
        }
    }
}

fn paragraph(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}
