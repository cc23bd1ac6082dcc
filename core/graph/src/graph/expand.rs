//! Subgraphs laid out flat: a node whose kind is a graph file becomes the nodes of that file.
//!
//! Always holds: files nest at most [`NEST_LIMIT`] deep and never contain themselves; the whole has at most
//! [`NODES_LIMIT`] nodes; one file is read once however often it is used.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::diagnostic::{Problem, Problems, suggest};

use super::document::{InputEntry, NodeEntry};
use super::overlay::{Part, identity, nearest_file, read_part, read_text};
use super::scope::{Scope, Setting};
use super::{Feed, Gate, Graph, GraphError, Located, NodeSpec, WireSpec};

/// Deeper nesting of graph files is refused.
const NEST_LIMIT: usize = 16;
/// More nodes than this, after subgraphs are laid out, are refused.
const NODES_LIMIT: usize = 1_000_000;

pub(super) fn load(path: &Path) -> Result<Graph, GraphError> {
    let text = read_text(path).map_err(|reason| {
        let remedy = nearest_file(path, "check the path; graphs that come with Heartian lie in `graphs/`");
        GraphError::Read { path: path.display().to_string(), reason, remedy }
    })?;
    parse(path, text)
}

pub(super) fn parse(path: &Path, text: String) -> Result<Graph, GraphError> {
    let mut problems = Problems::default();
    let Some(part) = read_part(path, text, &mut problems) else { return Err(problems.into()) };
    let part = Arc::new(part);
    let mut expander = Expander {
        graph: Graph::empty(&part),
        parts: HashMap::new(),
        stack: vec![identity(path)],
        problems,
        too_many: false,
    };
    let scope = expander.scope(&part, String::new(), path);
    let gates = part.inputs.iter().map(|input| expander.gate(Gate::unfed(input, None))).collect();
    let level = Level { part: &part, prefix: String::new(), scope, gates: expander.named_gates(gates) };
    expander.lay_out(&level);
    let exports = part.exports.iter().map(|export| expander.feed(&level, &export.output)).collect();
    let Expander { mut graph, problems, too_many, .. } = expander;
    if too_many {
        return Err(problems.into());
    }
    graph.exports = exports;
    graph.index = graph.nodes.iter().enumerate().map(|(index, node)| (node.id.value.clone(), index)).collect();
    graph.problems = problems;
    Ok(graph)
}

impl Graph {
    fn empty(part: &Part) -> Self {
        Self {
            name: part.name.clone(),
            doc: part.doc.clone(),
            seed: part.seed,
            sources: part.sources.clone(),
            exports: Vec::new(),
            inner_exports: Vec::new(),
            nodes: Vec::with_capacity(part.nodes.len()),
            gates: Vec::new(),
            scopes: Vec::new(),
            index: HashMap::new(),
            problems: Problems::default(),
        }
    }
}

impl Gate {
    fn unfed(input: &InputEntry, instance: Option<Located<String>>) -> Self {
        Self { input: input.clone(), from: Vec::new(), instance, prefix: String::new(), wire: None }
    }
}

/// Whether a kind is a graph file.
fn is_file(kind: &str) -> bool {
    kind.ends_with(".ron")
}

/// One file's nodes on their way into the graph.
struct Level<'p> {
    part: &'p Part,
    /// `` or `instance/`.
    prefix: String,
    scope: usize,
    gates: HashMap<String, usize>,
}

struct Expander {
    graph: Graph,
    /// Files read, by identity; nothing for those that could not be.
    parts: HashMap<PathBuf, Option<Arc<Part>>>,
    /// Identities of the files around the one being laid out.
    stack: Vec<PathBuf>,
    problems: Problems,
    too_many: bool,
}

impl Expander {
    fn gate(&mut self, gate: Gate) -> usize {
        self.graph.gates.push(gate);
        self.graph.gates.len() - 1
    }

    fn named_gates(&self, gates: Vec<usize>) -> HashMap<String, usize> {
        gates.into_iter().map(|index| (self.graph.gates[index].input.name.value.clone(), index)).collect()
    }

    fn scope(&mut self, part: &Part, instance: String, file: &Path) -> usize {
        let declared = part.params.iter().cloned();
        let settings = declared.map(|(name, value)| Setting { name, value, scope: None }).collect();
        self.graph.scopes.push(Scope { instance, file: file.display().to_string(), settings });
        self.graph.scopes.len() - 1
    }

