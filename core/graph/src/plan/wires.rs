//! Wires: every name looked up, every type compared.

use crate::diagnostic::{CANDIDATES, Problem, Problems, suggest};
use crate::graph::{Graph, Located, WireSpec};
use crate::node::Port;
use crate::registry::NodeKind;

/// What feeds one input, by index into the graph's nodes.
pub(super) struct Wire {
    pub port: &'static Port,
    pub from: Vec<(usize, &'static Port)>,
}

/// Per node, its wires in the order of its kind's ports. What is wrong is left out and reported.
pub(super) fn connect(graph: &Graph, kinds: &[Option<&NodeKind>], problems: &mut Problems) -> Vec<Vec<Wire>> {
    let nodes = graph.nodes.iter().zip(kinds);
    nodes
        .map(|(node, kind)| {
            let Some(kind) = kind else { return Vec::new() };
            for wire in &node.inputs {
                if kind.input(&wire.port.value).is_none() {
                    let message =
                        format!("node `{}` ({}) has no input `{}`", node.id.value, kind.kind, wire.port.value);
                    let known = kind.inputs.iter().map(|port| port.name);
                    let help = suggest(&wire.port.value, known, "inputs").unwrap_or("it reads nothing".into());
                    problems.push(Problem::new(&wire.port.place, message).help(help));
                }
            }
            let mut wires = Vec::with_capacity(kind.inputs.len());
            for port in kind.inputs {
                let wire = node.inputs.iter().find(|wire| wire.port.value == port.name);
                let given = wire.is_some_and(|wire| !wire.from.is_empty());
                if port.required && !given {
                    let place = wire.map_or(&node.id.place, |wire| &wire.port.place);
                    let message = format!("node `{}` ({}) needs its input `{}`", node.id.value, kind.kind, port.name);
                    let help = format!("`{}` carries `{}`: {}", port.name, port.artifact.name, port.doc);
                    problems.push(Problem::new(place, message).label("nothing is wired to it").help(help));
                }
                if let Some(wire) = wire.filter(|_| given) {
                    let end = End { node: &node.id.value, port };
                    wires.push(Wire { port, from: sources(graph, kinds, (&end, wire), problems) });
                }
            }
            wires
        })
        .collect()
}

struct End<'a> {
    node: &'a str,
    port: &'static Port,
}

fn sources(
    graph: &Graph,
    kinds: &[Option<&NodeKind>],
    (end, wire): (&End<'_>, &WireSpec),
    problems: &mut Problems,
) -> Vec<(usize, &'static Port)> {
    let name = format!("{}.{}", end.node, end.port.name);
    if wire.from.len() > 1 && !end.port.many {
        let message = format!("`{name}` takes one wire, not {}", wire.from.len());
        problems.push(Problem::new(&wire.from[1].place, message).label("one too many"));
    }
    let mut found = Vec::with_capacity(wire.from.len());
    for from in &wire.from {
        let Some((index, output)) = output(graph, kinds, from, problems) else { continue };
        if output.artifact == end.port.artifact {
            found.push((index, output));
            continue;
        }
        let (gives, takes) = (output.artifact, end.port.artifact);
        let message = format!("`{}` gives `{}`, but `{name}` takes `{}`", from.value, gives.name, takes.name);
        let fitting = fitting_outputs(graph, kinds, end);
        let mut problem = Problem::new(&from.place, message).label(format!("this is `{}`", gives.name));
        if gives.name == takes.name {
            problem =
                problem.label(format!("form {} of `{}`; form {} is needed", gives.version, gives.name, takes.version));
        }
        let help = (!fitting.is_empty()).then(|| format!("outputs that fit: {}", fitting.join(", ")));
        problems.push(problem.maybe_help(help));
    }
    found
}

/// Up to eight outputs of other nodes that the input would take.
fn fitting_outputs(graph: &Graph, kinds: &[Option<&NodeKind>], end: &End<'_>) -> Vec<String> {
    let nodes = graph.nodes.iter().zip(kinds).take(CANDIDATES);
    let others = nodes.filter(|(node, _)| node.id.value != end.node);
    let ports = others.flat_map(|(node, kind)| kind.iter().flat_map(|kind| kind.outputs).map(move |port| (node, port)));
    let fitting = ports.filter(|(_, port)| port.artifact == end.port.artifact);
    fitting.map(|(node, port)| format!("{}.{}", node.id.value, port.name)).take(8).collect()
}

/// Looks `node.port` up among the outputs.
fn output(
    graph: &Graph,
    kinds: &[Option<&NodeKind>],
    from: &Located<String>,
    problems: &mut Problems,
) -> Option<(usize, &'static Port)> {
    let Some((id, port)) = from.value.split_once('.') else {
        let index = graph.node_index(&from.value);
        let outputs = index.and_then(|index| kinds[index]).map_or(&[][..], |kind| kind.outputs);
        let proposals: Vec<String> = outputs.iter().map(|port| format!("`{}.{}`", from.value, port.name)).collect();
        let problem = Problem::new(&from.place, format!("`{}` names no output; write \"node.port\"", from.value));
        let help = (!proposals.is_empty()).then(|| format!("did you mean {}?", proposals.join(" or ")));
        problems.push(problem.maybe_help(help));
        return None;
    };
    let Some(index) = graph.node_index(id) else {
        let problem = Problem::new(&from.place, format!("there is no node `{id}`"));
        problems.push(problem.maybe_help(suggest(id, graph.node_ids(), "nodes")));
        return None;
    };
    let kind = kinds[index]?;
    let output = kind.output(port);
    if output.is_none() {
        let problem = Problem::new(&from.place, format!("node `{id}` ({}) has no output `{port}`", kind.kind));
        problems.push(problem.maybe_help(suggest(port, kind.outputs.iter().map(|port| port.name), "outputs")));
    }
    output.map(|port| (index, port))
}

/// The graph's exports, looked up.
pub(super) fn exports(
    graph: &Graph,
    kinds: &[Option<&NodeKind>],
    problems: &mut Problems,
) -> Vec<(usize, &'static Port)> {
    graph.exports.iter().filter_map(|export| output(graph, kinds, export, problems)).collect()
}
