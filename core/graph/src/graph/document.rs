//! One graph file: from the tree of its text to named parts, with every misfit reported.

use std::collections::HashMap;
use std::sync::Arc;

use crate::diagnostic::{Place, Problem, Problems, Source, suggest};
use crate::syntax::{Name, Span, Spanned, SyntaxError, Tree, read};

use super::{Located, ParamValue, WireSpec};

/// A node as one file says it; an overlay may leave out the kind.
#[derive(Debug)]
pub(super) struct NodeEntry {
    pub id: Located<String>,
    pub kind: Option<Located<String>>,
    pub params: Vec<(Located<String>, ParamValue)>,
    pub inputs: Vec<WireSpec>,
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
    pub exports: Option<Vec<Located<String>>>,
    pub nodes: Vec<NodeEntry>,
    /// The text is not RON, which is reported; nothing of it is here.
    pub unreadable: bool,
}

const GRAPH_FIELDS: [&str; 7] = ["name", "doc", "seed", "extends", "remove", "exports", "nodes"];
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
                "exports" => document.exports = Some(self.texts("a list of \"node.port\"", value)),
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
        let param = |(name, value): &(Name, Spanned)| {
            let name = self.located(name.span, &name.text);
            (name, ParamValue { tree: Some(value.clone()), bare: None, place: self.place(value.span) })
        };
        fields.into_iter().map(param).collect()
    }

    fn wire(&mut self, port: Located<String>, value: &Spanned) -> WireSpec {
        let from = match &value.tree {
            Tree::Text(text) => vec![self.located(value.span, text)],
            _ => self.texts("\"node.port\" or a list of them", value),
        };
        WireSpec { port, from }
    }
}
