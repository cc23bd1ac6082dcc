//! A graph as its files say it, overlays merged and subgraphs laid out flat, nothing looked up in a registry yet.
//!
//! Always holds: node ids are unique; every part knows the file, line and column it came from. A node inside a subgraph
//! has the id `instance/node`; what it is called inside its own file is [`NodeSpec::local`].

mod document;
mod expand;
mod overlay;
mod scope;
mod set;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use crate::diagnostic::{Place, Problems, Source};
use crate::syntax::Spanned;

pub(crate) use document::InputEntry;
pub(crate) use scope::{Origin, Resolved, Scope, resolve};

/// A value and where it came from.
#[derive(Clone, Debug)]
pub(crate) struct Located<T> {
    pub value: T,
    pub place: Place,
}

/// A parameter's value; a command-line value may also be meant as a bare string.
#[derive(Clone, Debug)]
pub(crate) struct ParamValue {
    pub tree: Option<Spanned>,
    pub bare: Option<Spanned>,
    pub place: Place,
}

/// One end that feeds a wire.
#[derive(Clone, Debug)]
pub(crate) struct Feed {
    /// `node.port` with the node's full id; nothing when what the file says leads nowhere, which is reported.
    pub output: Option<String>,
    /// What the file says, and where.
    pub said: Located<String>,
    /// The subgraph's input it comes through, by index into [`Graph::gates`].
    pub gate: Option<usize>,
    /// It leads over the border of a subgraph, where a wrong name is reported.
    pub indirect: bool,
}

/// What feeds one input port.
#[derive(Clone, Debug)]
pub(crate) struct WireSpec {
    pub port: Located<String>,
    pub from: Vec<Feed>,
}

/// An input of a subgraph, and what the graph around it wires to it.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    pub input: InputEntry,
    pub from: Vec<Feed>,
    /// The instance as `id (file)`, and its id's place; nothing for the outermost graph.
    pub instance: Option<Located<String>>,
    /// What precedes the ids of the file that the instance stands in.
    pub prefix: String,
    /// Where the wire is, if there is one.
    pub wire: Option<Place>,
}

/// One node of a graph file.
#[derive(Clone, Debug)]
pub(crate) struct NodeSpec {
    pub id: Located<String>,
    pub kind: Located<String>,
    pub params: Vec<(Located<String>, ParamValue)>,
    pub inputs: Vec<WireSpec>,
    /// Where its `$name`s are looked up, by index into [`Graph::scopes`].
    pub scope: usize,
    /// Some part of it could not be read, which is reported; checking the rest would invent mistakes.
    pub broken: bool,
}

/// A graph, overlays merged, subgraphs laid out.
#[derive(Clone, Debug)]
pub struct Graph {
    name: String,
    doc: String,
    seed: u64,
    sources: Vec<Arc<Source>>,
    pub(crate) exports: Vec<Feed>,
    /// Exports of the subgraphs.
    pub(crate) inner_exports: Vec<Feed>,
    pub(crate) nodes: Vec<NodeSpec>,
    pub(crate) gates: Vec<Gate>,
    pub(crate) scopes: Vec<Scope>,
    index: HashMap<String, usize>,
    /// What is wrong so far; [`Graph::plan`] adds its own.
    pub(crate) problems: Problems,
}

/// Why a graph is not usable.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[non_exhaustive]
pub enum GraphError {
    /// The file cannot be read.
    #[error("cannot read the graph `{path}`: {reason}")]
    #[diagnostic(help("{remedy}"))]
    Read {
        /// The file.
        path: String,
        /// What the system says.
        reason: String,
        /// What to do.
        remedy: String,
    },
    /// The graph says something impossible.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Problems(#[from] Problems),
}

impl Graph {
    /// Reads a graph file, the files it extends and those its nodes are made of. What can be read past is kept for
    /// [`Graph::plan`] to report with the rest.
    ///
    /// # Errors
    /// When a file cannot be read or is not RON.
    pub fn load(path: &Path) -> Result<Self, GraphError> {
        expand::load(path)
    }

    /// Reads a graph from text; `name` stands for the file in errors and is where other files are looked up from.
    ///
    /// # Errors
    /// When a file cannot be read or is not RON.
    pub fn parse(name: &str, text: &str) -> Result<Self, GraphError> {
        expand::parse(Path::new(name), text.to_owned())
    }

    /// The graph's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What it is for.
    pub fn doc(&self) -> &str {
        &self.doc
    }

    /// The seed all nodes may use.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The file it was read from, as given.
    pub fn file(&self) -> &str {
        self.sources.first().map_or("", |source| source.name())
    }

    /// The file's text (not that of the other files).
    pub fn text(&self) -> &str {
        self.sources.first().map_or("", |source| source.text())
    }

    /// All files read, as names and texts: the graph's own first, then what it extends, then its subgraphs.
    pub fn files(&self) -> impl Iterator<Item = (&str, &str)> {
        self.sources.iter().map(|source| (source.name(), source.text()))
    }

    pub(crate) fn node_index(&self, id: &str) -> Option<usize> {
        self.index.get(id).copied()
    }

    pub(crate) fn node_ids(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|node| node.id.value.as_str())
    }

    /// What the ids below `prefix` are called there; a subgraph counts once.
    pub(crate) fn local_ids<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = &'a str> {
        let below = self.node_ids().filter_map(move |id| id.strip_prefix(prefix));
        let mut last = None;
        below.map(|id| id.split('/').next().unwrap_or(id)).filter(move |id| last.replace(*id) != Some(*id))
    }
}

impl NodeSpec {
    /// What precedes the local name of ids in the same file: `` or `instance/`.
    pub fn prefix(&self) -> &str {
        self.id.value.rfind('/').map_or("", |slash| &self.id.value[..=slash])
    }

    /// Its id as its own file says it.
    pub fn local(&self) -> &str {
        &self.id.value[self.prefix().len()..]
    }
}
