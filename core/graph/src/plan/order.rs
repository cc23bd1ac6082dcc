//! The order of nodes: producers before consumers, ties in the order of the graph file, cycles as their path.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};

use petgraph::algo::kosaraju_scc;
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

    /// Reports each group of nodes that wait for one another, as the path of one cycle in it.
    pub fn report_cycles(&self, spec: &Graph, problems: &mut Problems) {
        let mut sorted = vec![false; spec.nodes.len()];
        self.sorted.iter().for_each(|index| sorted[*index] = true);
        if sorted.iter().all(|done| *done) {
            return;
        }
        for group in kosaraju_scc(&self.graph) {
            let itself = group.len() == 1 && self.graph.contains_edge(group[0], group[0]);
            if group.len() > 1 || itself {
                let inside: HashSet<usize> = group.iter().map(|node| node.index()).collect();
                report_cycle(&self.path(&inside), spec, problems);
            }
        }
    }

    /// A cycle among nodes each of which has a producer among them, from the first in the order of the file.
    fn path(&self, inside: &HashSet<usize>) -> Vec<usize> {
        // Walking upstream must come back to a node already seen.
        let upstream = |index: usize| {
            let producers = self.graph.neighbors_directed(NodeIndex::new(index), petgraph::Direction::Incoming);
            producers.map(NodeIndex::index).find(|producer| inside.contains(producer))
        };
        let mut path: Vec<usize> = inside.iter().min().copied().into_iter().collect();
        let mut at: HashMap<usize, usize> = path.iter().map(|index| (*index, 0)).collect();
        while let Some(next) = path.last().and_then(|index| upstream(*index)) {
            if let Some(first) = at.get(&next) {
                path.drain(..*first);
                path.push(next);
                break;
            }
            at.insert(next, path.len());
            path.push(next);
        }
        path.reverse();
        path
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

fn report_cycle(path: &[usize], spec: &Graph, problems: &mut Problems) {
    let names: Vec<&str> = path.iter().map(|index| spec.nodes[*index].id.value.as_str()).collect();
    let shown = if names.len() > 20 {
        let (head, tail) = (&names[..10], &names[names.len() - 10..]);
        format!("{} → … ({} more) … → {}", head.join(" → "), names.len() - 20, tail.join(" → "))
    } else {
        names.join(" → ")
    };
    let Some(first) = path.first() else { return };
    let problem = Problem::new(&spec.nodes[*first].id.place, format!("these nodes wait for one another: {shown}"));
    problems.push(problem.label("part of a cycle").help("a graph flows one way; cut one of these wires"));
}
