//! A checked graph: which nodes run, in which order, and what feeds them.
//!
//! Always holds: nodes stand in topological order and each is needed by a target; every wire joins ports of one type;
//! every parameter is valid. Nothing here recurses, so a chain of 100,000 nodes is as good as a short one.

mod needs;
mod order;
mod params;
mod wires;

pub(crate) use params::out_of_bounds;

use std::collections::BTreeMap;
use std::sync::Arc;

use serde_json::{Map, Value};

use crate::diagnostic::{Place, Problem, Problems, Source, suggest};
use crate::graph::Graph;
use crate::node::{Port, SourceFile};
use crate::registry::{ErasedNode, NodeKind, Registry};
use crate::syntax::Span;

/// A checked graph.
pub struct Plan {
    /// The graph's name.
    pub name: String,
    /// The graph's seed.
    pub seed: u64,
    /// The nodes needed, producers before consumers, otherwise in the order of the graph file.
    pub nodes: Vec<PlanNode>,
    /// Outputs to be written as files: index of the node, its port.
    pub exports: Vec<(usize, &'static Port)>,
}

/// One node of a plan.
pub struct PlanNode {
    /// Its id in the graph.
    pub id: Arc<str>,
    /// Its kind.
    pub kind: NodeKind,
    /// All parameters, defaults written out.
    pub values: Map<String, Value>,
    /// Wired inputs, in the order of the kind's ports.
    pub inputs: Vec<PlanInput>,
    /// Files it reads.
    pub sources: Vec<SourceFile>,
    pub(crate) node: Box<dyn ErasedNode>,
    places: Places,
}

/// What feeds one input.
#[derive(Clone, Debug)]
pub struct PlanInput {
    /// The input.
    pub port: &'static Port,
    /// Index of the node and its output port, in the order of the graph file; earlier in the plan than this node.
    pub from: Vec<(usize, &'static Port)>,
}

/// Where a node's parts stand in the graph files.
pub(crate) struct Places {
    id: Place,
    params: BTreeMap<String, Place>,
}

impl PlanNode {
    /// Where to point for a problem with the node, or with one of its parameters if the graph sets it.
    pub fn place(&self, parameter: Option<&str>) -> &Place {
        parameter.and_then(|name| self.places.params.get(name)).unwrap_or(&self.places.id)
    }
}

/// A node whose parameters are known to be right.
struct Built {
    node: Box<dyn ErasedNode>,
    values: Map<String, Value>,
    params: BTreeMap<String, Place>,
}

impl Graph {
    /// Checks everything and orders what `targets` need; with no targets, all nodes.
    ///
    /// # Errors
    /// All that is wrong, at once.
    pub fn plan(&self, registry: &Registry, targets: &[String]) -> Result<Plan, Problems> {
        let mut problems = self.problems.clone();
        let kinds: Vec<Option<&NodeKind>> =
            self.nodes.iter().map(|node| find_kind(node, registry, &mut problems)).collect();
        let nodes = self.nodes.iter().zip(&kinds);
        let mut built: Vec<Option<Built>> =
            nodes.map(|(node, kind)| kind.and_then(|kind| params::build(self, node, kind, &mut problems))).collect();
        let wiring = wires::Wiring { graph: self, kinds: &kinds };
        let wires = wiring.connect(registry, &mut problems);
        let order = order::Order::of(self, &wires);
        order.report_cycles(self, &mut problems);
        let targets = self.targets(targets, &mut problems);
        let exports = wiring.exports(&mut problems);
        if self.nodes.is_empty() && problems.0.is_empty() {
            let start = Place { source: Source::new(self.file(), self.text().to_owned()), span: Span::default() };
            problems.push(Problem::new(&start, "the graph has no nodes"));
        }
        let needed = order.needed(&targets);
        for index in &needed {
            if let Some(built) = &built[*index] {
                check_sources(self.nodes[*index].local(), built, &self.nodes[*index].id.place, &mut problems);
            }
        }
        needs::check(self, &built, &wires, &needed, &mut problems);
        if !problems.0.is_empty() {
            problems.sort();
            return Err(problems);
        }
        let position: BTreeMap<usize, usize> = needed.iter().enumerate().map(|(at, index)| (*index, at)).collect();
        let mut plan = Plan { name: self.name().to_owned(), seed: self.seed(), nodes: Vec::new(), exports: Vec::new() };
        plan.exports = exports.iter().filter_map(|(index, port)| Some((*position.get(index)?, *port))).collect();
        for index in needed {
            let (Some(kind), Some(built)) = (kinds[index], built[index].take()) else { continue };
            let wire = |wire: &wires::Wire| PlanInput {
                port: wire.port,
                from: wire.from.iter().map(|(from, port)| (position[from], *port)).collect(),
            };
            plan.nodes.push(PlanNode {
                id: self.nodes[index].id.value.as_str().into(),
                kind: *kind,
                values: built.values,
                inputs: wires[index].iter().map(wire).collect(),
                sources: built.node.sources(),
                node: built.node,
                places: Places { id: self.nodes[index].id.place.clone(), params: built.params },
            });
        }
        Ok(plan)
    }

    fn targets(&self, targets: &[String], problems: &mut Problems) -> Vec<usize> {
        if targets.is_empty() {
            return (0..self.nodes.len()).collect();
        }
        let mut found = Vec::new();
        for target in targets {
            let before = found.len();
            // A subgraph stands for all its nodes.
            let inside = format!("{target}/");
            match self.node_index(target) {
                Some(index) => found.push(index),
                None => found.extend((0..self.nodes.len()).filter(|at| self.nodes[*at].id.value.starts_with(&inside))),
            }
            if found.len() == before {
                let span = Span { start: 0, end: target.len() };
                let place = Place { source: Source::new("--target", target.clone()), span };
                let problem = Problem::new(&place, format!("the graph has no node `{target}`"));
                problems.push(problem.maybe_help(suggest(target, self.node_ids(), "nodes")));
            }
        }
        found
    }
}

fn find_kind<'r>(
    node: &crate::graph::NodeSpec,
    registry: &'r Registry,
    problems: &mut Problems,
) -> Option<&'r NodeKind> {
    if node.broken {
        return None;
    }
    let kind = registry.get(&node.kind.value);
    if kind.is_none() {
        let known = registry.iter().map(|kind| kind.kind);
        let problem = Problem::new(&node.kind.place, format!("there is no kind of node `{}`", node.kind.value));
        problems.push(problem.maybe_help(suggest(&node.kind.value, known, "kinds")));
    }
    kind
}

fn check_sources(id: &str, built: &Built, id_place: &Place, problems: &mut Problems) {
    for source in built.node.sources() {
        let Err(error) = std::fs::metadata(&source.path) else { continue };
        let place = built.params.get(source.parameter).unwrap_or(id_place);
        let path = source.path.display();
        let message =
            format!("node `{id}`: parameter `{}` names `{path}`, which cannot be read: {error}", source.parameter);
        let default = "check the path; it is relative to the current directory".to_owned();
        problems.push(Problem::new(place, message).help(source.remedy.unwrap_or(default)));
    }
}