    fn lay_out(&mut self, level: &Level<'_>) {
        for entry in &level.part.nodes {
            if self.graph.nodes.len() >= NODES_LIMIT {
                let message = format!("the graph has more than {NODES_LIMIT} nodes");
                if !std::mem::replace(&mut self.too_many, true) {
                    self.problems.push(Problem::new(&entry.id.place, message).help("use fewer subgraphs"));
                }
                return;
            }
            match &entry.kind {
                Some(kind) if is_file(&kind.value) => self.instance(level, entry, kind),
                _ => {
                    let node = self.node(level, entry);
                    self.graph.nodes.push(node);
                }
            }
        }
    }

    fn node(&mut self, level: &Level<'_>, entry: &NodeEntry) -> NodeSpec {
        let id = Located { value: format!("{}{}", level.prefix, entry.id.value), place: entry.id.place.clone() };
        let inputs = entry.inputs.iter().map(|wire| WireSpec {
            port: wire.port.clone(),
            from: wire.from.iter().flat_map(|from| self.feeds(level, from)).collect(),
        });
        NodeSpec {
            inputs: inputs.collect(),
            kind: entry.kind.clone().unwrap_or_else(|| id.clone()),
            id,
            params: entry.params.clone(),
            scope: level.scope,
            broken: entry.broken || entry.kind.is_none(),
        }
    }

    /// What a wire's text leads to: one output, or all that feed the `$input` it names.
    fn feeds(&mut self, level: &Level<'_>, said: &Located<String>) -> Vec<Feed> {
        let Some(name) = said.value.strip_prefix('$') else { return vec![self.feed(level, said)] };
        let Some(gate) = level.gates.get(name) else {
            let problem = Problem::new(&said.place, format!("the graph has no input `{name}`"));
            let known = level.part.inputs.iter().map(|input| input.name.value.as_str());
            let declare = format!("declare it: `inputs: {{\"{name}\": \"artifact type\"}}`");
            self.problems.push(problem.help(suggest(name, known, "inputs").unwrap_or(declare)));
            return vec![Feed { output: None, said: said.clone(), gate: None, indirect: true }];
        };
        let through = |output| Feed { output, said: said.clone(), gate: Some(*gate), indirect: true };
        let Gate { from, instance, input, .. } = &self.graph.gates[*gate];
        if instance.is_none() || (from.is_empty() && !input.optional) {
            // Fed by nobody, which is one problem of its own.
            return vec![through(None)];
        }
        let given = if input.many { from.len() } else { 1 };
        from.iter().take(given).map(|from| through(from.output.clone())).collect()
    }

    fn feed(&mut self, level: &Level<'_>, said: &Located<String>) -> Feed {
        let node = said.value.split_once('.').and_then(|(id, _)| level.part.node(id));
        let indirect = node.and_then(|node| node.kind.as_ref()).is_some_and(|kind| is_file(&kind.value));
        Feed { output: self.output(level.part, &level.prefix, said), said: said.clone(), gate: None, indirect }
    }

    /// The full `node.port`; through the exports of an instance, however deep, to the node that makes it.
    fn output(&mut self, part: &Part, prefix: &str, said: &Located<String>) -> Option<String> {
        if prefix.matches('/').count() > NEST_LIMIT {
            return None; // A file inside itself, which laying it out reports.
        }
        let full = || Some(format!("{prefix}{}", said.value));
        let Some((id, port)) = said.value.split_once('.') else {
            let instance = part.node(&said.value).and_then(|node| self.inner_part(node));
            let Some(inner) = instance else { return full() };
            let names: Vec<String> =
                inner.exports.iter().map(|export| format!("`{}.{}`", said.value, export.name.value)).collect();
            let message = format!("`{}` names no output; write \"node.port\"", said.value);
            let help = (!names.is_empty()).then(|| format!("did you mean {}?", names.join(" or ")));
            self.problems.push(Problem::new(&said.place, message).maybe_help(help));
            return None;
        };
        let Some(node) = part.node(id) else { return full() };
        let Some(kind) = node.kind.as_ref().filter(|kind| is_file(&kind.value)) else { return full() };
        let inner = self.inner_part(node)?;
        match inner.exports.iter().find(|export| export.name.value == port) {
            Some(export) => self.output(&inner, &format!("{prefix}{id}/"), &export.output),
            None => {
                let message = format!("node `{id}` ({}) has no output `{port}`", kind.value);
                let known = inner.exports.iter().map(|export| export.name.value.as_str());
                let help = suggest(port, known, "outputs").unwrap_or("list it under that file's `exports`".into());
                self.problems.push(Problem::new(&said.place, message).help(help));
                None
            }
        }
    }

