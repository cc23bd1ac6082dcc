//! The order of nodes: producers before consumers, ties in the order of the graph file, cycles as their path.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, Reversed};

use crate::diagnostic::{Problem, Problems};
use crate::graph::Graph;

use super::wires::Wire;

pub(super) struct Order {
    graph: DiGraph<(), ()>,
    /// Nodes in topological order; those on a cycle, and all behind one, are absent.
    sorted: Vec<usize>,
}

impl Order {
    /// Kahn's algorithm with a heap, so that the order is the file's where wires leave a choice.
    pub fn of(spec: &Graph, wires: &[Vec<Wire>]) -> Self {
        let mut graph = DiGraph::with_capacity(spec.nodes.len(), spec.nodes.len());
        let nodes: Vec<NodeIndex> = spec.nodes.iter().map(|_| graph.add_node(())).collect();
        let mut waiting = vec![0usize; nodes.len()];
        for (index, wires) in wires.iter().enumerate() {
            for (from, _) in wires.iter().flat_map(|wire| &wire.from) {
                graph.add_edge(nodes[*from], nodes[index], ());
                waiting[index] += 1;
            }
        }
        let ready = (0..nodes.len()).filter(|index| waiting[*index] == 0);
        let mut ready: BinaryHeap<Reverse<usize>> = ready.map(Reverse).collect();
        let mut sorted = Vec::with_capacity(nodes.len());
        while let Some(Reverse(index)) = ready.pop() {
            sorted.push(index);
            for next in graph.neighbors(nodes[index]) {
                waiting[next.index()] -= 1;
                if waiting[next.index()] == 0 {
                    ready.push(Reverse(next.index()));
                }
            }
        }
        Self { graph, sorted }
    }

    /// Reports one cycle, if there is any, as its path.
    pub fn report_cycle(&self, spec: &Graph, problems: &mut Problems) {
        let mut sorted = vec![false; spec.nodes.len()];
        self.sorted.iter().for_each(|index| sorted[*index] = true);
        let Some(start) = sorted.iter().position(|done| !done) else { return };
        // Every unsorted node has an unsorted producer, so walking upstream must come back to a node already seen.
        let upstream = |index: usize| {
            let producers = self.graph.neighbors_directed(NodeIndex::new(index), petgraph::Direction::Incoming);
            producers.map(NodeIndex::index).find(|producer| !sorted[*producer])
        };
        let mut path = vec![start];
        let mut at = vec![usize::MAX; sorted.len()];
        at[start] = 0;
        while let Some(next) = path.last().and_then(|index| upstream(*index)) {
            if at[next] != usize::MAX {
                path.drain(..at[next]);
                path.push(next);
                break;
            }
            at[next] = path.len();
            path.push(next);
        }
        path.reverse();
        let names: Vec<&str> = path.iter().map(|index| spec.nodes[*index].id.value.as_str()).collect();
        let shown = if names.len() > 20 {
            format!(
                "{} → … ({} more) … → {}",
                names[..10].join(" → "),
                names.len() - 20,
                names[names.len() - 10..].join(" → ")
            )
        } else {
            names.join(" → ")
        };
        let place = &spec.nodes[path[0]].id.place;
        let problem = Problem::new(place, format!("these nodes wait for one another: {shown}"));
        problems.push(problem.label("part of a cycle").help("a graph flows one way; cut one of these wires"));
    }

    /// The nodes that `targets` need, in order.
    pub fn needed(&self, targets: &[usize]) -> Vec<usize> {
        let mut needed = vec![false; self.graph.node_count()];
        let mut walk = Dfs::empty(Reversed(&self.graph));
        for target in targets {
            walk.move_to(NodeIndex::new(*target));
            while let Some(node) = walk.next(Reversed(&self.graph)) {
                needed[node.index()] = true;
            }
        }
        self.sorted.iter().copied().filter(|index| needed[*index]).collect()
    }
}
