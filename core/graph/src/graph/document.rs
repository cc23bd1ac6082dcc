//! One graph file: from the tree of its text to named parts, with every misfit reported.

use std::collections::HashMap;
use std::sync::Arc;

use crate::diagnostic::{Place, Problem, Problems, Source, suggest};
use crate::syntax::{Name, Span, Spanned, SyntaxError, Tree, is_name, read};

use super::{Located, ParamValue};

/// What feeds one input port, as the file says it.
#[derive(Clone, Debug)]
pub(super) struct WireEntry {
    pub port: Located<String>,
    /// `node.port` or `$input`, each.
    pub from: Vec<Located<String>>,
}

/// An input that a graph takes when it is a node of another graph.
#[derive(Clone, Debug)]
pub(crate) struct InputEntry {
    pub name: Located<String>,
    /// Name of the artifact type it carries.
    pub artifact: Located<String>,
    pub optional: bool,
    /// Takes a list of wires.
    pub many: bool,
}

/// An output that a graph gives: `node.port` under a name, which is the port's own unless the file says another.
#[derive(Clone, Debug)]
pub(super) struct ExportEntry {
    pub name: Located<String>,
    pub output: Located<String>,
}

/// A node as one file says it; an overlay may leave out the kind.
#[derive(Clone, Debug)]
pub(super) struct NodeEntry {
    pub id: Located<String>,
    pub kind: Option<Located<String>>,
    pub params: Vec<(Located<String>, ParamValue)>,
    pub inputs: Vec<WireEntry>,
    /// Some part could not be read, which is reported.
    pub broken: bool,
}

/// One file.
#[derive(Debug, Default)]
pub(super) struct Document {
    pub name: Option<String>,
    pub doc: Option<String>,
    pub seed: Option<u64>,
    pub extends: Option<Located<String>>,
    pub remove: Vec<Located<String>>,
    pub params: Vec<(Located<String>, ParamValue)>,
    pub inputs: Option<Vec<InputEntry>>,
    pub exports: Option<Vec<ExportEntry>>,
    pub nodes: Vec<NodeEntry>,
    /// The text is not RON, which is reported; nothing of it is here.
    pub unreadable: bool,
}

const GRAPH_FIELDS: [&str; 9] = ["name", "doc", "seed", "extends", "remove", "params", "inputs", "exports", "nodes"];
const INPUT_FIELDS: [&str; 3] = ["artifact", "optional", "many"];
const NODE_FIELDS: [&str; 3] = ["kind", "params", "inputs"];

/// Reads one file's text; the document holds what could be read, `problems` the rest.
pub(super) fn read_document(source: &Arc<Source>, problems: &mut Problems) -> Document {
    let mut reader = Reader { source, problems };
    match read(source.text()) {
        Ok(tree) => reader.graph(&tree),
        Err(SyntaxError { span, message, help }) => {
            let problem = Problem::new(&reader.place(span), message).maybe_help(help);
            reader.problems.push(problem);
            Document { unreadable: true, ..Document::default() }
        }
    }
}

struct Reader<'a> {
    source: &'a Arc<Source>,
    problems: &'a mut Problems,
}