    /// The file that an instance is made of, read before or now.
    fn inner_part(&mut self, node: &NodeEntry) -> Option<Arc<Part>> {
        let kind = node.kind.as_ref().filter(|kind| is_file(&kind.value))?;
        let path = inner_path(kind);
        let identity = identity(&path);
        if let Some(part) = self.parts.get(&identity) {
            return part.clone();
        }
        let part = match read_text(&path) {
            Ok(text) => read_part(&path, text, &mut self.problems).map(Arc::new),
            Err(reason) => {
                let message = format!("cannot read the subgraph `{}`: {reason}", path.display());
                let help = nearest_file(&path, "the path is relative to this file");
                self.problems.push(Problem::new(&kind.place, message).help(help));
                None
            }
        };
        if let Some(part) = &part {
            self.graph.sources.extend(part.sources.iter().cloned());
        }
        self.parts.insert(identity, part.clone());
        part
    }

    /// Puts the nodes of a subgraph in the place of the node that it is.
    fn instance(&mut self, level: &Level<'_>, entry: &NodeEntry, kind: &Located<String>) {
        if entry.broken {
            return;
        }
        let path = inner_path(kind);
        let inside = identity(&path);
        let refused = if self.stack.contains(&inside) {
            Some(format!("`{}` contains itself, through this", path.display()))
        } else if self.stack.len() >= NEST_LIMIT {
            Some(format!("more than {NEST_LIMIT} graph files lie inside one another"))
        } else {
            None
        };
        if let Some(message) = refused {
            self.problems.push(Problem::new(&kind.place, message).help("make this node of another file"));
            self.parts.insert(inside, None);
            return;
        }
        let Some(part) = self.inner_part(entry) else { return };
        let full = format!("{}{}", level.prefix, entry.id.value);
        let scope = self.scope(&part, full.clone(), &path);
        self.fill(level, entry, scope);
        let gates = self.gates(level, entry, &part);
        let inner = Level { part: &part, prefix: format!("{full}/"), scope, gates: self.named_gates(gates) };
        let exports: Vec<Feed> = part.exports.iter().map(|export| self.feed(&inner, &export.output)).collect();
        self.graph.inner_exports.extend(exports);
        self.stack.push(inside);
        self.lay_out(&inner);
        self.stack.pop();
    }

    /// Gives an instance's parameters their values.
    fn fill(&mut self, level: &Level<'_>, entry: &NodeEntry, scope: usize) {
        for (name, value) in &entry.params {
            let inner = &mut self.graph.scopes[scope];
            if inner.find(&name.value).is_some() {
                inner.put(Setting { name: name.clone(), value: value.clone(), scope: Some(level.scope) });
                continue;
            }
            let kind = entry.kind.as_ref().map_or("", |kind| kind.value.as_str());
            let message = format!("node `{}` ({kind}) has no parameter `{}`", entry.id.value, name.value);
            let help = suggest(&name.value, inner.names(), "parameters");
            let declare = "declare it under that file's `params`".to_owned();
            self.problems.push(Problem::new(&name.place, message).help(help.unwrap_or(declare)));
        }
    }

    /// One gate an input of the subgraph, fed by what the instance wires to it.
    fn gates(&mut self, level: &Level<'_>, entry: &NodeEntry, part: &Part) -> Vec<usize> {
        let kind = entry.kind.as_ref().map_or("", |kind| kind.value.as_str());
        let known = || part.inputs.iter().map(|input| input.name.value.as_str());
        for wire in entry.inputs.iter().filter(|wire| known().all(|name| name != wire.port.value)) {
            let message = format!("node `{}` ({kind}) has no input `{}`", entry.id.value, wire.port.value);
            let help = suggest(&wire.port.value, known(), "inputs").unwrap_or("it reads nothing".into());
            self.problems.push(Problem::new(&wire.port.place, message).help(help));
        }
        let mut gates = Vec::with_capacity(part.inputs.len());
        for input in &part.inputs {
            let name = Located { value: format!("{} ({kind})", entry.id.value), place: entry.id.place.clone() };
            let mut gate = Gate { prefix: level.prefix.clone(), ..Gate::unfed(input, Some(name)) };
            if let Some(wire) = entry.inputs.iter().find(|wire| wire.port.value == input.name.value) {
                gate.from = wire.from.iter().flat_map(|from| self.feeds(level, from)).collect();
                gate.wire = Some(wire.port.place.clone());
            }
            gates.push(self.gate(gate));
        }
        gates
    }
}

/// The file that a kind names, relative to the file that says so.
fn inner_path(kind: &Located<String>) -> PathBuf {
    Path::new(kind.place.source.name()).parent().unwrap_or(Path::new("")).join(&kind.value)
}
