//! A plan as a picture: Graphviz, Mermaid, or SVG by a small layered layout of our own.
//!
//! Nothing recurses and all is near linear in nodes and wires, so a graph of 100,000 nodes is drawn too.

mod layout;
mod svg;

use std::fmt::Write;

use crate::plan::Plan;

/// How a node is coloured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tint {
    /// Nothing is known.
    #[default]
    Plain,
    /// In the cache.
    Hit,
    /// Ran, or will run.
    Ran,
    /// Waits for one that will run.
    Waits,
    /// Failed.
    Failed,
    /// Was not reached.
    Skipped,
}

impl Tint {
    /// Fill and border.
    fn colors(self) -> (&'static str, &'static str) {
        match self {
            Self::Plain => ("#f4f4f2", "#6b6b6b"),
            Self::Hit => ("#dff2df", "#3a8f46"),
            Self::Ran => ("#ffe9cc", "#cf7a12"),
            Self::Waits => ("#fff7d6", "#b79a1c"),
            Self::Failed => ("#fbd9d7", "#c0342b"),
            Self::Skipped => ("#ececec", "#9a9a9a"),
        }
    }

    fn word(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Hit => "in the cache",
            Self::Ran => "ran or will run",
            Self::Waits => "waits for one that runs",
            Self::Failed => "failed",
            Self::Skipped => "not reached",
        }
    }
}

/// Colours of wires, by artifact type.
const WIRES: [&str; 8] = ["#3465a4", "#75507b", "#2f7d6b", "#a0522d", "#8a6d00", "#b0326b", "#4d6a00", "#555753"];

/// All wires from one node to another.
#[derive(Clone, Debug, PartialEq)]
struct Edge {
    from: usize,
    to: usize,
    /// Artifact types, each once, in the order of the ports.
    types: Vec<&'static str>,
}

/// A plan, ready to be drawn.
pub struct Picture {
    name: String,
    /// Id, kind, colour.
    nodes: Vec<(String, &'static str, Tint)>,
    edges: Vec<Edge>,
    /// Artifact types, sorted; their index is their colour.
    types: Vec<&'static str>,
}

impl Picture {
    /// The picture of a plan, `tint` giving the colour of each node.
    pub fn of(plan: &Plan, tint: &dyn Fn(usize) -> Tint) -> Self {
        let nodes = plan.nodes.iter().enumerate();
        let nodes = nodes.map(|(at, node)| (node.id.to_string(), node.kind.kind, tint(at))).collect();
        let mut edges: Vec<Edge> = Vec::new();
        for (to, node) in plan.nodes.iter().enumerate() {
            let start = edges.len();
            for (from, port) in node.inputs.iter().flat_map(|input| &input.from) {
                let name = port.artifact.name;
                match edges[start..].iter_mut().find(|edge| edge.from == *from) {
                    Some(edge) if edge.types.contains(&name) => {}
                    Some(edge) => edge.types.push(name),
                    None => edges.push(Edge { from: *from, to, types: vec![name] }),
                }
            }
        }
        let mut types: Vec<&'static str> = edges.iter().flat_map(|edge| edge.types.iter().copied()).collect();
        types.sort_unstable();
        types.dedup();
        Self { name: plan.name.clone(), nodes, edges, types }
    }

    fn wire_color(&self, edge: &Edge) -> &'static str {
        let first = edge.types.first().and_then(|name| self.types.binary_search(name).ok());
        WIRES[first.unwrap_or(0) % WIRES.len()]
    }

    /// For Graphviz: `dot -Tsvg`.
    pub fn dot(&self) -> String {
        let quoted = |text: &str| format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""));
        let mut text = format!("digraph {} {{\n", quoted(&self.name));
        text.push_str("  node [shape=box, style=\"rounded,filled\", fontname=\"sans-serif\"];\n");
        text.push_str("  edge [fontname=\"sans-serif\", fontsize=10];\n");
        for (at, (id, kind, tint)) in self.nodes.iter().enumerate() {
            let (fill, border) = tint.colors();
            let label = quoted(&format!("{id}\n{kind}")).replace('\n', "\\n");
            let _ = writeln!(text, "  n{at} [label={label}, fillcolor=\"{fill}\", color=\"{border}\"];");
        }
        for edge in &self.edges {
            let (label, color) = (quoted(&edge.types.join(", ")), self.wire_color(edge));
            let (from, to) = (edge.from, edge.to);
            let _ = writeln!(text, "  n{from} -> n{to} [label={label}, color=\"{color}\", fontcolor=\"{color}\"];");
        }
        text + "}\n"
    }

    /// For Markdown that draws Mermaid.
    pub fn mermaid(&self) -> String {
        let quoted = |text: &str| text.replace('&', "#amp;").replace('"', "#quot;").replace('<', "#lt;");
        let mut text = String::from("flowchart TD\n");
        for (at, (id, kind, tint)) in self.nodes.iter().enumerate() {
            let (fill, border) = tint.colors();
            let _ = writeln!(text, "  n{at}[\"{}<br/><small>{}</small>\"]", quoted(id), quoted(kind));
            let _ = writeln!(text, "  style n{at} fill:{fill},stroke:{border}");
        }
        for edge in &self.edges {
            let _ = writeln!(text, "  n{} -->|\"{}\"| n{}", edge.from, quoted(&edge.types.join(", ")), edge.to);
        }
        text
    }

    /// As a picture.
    pub fn svg(&self) -> String {
        svg::draw(self)
    }
}
