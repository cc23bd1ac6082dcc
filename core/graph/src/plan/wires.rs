//! Wires: every name looked up, every type compared.

use std::collections::BTreeSet;

use crate::diagnostic::{CANDIDATES, Problem, Problems, suggest};
use crate::graph::{Feed, Gate, Graph, NodeSpec, WireSpec};
use crate::node::Port;
use crate::registry::{NodeKind, Registry};

/// What feeds one input, by index into the graph's nodes.
pub(super) struct Wire {
    pub port: &'static Port,
    pub from: Vec<(usize, &'static Port)>,
}

/// A graph with the kind of each node, as far as it is known.
pub(super) struct Wiring<'a> {
    pub graph: &'a Graph,
    pub kinds: &'a [Option<&'a NodeKind>],
}

/// The input at the end of a wire.
struct End<'a> {
    /// As errors call it.
    name: String,
    /// Name of the artifact type it takes.
    takes: &'a str,
    /// Full id of its node, and what precedes the ids of its file.
    node: &'a str,
    prefix: &'a str,
}

impl Wiring<'_> {
    /// Per node, its wires in the order of its kind's ports. What is wrong is left out and reported.
    pub fn connect(&self, registry: &Registry, problems: &mut Problems) -> Vec<Vec<Wire>> {
        self.check_gates(registry, problems);
        for export in &self.graph.inner_exports {
            self.output(export, problems);
        }
        let nodes = self.graph.nodes.iter().zip(self.kinds);
        nodes.map(|(node, kind)| kind.map_or(Vec::new(), |kind| self.node(node, kind, problems))).collect()
    }

    fn node(&self, node: &NodeSpec, kind: &NodeKind, problems: &mut Problems) -> Vec<Wire> {
        for wire in node.inputs.iter().filter(|wire| kind.input(&wire.port.value).is_none()) {
            let message = format!("node `{}` ({}) has no input `{}`", node.local(), kind.kind, wire.port.value);
            let known = kind.inputs.iter().map(|port| port.name);
            let help = suggest(&wire.port.value, known, "inputs").unwrap_or("it reads nothing".into());
            problems.push(Problem::new(&wire.port.place, message).help(help));
        }
        let mut wires = Vec::with_capacity(node.inputs.len());
        for port in kind.inputs {
            let name = format!("{}.{}", node.local(), port.name);
            let end = End { name, takes: port.artifact.name, node: &node.id.value, prefix: node.prefix() };
            let wire = node.inputs.iter().find(|wire| wire.port.value == port.name);
            let given = wire.is_some_and(|wire| !wire.from.is_empty());
            if port.required && !given {
                let place = wire.map_or(&node.id.place, |wire| &wire.port.place);
                let message = format!("node `{}` ({}) needs its input `{}`", node.local(), kind.kind, port.name);
                let doc = format!("`{}` carries `{}`: {}", port.name, port.artifact.name, port.doc);
                let help = self.fitting(&end).map_or(doc.clone(), |fitting| format!("{doc} ({fitting})"));
                problems.push(Problem::new(place, message).label("nothing is wired to it").help(help));
            }
            if let Some(wire) = wire.filter(|_| given) {
                wires.push(Wire { port, from: self.sources(&end, port, wire, problems) });
            }
        }
        wires
    }

    fn sources(
        &self,
        end: &End<'_>,
        port: &'static Port,
        wire: &WireSpec,
        problems: &mut Problems,
    ) -> Vec<(usize, &'static Port)> {
        one_wire(end, port.many, &wire.from, problems);
        let mut found = Vec::with_capacity(wire.from.len());
        for from in &wire.from {
            let output = self.output(from, problems);
            if !self.fits(end, from, output, problems) {
                continue;
            }
            let Some((index, output)) = output else { continue };
            if output.artifact == port.artifact {
                found.push((index, output));
            } else if output.artifact.name == port.artifact.name {
                let (gives, takes) = (output.artifact, port.artifact);
                let message = format!(
                    "`{}` gives form {} of `{}`, but `{}` takes form {}",
                    from.said.value, gives.version, gives.name, end.name, takes.version
                );
                problems.push(Problem::new(&from.said.place, message).help("use nodes of the same release"));
            }
        }
        found
    }

    /// Whether what is offered here is what the end takes; reported where it is not. Nothing known counts as fitting.
    fn fits(
        &self,
        end: &End<'_>,
        from: &Feed,
        output: Option<(usize, &'static Port)>,
        problems: &mut Problems,
    ) -> bool {
        let declared = from.gate.map(|gate| self.graph.gates[gate].input.artifact.value.as_str());
        let Some(gives) = declared.or(output.map(|(_, port)| port.artifact.name)) else { return true };
        if gives == end.takes {
            return true;
        }
        let message = format!("`{}` gives `{gives}`, but `{}` takes `{}`", from.said.value, end.name, end.takes);
        let problem = Problem::new(&from.said.place, message).label(format!("this is `{gives}`"));
        problems.push(problem.maybe_help(self.fitting(end)));
        false
    }

    /// Up to eight outputs of other nodes of the same file that the input would take.
    fn fitting(&self, end: &End<'_>) -> Option<String> {
        let nodes = self.graph.nodes.iter().zip(self.kinds).take(CANDIDATES);
        let others = nodes.filter(|(node, _)| node.id.value != end.node && node.prefix() == end.prefix);
        let ports =
            others.flat_map(|(node, kind)| kind.iter().flat_map(|kind| kind.outputs).map(move |port| (node, port)));
        let fitting = ports.filter(|(_, port)| port.artifact.name == end.takes);
        let names: Vec<String> =
            fitting.map(|(node, port)| format!("{}.{}", node.local(), port.name)).take(8).collect();
        (!names.is_empty()).then(|| format!("outputs that fit: {}", names.join(", ")))
    }

    /// Looks `node.port` up among the outputs.
    fn output(&self, feed: &Feed, problems: &mut Problems) -> Option<(usize, &'static Port)> {
        let full = feed.output.as_ref()?;
        let mut report = |problem: Problem| {
            if !feed.indirect {
                problems.push(problem);
            }
        };
        let Feed { said, .. } = feed;
        let Some((id, port)) = full.split_once('.') else {
            let index = self.graph.node_index(full);
            let outputs = index.and_then(|index| self.kinds[index]).map_or(&[][..], |kind| kind.outputs);
            let proposals: Vec<String> = outputs.iter().map(|port| format!("`{}.{}`", said.value, port.name)).collect();
            let message = format!("`{}` names no output; write \"node.port\"", said.value);
            let help = (!proposals.is_empty()).then(|| format!("did you mean {}?", proposals.join(" or ")));
            report(Problem::new(&said.place, message).maybe_help(help));
            return None;
        };
        let Some(index) = self.graph.node_index(id) else {
            let local = said.value.split('.').next().unwrap_or_default();
            let prefix = id.strip_suffix(local).unwrap_or_default();
            let problem = Problem::new(&said.place, format!("there is no node `{local}`"));
            report(problem.maybe_help(suggest(local, self.graph.local_ids(prefix), "nodes")));
            return None;
        };
        let kind = self.kinds[index]?;
        let output = kind.output(port);
        if output.is_none() {
            let local = self.graph.nodes[index].local();
            let problem = Problem::new(&said.place, format!("node `{local}` ({}) has no output `{port}`", kind.kind));
            report(problem.maybe_help(suggest(port, kind.outputs.iter().map(|port| port.name), "outputs")));
        }
        output.map(|port| (index, port))
    }

    /// The graph's exports, looked up.
    pub fn exports(&self, problems: &mut Problems) -> Vec<(usize, &'static Port)> {
        self.graph.exports.iter().filter_map(|export| self.output(export, problems)).collect()
    }

    /// Inputs of subgraphs: what they take is known, and is what is wired to them.
    fn check_gates(&self, registry: &Registry, problems: &mut Problems) {
        if self.graph.gates.is_empty() {
            return;
        }
        let types: BTreeSet<&str> = registry
            .iter()
            .flat_map(|kind| kind.inputs.iter().chain(kind.outputs))
            .map(|port| port.artifact.name)
            .collect();
        for gate in &self.graph.gates {
            let artifact = &gate.input.artifact;
            if types.contains(artifact.value.as_str()) {
                self.check_gate(gate, problems);
            } else {
                let message = format!("no node reads or writes an artifact of type `{}`", artifact.value);
                let help = suggest(&artifact.value, types.iter().copied(), "types");
                problems.push(Problem::new(&artifact.place, message).maybe_help(help));
            }
        }
    }

    fn check_gate(&self, gate: &Gate, problems: &mut Problems) {
        let (name, takes) = (&gate.input.name, gate.input.artifact.value.as_str());
        let Some(instance) = &gate.instance else {
            let message = format!("the graph's input `{}` is fed by nobody", name.value);
            let help = "this file is a part of others: use it as a node there, `(kind: \"this.ron\", inputs: {..})`";
            problems.push(Problem::new(&name.place, message).help(help));
            return;
        };
        let (local, _) = instance.value.split_once(' ').unwrap_or((&instance.value, ""));
        let prefix = gate.prefix.as_str();
        let end = End { name: format!("{local}.{}", name.value), takes, node: "", prefix };
        if gate.from.is_empty() && !gate.input.optional {
            let place = gate.wire.as_ref().unwrap_or(&instance.place);
            let message =
                format!("node `{local}` {} needs its input `{}`", &instance.value[local.len() + 1..], name.value);
            let problem =
                Problem::new(place, message).label("nothing is wired to it").also(&name.place, "declared here");
            problems.push(problem.maybe_help(self.fitting(&end)));
        }
        one_wire(&end, gate.input.many, &gate.from, problems);
        for from in &gate.from {
            let output = self.output(from, problems);
            self.fits(&end, from, output, problems);
        }
    }
}

fn one_wire(end: &End<'_>, many: bool, from: &[Feed], problems: &mut Problems) {
    if from.len() > 1 && !many {
        let message = format!("`{}` takes one wire, not {}", end.name, from.len());
        problems.push(Problem::new(&from[1].said.place, message).label("one too many"));
    }
}
