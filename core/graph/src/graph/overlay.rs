//! Files that extend files: reading the chain, and merging it from the base upwards.

use std::collections::{HashMap, HashSet};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::diagnostic::{Place, Problem, Problems, Source, suggest};
use crate::syntax::Spanned;

use super::document::{Document, ExportEntry, InputEntry, NodeEntry, WireEntry, read_document};
use super::{Located, ParamValue};

/// Longer chains of `extends` are refused.
const CHAIN_LIMIT: usize = 32;
/// Larger graph files are refused.
const BYTES_LIMIT: u64 = 256 << 20;

/// A graph file merged with what it extends, its subgraphs not yet looked into.
#[derive(Debug, Default)]
pub(super) struct Part {
    pub name: String,
    pub doc: String,
    pub seed: u64,
    /// The file and those it extends.
    pub sources: Vec<Arc<Source>>,
    pub params: Vec<(Located<String>, ParamValue)>,
    pub inputs: Vec<InputEntry>,
    pub exports: Vec<ExportEntry>,
    pub nodes: Vec<NodeEntry>,
    index: HashMap<String, usize>,
}

impl Part {
    pub fn node(&self, id: &str) -> Option<&NodeEntry> {
        self.index.get(id).map(|index| &self.nodes[*index])
    }

    fn ids(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|node| node.id.value.as_str())
    }
}

pub(super) fn read_text(path: &Path) -> Result<String, String> {
    let metadata = std::fs::metadata(path).map_err(|error| error.to_string())?;
    // A device or a pipe may never end.
    if !metadata.is_file() {
        return Err("it is not a file".to_owned());
    }
    let mut bytes = Vec::with_capacity(usize::try_from(metadata.len().min(BYTES_LIMIT)).unwrap_or(0));
    let file = std::fs::File::open(path).map_err(|error| error.to_string())?;
    file.take(BYTES_LIMIT + 1).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    if bytes.len() as u64 > BYTES_LIMIT {
        return Err(format!("it has more than {BYTES_LIMIT} bytes"));
    }
    String::from_utf8(bytes).map_err(|error| format!("it is not UTF-8 text ({error})"))
}

/// What to try when a file cannot be read: the file of that folder with the nearest name, or else `otherwise`.
pub(super) fn nearest_file(path: &Path, otherwise: &str) -> String {
    let wanted = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().take(crate::diagnostic::CANDIDATES);
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.retain(|name| name.ends_with(".ron") && *name != wanted);
    names.sort();
    let proposal = suggest(&wanted, names.iter().map(String::as_str), "").filter(|text| text.starts_with("did"));
    proposal.map_or(otherwise.to_owned(), |proposal| format!("{proposal} {otherwise}"))
}

pub(super) fn identity(path: &Path) -> PathBuf {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

/// Reads a file with what it extends. Nothing when a file of the chain cannot be read: then every mention of its nodes
/// would be a second, false mistake.
pub(super) fn read_part(path: &Path, text: String, problems: &mut Problems) -> Option<Part> {
    let chain = read_chain(path, text, problems);
    let complete = chain.iter().all(|(_, document)| !document.unreadable)
        && chain.last().is_some_and(|(_, document)| document.extends.is_none());
    complete.then(|| merge(path, chain, problems))
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
                    let help = nearest_file(&base, "the path is relative to this file");
                    problems.push(Problem::new(&extends.place, message).help(help));
                }
            }
        }
        chain.push((source, document));
    }
    chain
}

fn merge(path: &Path, chain: Vec<(Arc<Source>, Document)>, problems: &mut Problems) -> Part {
    let stem = path.file_stem().map_or("graph".into(), |stem| stem.to_string_lossy().into_owned());
    let mut part = Part { name: stem, ..Part::default() };
    part.sources = chain.iter().map(|(source, _)| source.clone()).collect();
    let mut late: Vec<Located<String>> = Vec::new();
    for (height, (_, document)) in chain.into_iter().rev().enumerate() {
        let known: HashSet<String> = part.params.iter().map(|(name, _)| name.value.clone()).collect();
        let added = document.params.iter().map(|(name, _)| name).filter(|name| !known.contains(&name.value));
        late.extend(added.filter(|_| height > 0).cloned());
        overlay(&mut part, document, problems);
    }
    report_unused(&part, &late, problems);
    part
}

