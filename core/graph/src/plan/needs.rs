//! What parameters alone tell of missing values: a node may say that its parameters leave an optional output unwritten,
//! and another that it cannot do without an optional input. Both known, the run is refused before it starts.

use crate::diagnostic::{Place, Problem, Problems};
use crate::graph::Graph;

use super::Built;
use super::wires::Wire;

/// Reports every input that its node needs and that nothing will fill.
pub(super) fn check(
    graph: &Graph,
    built: &[Option<Built>],
    wires: &[Vec<Wire>],
    needed: &[usize],
    problems: &mut Problems,
) {
    for &index in needed {
        let Some(node) = &built[index] else { continue };
        for need in node.node.needs() {
            let wire = wires[index].iter().find(|wire| wire.port.name == need.input);
            let filled = |&(from, port): &(usize, &'static crate::node::Port)| {
                built[from].as_ref().is_none_or(|source| !source.node.leaves_empty().contains(&port.name))
            };
            if wire.is_some_and(|wire| wire.from.iter().any(filled)) {
                continue;
            }
            let place: &Place = &graph.nodes[index].id.place;
            let message = format!("node `{}`: {}", graph.nodes[index].local(), need.message);
            problems.push(Problem::new(place, message).help(need.remedy));
        }
    }
}
