//! Files that extend files: reading the chain, and merging it from the base upwards.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::diagnostic::{Place, Problem, Problems, Source, suggest};

use super::document::{Document, NodeEntry, read_document};
use super::{Graph, GraphError, Located, NodeSpec};

/// Longer chains of `extends` are refused.
const CHAIN_LIMIT: usize = 32;
/// Larger graph files are refused.
const BYTES_LIMIT: u64 = 256 << 20;

pub(super) fn load(path: &Path) -> Result<Graph, GraphError> {
    let text = read_text(path).map_err(|reason| GraphError::Read { path: path.display().to_string(), reason })?;
    parse(path, text)
}

pub(super) fn parse(path: &Path, text: String) -> Result<Graph, GraphError> {
    let mut problems = Problems::default();
    let chain = read_chain(path, text, &mut problems);
    // A base that could not be read would make every mention of its nodes a second, false mistake.
    let complete = chain.iter().all(|(_, document)| !document.unreadable)
        && chain.last().is_some_and(|(_, document)| document.extends.is_none());
    if !complete {
        return Err(problems.into());
    }
    let mut graph = merge(chain, &mut problems);
    graph.problems = problems;
    Ok(graph)
}

fn read_text(path: &Path) -> Result<String, String> {
    let size = std::fs::metadata(path).map_err(|error| error.to_string())?.len();
    if size > BYTES_LIMIT {
        return Err(format!("it has {size} bytes; a graph has at most {BYTES_LIMIT}"));
    }
    let bytes = std::fs::read(path).map_err(|error| error.to_string())?;
    String::from_utf8(bytes).map_err(|error| format!("it is not UTF-8 text ({error})"))
}

/// The file and those it extends, topmost overlay first.
fn read_chain(path: &Path, text: String, problems: &mut Problems) -> Vec<(Arc<Source>, Document)> {
    let mut chain = Vec::new();
    let mut seen = HashSet::new();
    let mut next = Some((path.to_owned(), text));
    while let Some((path, text)) = next.take() {
        seen.insert(identity(&path));
        let source = Source::new(&path.display().to_string(), text);
        let document = read_document(&source, problems);
        if let Some(extends) = &document.extends {
            let base = path.parent().unwrap_or(Path::new("")).join(&extends.value);
            let refused = if seen.contains(&identity(&base)) {
                Some(format!("`{}` extends itself, through this", base.display()))
            } else if seen.len() >= CHAIN_LIMIT {
                Some(format!("more than {CHAIN_LIMIT} files extend one another"))
            } else {
                None
            };
            match refused.map_or_else(|| read_text(&base), Err) {
                Ok(text) => next = Some((base, text)),
                Err(reason) => {
                    let message = format!("cannot extend `{}`: {reason}", base.display());
                    problems.push(Problem::new(&extends.place, message).help("the path is relative to this file"));
                }
            }
        }
        chain.push((source, document));
    }
    chain
}

fn identity(path: &Path) -> PathBuf {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

fn merge(chain: Vec<(Arc<Source>, Document)>, problems: &mut Problems) -> Graph {
    let source = chain.first().map_or_else(|| Source::new("", String::new()), |(source, _)| source.clone());
    let mut graph = Graph {
        name: Path::new(source.name()).file_stem().map_or("graph".into(), |stem| stem.to_string_lossy().into_owned()),
        doc: String::new(),
        seed: 0,
        source,
        exports: Vec::new(),
        nodes: Vec::new(),
        index: HashMap::new(),
        problems: Problems::default(),
    };
    for (_, document) in chain.into_iter().rev() {
        overlay(&mut graph, document, problems);
    }
    graph
}

fn overlay(graph: &mut Graph, document: Document, problems: &mut Problems) {
    remove(graph, &document.remove, problems);
    graph.name = document.name.unwrap_or(std::mem::take(&mut graph.name));
    graph.doc = document.doc.unwrap_or(std::mem::take(&mut graph.doc));
    graph.seed = document.seed.unwrap_or(graph.seed);
    graph.exports = document.exports.unwrap_or(std::mem::take(&mut graph.exports));
    for entry in document.nodes {
        let known = graph.node_index(&entry.id.value);
        match (known, &entry.kind) {
            (Some(index), kind) if kind.as_ref().is_none_or(|kind| kind.value == graph.nodes[index].kind.value) => {
                let node = &mut graph.nodes[index];
                node.broken |= entry.broken;
                entry.params.into_iter().for_each(|(name, value)| node.set_param(name, value));
                entry.inputs.into_iter().for_each(|wire| node.set_wire(wire));
            }
            (Some(index), _) => graph.nodes[index] = whole(entry),
            (None, kind) => {
                if kind.is_none() && !entry.broken {
                    let problem = Problem::new(&entry.id.place, format!("node `{}` has no kind", entry.id.value));
                    let similar = suggest(&entry.id.value, graph.node_ids(), "nodes so far");
                    problems.push(problem.maybe_help(similar).label("a new node needs `kind: \"..\"`"));
                }
                graph.index.insert(entry.id.value.clone(), graph.nodes.len());
                graph.nodes.push(whole(entry));
            }
        }
    }
}

fn whole(entry: NodeEntry) -> NodeSpec {
    let NodeEntry { id, kind, params, inputs, broken } = entry;
    let broken = broken || kind.is_none();
    NodeSpec { kind: kind.unwrap_or_else(|| id.clone()), id, params, inputs, broken }
}

fn remove(graph: &mut Graph, ids: &[Located<String>], problems: &mut Problems) {
    let mut removed: HashMap<&str, &Place> = HashMap::new();
    for id in ids {
        if graph.node_index(&id.value).is_none() {
            let problem = Problem::new(&id.place, format!("there is no node `{}` to remove", id.value));
            problems.push(problem.maybe_help(suggest(&id.value, graph.node_ids(), "nodes")));
        }
        if let Some(first) = removed.insert(&id.value, &id.place) {
            let problem = Problem::new(&id.place, format!("node `{}` is removed twice", id.value));
            problems.push(problem.also(first, "first here"));
        }
    }
    if removed.is_empty() {
        return;
    }
    graph.nodes.retain(|node| !removed.contains_key(node.id.value.as_str()));
    graph.index = graph.nodes.iter().enumerate().map(|(index, node)| (node.id.value.clone(), index)).collect();
}