impl Reader<'_> {
    fn place(&self, span: Span) -> Place {
        Place { source: self.source.clone(), span }
    }

    fn located(&self, span: Span, text: &str) -> Located<String> {
        Located { value: text.to_owned(), place: self.place(span) }
    }

    fn expected(&mut self, what: &str, value: &Spanned) {
        let message = format!("expected {what}, found {}", value.tree.describe());
        self.problems.push(Problem::new(&self.place(value.span), message));
    }

    fn text(&mut self, what: &str, value: &Spanned) -> Option<Located<String>> {
        match &value.tree {
            Tree::Text(text) => Some(self.located(value.span, text)),
            _ => {
                self.expected(what, value);
                None
            }
        }
    }

    fn texts(&mut self, what: &str, value: &Spanned) -> Vec<Located<String>> {
        match &value.tree {
            Tree::List(items) => items.iter().filter_map(|item| self.text("a string", item)).collect(),
            _ => {
                self.expected(what, value);
                Vec::new()
            }
        }
    }

    /// Fields of a struct without repetitions; `()` has none.
    fn fields<'t>(&mut self, what: &str, value: &'t Spanned) -> Vec<&'t (Name, Spanned)> {
        let mut seen = HashMap::new();
        match &value.tree {
            Tree::Struct { fields, .. } => fields
                .iter()
                .filter(|(name, _)| match seen.insert(name.text.as_str(), name.span) {
                    Some(first) => {
                        self.repeated("field", &name.text, [first, name.span]);
                        false
                    }
                    None => true,
                })
                .collect(),
            Tree::Tuple { items, .. } if items.is_empty() => Vec::new(),
            _ => {
                self.expected(what, value);
                Vec::new()
            }
        }
    }

    /// Entries of a map with string keys, without repetitions.
    fn entries<'t>(&mut self, what: &str, key_what: &str, value: &'t Spanned) -> Vec<(Located<String>, &'t Spanned)> {
        let Tree::Map(pairs) = &value.tree else {
            self.expected(what, value);
            return Vec::new();
        };
        let mut seen = HashMap::new();
        let mut entries = Vec::with_capacity(pairs.len());
        for (key, value) in pairs {
            let Tree::Text(text) = &key.tree else {
                self.expected(&format!("{key_what} as a string"), key);
                continue;
            };
            match seen.insert(text.as_str(), key.span) {
                Some(first) => self.repeated(key_what, text, [first, key.span]),
                None => entries.push((self.located(key.span, text), value)),
            }
        }
        entries
    }

    fn repeated(&mut self, what: &str, name: &str, [first, second]: [Span; 2]) {
        let problem = Problem::new(&self.place(second), format!("{what} `{name}` is given twice"))
            .label("again here")
            .also(&self.place(first), "first here");
        self.problems.push(problem);
    }

    fn unknown(&mut self, name: &Name, known: &[&str], what: &str) {
        let problem = Problem::new(&self.place(name.span), format!("{what} has no field `{}`", name.text));
        self.problems.push(problem.maybe_help(suggest(&name.text, known.iter().copied(), "fields")));
    }

    fn graph(&mut self, tree: &Spanned) -> Document {
        let mut document = Document::default();
        if let Tree::Struct { name: Some(name), .. } | Tree::Tuple { name: Some(name), .. } = &tree.tree
            && name.text != "Graph"
        {
            let problem = Problem::new(&self.place(name.span), format!("expected `Graph(..)`, found `{}`", name.text));
            self.problems.push(problem);
        }
        for (name, value) in self.fields("`Graph(..)`", tree) {
            match name.text.as_str() {
                "name" => document.name = self.text("a string", value).map(|text| text.value),
                "doc" => document.doc = self.text("a string", value).map(|text| text.value),
                "seed" => document.seed = self.seed(value),
                "extends" => document.extends = self.text("a file name as a string", value),
                "remove" => document.remove = self.texts("a list of node ids", value),
                "params" => document.params = self.graph_params(value),
                "inputs" => {
                    let entries = self.entries("a map from inputs to artifact types", "input", value);
                    document.inputs =
                        Some(entries.into_iter().filter_map(|(name, value)| self.input(name, value)).collect());
                }
                "exports" => document.exports = Some(self.exports(value)),
                "nodes" => {
                    let entries = self.entries("a map of nodes", "node", value);
                    document.nodes = entries.into_iter().map(|(id, value)| self.node(id, value)).collect();
                }
                _ => self.unknown(name, &GRAPH_FIELDS, "a graph"),
            }
        }
        document
    }

    fn seed(&mut self, value: &Spanned) -> Option<u64> {
        let seed = match value.tree {
            Tree::Integer(seed) => u64::try_from(seed).ok(),
            _ => None,
        };
        if seed.is_none() {
            self.expected("a whole number from 0 to 2^64 − 1", value);
        }
        seed
    }

    fn node(&mut self, id: Located<String>, value: &Spanned) -> NodeEntry {
        let before = self.problems.0.len();
        if id.value.is_empty() || id.value.contains(['.', '=', '/']) || id.value.chars().any(char::is_whitespace) {
            let problem = Problem::new(&id.place, format!("`{}` cannot be a node's id", id.value));
            self.problems.push(problem.help("use letters, digits, `_` and `-`"));
        }
        let mut entry = NodeEntry { id, kind: None, params: Vec::new(), inputs: Vec::new(), broken: false };
        for (name, value) in self.fields("`(kind: .., params: (..), inputs: {..})`", value) {
            match name.text.as_str() {
                "kind" => entry.kind = self.text("a kind of node as a string", value),
                "params" => entry.params = self.params(value),
                "inputs" => {
                    let entries = self.entries("a map from ports to \"node.port\"", "port", value);
                    entry.inputs = entries.into_iter().map(|(port, value)| self.wire(port, value)).collect();
                }
                _ => self.unknown(name, &NODE_FIELDS, "a node"),
            }
        }
        entry.broken = self.problems.0.len() > before;
        entry
    }

    fn params(&mut self, value: &Spanned) -> Vec<(Located<String>, ParamValue)> {
        let fields = self.fields("parameters in parentheses, `(name: value)`", value);
        fields.into_iter().map(|(name, value)| self.param(self.located(name.span, &name.text), value)).collect()
    }

    fn param(&self, name: Located<String>, value: &Spanned) -> (Located<String>, ParamValue) {
        (name, ParamValue { tree: Some(value.clone()), bare: None, place: self.place(value.span) })
    }

    /// The graph's own parameters: names that nodes use as `$name`. Their values are plain.
    fn graph_params(&mut self, value: &Spanned) -> Vec<(Located<String>, ParamValue)> {
        let entries = match &value.tree {
            Tree::Map(_) => self.entries("a map of parameters", "parameter", value),
            _ => {
                let fields = self.fields("a map of parameters, `{\"name\": value}`", value);
                fields.into_iter().map(|(name, value)| (self.located(name.span, &name.text), value)).collect()
            }
        };
        let mut params = Vec::with_capacity(entries.len());
        for (name, value) in entries {
            if !is_name(&name.value) {
                let problem = Problem::new(&name.place, format!("`{}` cannot be a parameter's name", name.value));
                self.problems.push(problem.help("use letters, digits and `_`, so that `$name` can be written"));
            } else if let Some(inner) = find_reference(value) {
                let message = format!("the graph's parameter `{}` refers to another", name.value);
                self.problems.push(Problem::new(&self.place(inner), message).help("give it a plain value"));
            } else {
                params.push(self.param(name, value));
            }
        }
        params
    }

    fn input(&mut self, name: Located<String>, value: &Spanned) -> Option<InputEntry> {
        let mut entry = InputEntry { artifact: name.clone(), name, optional: false, many: false };
        if !is_name(&entry.name.value) {
            let problem = Problem::new(&entry.name.place, format!("`{}` cannot be an input's name", entry.name.value));
            self.problems.push(problem.help("use letters, digits and `_`, so that `$name` can be written"));
            return None;
        }
        if let Tree::Text(text) = &value.tree {
            entry.artifact = self.located(value.span, text);
            return Some(entry);
        }
        let mut named = false;
        for (field, value) in self.fields("an artifact type, or `(artifact: \"..\", optional: true)`", value) {
            match (field.text.as_str(), &value.tree) {
                ("artifact", Tree::Text(text)) => (entry.artifact, named) = (self.located(value.span, text), true),
                ("optional", Tree::Bool(flag)) => entry.optional = *flag,
                ("many", Tree::Bool(flag)) => entry.many = *flag,
                ("artifact", _) => self.expected("an artifact type as a string", value),
                ("optional" | "many", _) => self.expected("`true` or `false`", value),
                _ => self.unknown(field, &INPUT_FIELDS, "an input"),
            }
        }
        named.then_some(entry)
    }

    fn exports(&mut self, value: &Spanned) -> Vec<ExportEntry> {
        if let Tree::Map(_) = &value.tree {
            let entries = self.entries("a map from names to \"node.port\"", "export", value);
            let named = |(name, value)| Some(ExportEntry { name, output: self.text("\"node.port\"", value)? });
            return entries.into_iter().filter_map(named).collect();
        }
        let listed = self.texts("a list of \"node.port\", or a map from names to them", value);
        let named = |output: Located<String>| {
            let port = output.value.rsplit('.').next().unwrap_or_default();
            ExportEntry { name: Located { value: port.to_owned(), place: output.place.clone() }, output }
        };
        listed.into_iter().map(named).collect()
    }

    fn wire(&mut self, port: Located<String>, value: &Spanned) -> WireEntry {
        let what = "\"node.port\" or a list of them";
        let before = self.problems.0.len();
        let mut from = Vec::new();
        let items = match &value.tree {
            Tree::List(items) => items.as_slice(),
            _ => std::slice::from_ref(value),
        };
        for item in items {
            match &item.tree {
                Tree::Text(text) => from.push(self.located(item.span, text)),
                Tree::Reference(name) => from.push(self.located(item.span, &format!("${name}"))),
                _ if self.problems.0.len() == before => self.expected(what, item),
                _ => {}
            }
        }
        WireEntry { port, from }
    }
}

/// The place of the first `$name` in a value.
fn find_reference(value: &Spanned) -> Option<Span> {
    if value.reference().is_some() {
        return Some(value.span);
    }
    value.children().find_map(find_reference)
}