/// A parameter that an overlay adds and nothing uses is most likely a misspelt one.
fn report_unused(part: &Part, late: &[Located<String>], problems: &mut Problems) {
    if late.is_empty() {
        return;
    }
    let mut used = HashSet::new();
    let values = part.nodes.iter().flat_map(|node| &node.params).filter_map(|(_, value)| value.tree.as_ref());
    values.for_each(|value| note_references(value, &mut used));
    for name in late.iter().filter(|name| !used.contains(name.value.as_str())) {
        let others = part.params.iter().map(|(other, _)| other.value.as_str()).filter(|other| *other != name.value);
        let problem = Problem::new(&name.place, format!("no node uses the parameter `{}`", name.value));
        let help = suggest(&name.value, others, "parameters");
        problems.push(problem.help(help.unwrap_or(format!("use it as `${}` in a node's `params`", name.value))));
    }
}

fn note_references<'a>(value: &'a Spanned, used: &mut HashSet<&'a str>) {
    used.extend(value.reference());
    value.children().for_each(|child| note_references(child, used));
}

fn overlay(part: &mut Part, document: Document, problems: &mut Problems) {
    remove(part, &document.remove, problems);
    part.name = document.name.unwrap_or(std::mem::take(&mut part.name));
    part.doc = document.doc.unwrap_or(std::mem::take(&mut part.doc));
    part.seed = document.seed.unwrap_or(part.seed);
    part.inputs = document.inputs.unwrap_or(std::mem::take(&mut part.inputs));
    part.exports = document.exports.unwrap_or(std::mem::take(&mut part.exports));
    document.params.into_iter().for_each(|(name, value)| set_param(&mut part.params, name, value));
    for entry in document.nodes {
        match (part.index.get(&entry.id.value).copied(), &entry.kind) {
            (Some(index), kind) if kind.as_ref().is_none_or(|kind| same_kind(kind, &part.nodes[index])) => {
                let node = &mut part.nodes[index];
                node.broken |= entry.broken;
                entry.params.into_iter().for_each(|(name, value)| set_param(&mut node.params, name, value));
                entry.inputs.into_iter().for_each(|wire| set_wire(&mut node.inputs, wire));
            }
            (Some(index), _) => part.nodes[index] = entry,
            (None, kind) => {
                if kind.is_none() && !entry.broken {
                    let problem = Problem::new(&entry.id.place, format!("node `{}` has no kind", entry.id.value));
                    let similar = suggest(&entry.id.value, part.ids(), "nodes so far");
                    problems.push(problem.maybe_help(similar).label("a new node needs `kind: \"..\"`"));
                }
                part.index.insert(entry.id.value.clone(), part.nodes.len());
                part.nodes.push(entry);
            }
        }
    }
}

fn same_kind(kind: &Located<String>, node: &NodeEntry) -> bool {
    node.kind.as_ref().is_some_and(|known| known.value == kind.value)
}

fn set_param(params: &mut Vec<(Located<String>, ParamValue)>, name: Located<String>, value: ParamValue) {
    match params.iter_mut().find(|(known, _)| known.value == name.value) {
        Some(param) => *param = (name, value),
        None => params.push((name, value)),
    }
}

fn set_wire(wires: &mut Vec<WireEntry>, wire: WireEntry) {
    match wires.iter_mut().find(|known| known.port.value == wire.port.value) {
        Some(known) => *known = wire,
        None => wires.push(wire),
    }
}

fn remove(part: &mut Part, ids: &[Located<String>], problems: &mut Problems) {
    let mut removed: HashMap<&str, &Place> = HashMap::new();
    for id in ids {
        if !part.index.contains_key(&id.value) {
            let problem = Problem::new(&id.place, format!("there is no node `{}` to remove", id.value));
            problems.push(problem.maybe_help(suggest(&id.value, part.ids(), "nodes")));
        }
        if let Some(first) = removed.insert(&id.value, &id.place) {
            let problem = Problem::new(&id.place, format!("node `{}` is removed twice", id.value));
            problems.push(problem.also(first, "first here"));
        }
    }
    if removed.is_empty() {
        return;
    }
    part.nodes.retain(|node| !removed.contains_key(node.id.value.as_str()));
    part.index = part.nodes.iter().enumerate().map(|(index, node)| (node.id.value.clone(), index)).collect();
}
