//! A graph as its files say it, overlays merged, nothing looked up in a registry yet.
//!
//! Always holds: node ids are unique; every part knows the file, line and column it came from.

mod document;
mod overlay;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use crate::diagnostic::{Place, Problem, Problems, Source, suggest};
use crate::syntax::{Span, Spanned, Tree, read_prefixed};

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

/// What feeds one input port.
#[derive(Clone, Debug)]
pub(crate) struct WireSpec {
    pub port: Located<String>,
    /// `node.port`, each.
    pub from: Vec<Located<String>>,
}

/// One node of a graph file.
#[derive(Clone, Debug)]
pub(crate) struct NodeSpec {
    pub id: Located<String>,
    pub kind: Located<String>,
    pub params: Vec<(Located<String>, ParamValue)>,
    pub inputs: Vec<WireSpec>,
    /// Some part of it could not be read, which is reported; checking the rest would invent mistakes.
    pub broken: bool,
}

/// A graph, overlays merged.
#[derive(Clone, Debug)]
pub struct Graph {
    name: String,
    doc: String,
    seed: u64,
    source: Arc<Source>,
    pub(crate) exports: Vec<Located<String>>,
    pub(crate) nodes: Vec<NodeSpec>,
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
    #[diagnostic(help("check the path; graphs that come with Heartian lie in `graphs/`"))]
    Read {
        /// The file.
        path: String,
        /// What the system says.
        reason: String,
    },
    /// The graph says something impossible.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Problems(#[from] Problems),
}

impl Graph {
    /// Reads a graph file and the files it extends. What can be read past is kept for [`Graph::plan`] to report with the
    /// rest.
    ///
    /// # Errors
    /// When a file cannot be read or is not RON.
    pub fn load(path: &Path) -> Result<Self, GraphError> {
        overlay::load(path)
    }

    /// Reads a graph from text; `name` stands for the file in errors and is where `extends` is looked up from.
    ///
    /// # Errors
    /// When a file cannot be read or is not RON.
    pub fn parse(name: &str, text: &str) -> Result<Self, GraphError> {
        overlay::parse(Path::new(name), text.to_owned())
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
        self.source.name()
    }

    /// The file's text (not that of the files it extends).
    pub fn text(&self) -> &str {
        self.source.text()
    }

    pub(crate) fn node_index(&self, id: &str) -> Option<usize> {
        self.index.get(id).copied()
    }

    pub(crate) fn node_ids(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|node| node.id.value.as_str())
    }

    /// Applies `node.param=value` from the command line. The value is RON; what is not RON, or does not fit the
    /// parameter, is taken as a string. Mistakes are kept for [`Graph::plan`] to report.
    pub fn set(&mut self, argument: &str) {
        if let Err(problems) = self.try_set(argument) {
            self.problems.0.extend(problems.0);
        }
    }

    fn try_set(&mut self, argument: &str) -> Result<(), Problems> {
        let source = Source::new("--set", argument.to_owned());
        let place = |start: usize, end: usize| Place { source: source.clone(), span: Span { start, end } };
        let whole = place(0, argument.len());
        let form = || {
            Problem::new(&whole, "this is not of the form `node.param=value`")
                .help("for example `--set phase.heart_rate_bpm=96`")
        };
        let (target, raw) = argument.split_once('=').ok_or_else(form)?;
        let (id, param) = target.rsplit_once('.').ok_or_else(form)?;
        let Some(index) = self.node_index(id) else {
            let problem = Problem::new(&place(0, id.len()), format!("the graph has no node `{id}`"));
            return Err(problem.maybe_help(suggest(id, self.node_ids(), "nodes")).into());
        };
        let span = Span { start: target.len() + 1, end: argument.len() };
        let value = ParamValue {
            tree: read_prefixed(argument, span.start).ok(),
            bare: Some(Spanned { span, tree: Tree::Text(raw.to_owned()) }),
            place: place(span.start, span.end),
        };
        let name = Located { value: param.to_owned(), place: place(id.len() + 1, target.len()) };
        self.nodes[index].set_param(name, value);
        Ok(())
    }
}

impl NodeSpec {
    fn set_param(&mut self, name: Located<String>, value: ParamValue) {
        match self.params.iter_mut().find(|(known, _)| known.value == name.value) {
            Some(param) => *param = (name, value),
            None => self.params.push((name, value)),
        }
    }

    fn set_wire(&mut self, wire: WireSpec) {
        match self.inputs.iter_mut().find(|known| known.port.value == wire.port.value) {
            Some(known) => *known = wire,
            None => self.inputs.push(wire),
        }
    }
}
