//! `ro-crate-metadata.json`: what made every file and every figure of a run, as RO-Crate 1.1 with the profiles of
//! Workflow Run Crate (`CreateAction` of the graph, and one of each node).
//!
//! Always holds: every figure of `metrics.json` is the result of one action, whose objects are artifacts by digest, each
//! the result of an action in turn, down to the digests of the files read. Large graphs keep the action of the whole and
//! refer to `run.json` for the nodes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::SystemTime;

use heartian_graph::{Cache, Digest, Graph, NodeReport, Plan, PlanNode, Status};
use miette::Result;
use serde_json::{Map, Value, json};

use crate::clock;
use crate::deliver::{Delivered, write_json, write_text};

/// Graphs with more nodes are described as a whole only.
const NODES: usize = 2000;
/// The folder of the graph files, beside the results.
const GRAPHS: &str = "graph";

/// A run that is over.
pub struct Story<'a> {
    pub graph: &'a Graph,
    pub sets: &'a [String],
    pub plan: &'a Plan,
    pub cache: &'a Cache,
    pub reports: &'a [NodeReport],
    pub delivered: &'a Delivered,
    pub start: SystemTime,
    pub end: SystemTime,
}

/// Entities by id, in the order in which they were first named.
#[derive(Default)]
struct Crate {
    entities: Vec<Value>,
    known: BTreeSet<String>,
}

impl Crate {
    /// Adds an entity unless it is there; gives the reference to it.
    fn put(&mut self, id: &str, entity: impl FnOnce() -> Value) -> Value {
        if self.known.insert(id.to_owned()) {
            let mut entity = entity();
            if let Some(fields) = entity.as_object_mut() {
                fields.insert("@id".to_owned(), json!(id));
            }
            self.entities.push(entity);
        }
        json!({"@id": id})
    }
}

/// Writes the crate's description, and the graph files it speaks of, into the run's folder.
pub fn write(story: &Story<'_>, folder: &Path) -> Result<()> {
    let files = graph_files(story.graph);
    for (name, text) in &files {
        let path = folder.join(GRAPHS).join(name);
        if std::fs::read_to_string(&path).ok().as_deref() != Some(text) {
            write_text(&path, text)?;
        }
    }
    write_json(&folder.join("ro-crate-metadata.json"), &describe(story, &files))
}

/// Names below the folder and texts; files of equal names in different folders are told apart.
fn graph_files(graph: &Graph) -> Vec<(String, String)> {
    let mut taken = BTreeSet::new();
    let mut files = Vec::new();
    for (name, text) in graph.files() {
        let base = Path::new(name).file_name().map_or("graph.ron".into(), |name| name.to_string_lossy().into_owned());
        let mut unique = base.clone();
        let mut count = 2;
        while !taken.insert(unique.clone()) {
            unique = format!("{count}-{base}");
            count += 1;
        }
        files.push((unique, text.to_owned()));
    }
    files
}

fn describe(story: &Story<'_>, files: &[(String, String)]) -> Value {
    let Story { plan, reports, delivered, .. } = story;
    let mut made = Crate::default();
    let end = clock::iso(story.end);
    let workflow = json!({"@id": format!("{GRAPHS}/{}", files.first().map_or("graph.ron", |(name, _)| name))});
    let mut parts: Vec<Value> = Vec::new();
    for (name, text) in files {
        let kinds = if parts.is_empty() {
            json!(["File", "SoftwareSourceCode", "ComputationalWorkflow"])
        } else {
            json!(["File", "SoftwareSourceCode"])
        };
        parts.push(made.put(&format!("{GRAPHS}/{name}"), || {
            json!({"@type": kinds, "name": name, "programmingLanguage": {"@id": "#ron"}, "contentSize": text.len().to_string(),
                   "identifier": blake3(&Digest::of(text.as_bytes()))})
        }));
    }
    made.put("#ron", || json!({"@type": "ComputerLanguage", "name": "Heartian graph (RON)"}));
    made.put(
        "#heartian",
        || json!({"@type": "SoftwareApplication", "name": "heartian", "softwareVersion": env!("CARGO_PKG_VERSION")}),
    );
    let mut results: Vec<Value> = ["metrics.json", "run.json"]
        .iter()
        .map(|name| made.put(name, || json!({"@type": "File", "name": name, "encodingFormat": "application/json"})))
        .collect();
    for (path, digest) in &delivered.files {
        let from = json!({"@id": artifact_id(digest)});
        results.push(made.put(path, || json!({"@type": "File", "name": path, "isBasedOn": from})));
    }
    parts.extend(results.iter().cloned());
    let mut objects = settings(story, &mut made);
    let mut actions = vec![json!({"@id": "#run"})];
    if plan.nodes.len() <= NODES {
        for (node, report) in plan.nodes.iter().zip(*reports) {
            let (action, sources) = node_action(story, node, report, &mut made);
            actions.push(action);
            objects.extend(sources);
        }
        results.extend(figures(delivered, &mut made));
    }
    let failed = reports.iter().filter(|report| matches!(report.status, Status::Failed | Status::Skipped)).count();
    let host = made.put("#host", || {
        json!({"@type": "PropertyValue", "name": "host", "value": host(),
               "description": format!("{} {}", std::env::consts::OS, std::env::consts::ARCH)})
    });
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = made.put("#threads", || json!({"@type": "PropertyValue", "name": "threads", "value": threads}));
    made.put("#run", || {
        let mut action = json!({
            "@type": "CreateAction",
            "name": format!("Run of {}", plan.name),
            "instrument": workflow,
            "agent": {"@id": "#heartian"},
            "startTime": clock::iso(story.start),
            "endTime": end,
            "actionStatus": status(failed == 0),
            "object": objects,
            "result": results,
            "environment": [host, threads],
        });
        if failed > 0 {
            action["error"] = json!(format!("{failed} of {} nodes failed or were not reached", reports.len()));
        }
        action
    });
    assemble(made, &Root { name: &plan.name, doc: story.graph.doc(), end: &end, parts, workflow, actions })
}

/// What the root data set says.
struct Root<'a> {
    name: &'a str,
    doc: &'a str,
    end: &'a str,
    parts: Vec<Value>,
    workflow: Value,
    actions: Vec<Value>,
}

fn assemble(made: Crate, root: &Root<'_>) -> Value {
    let profiles = [
        ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate"),
        ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate"),
        ("https://w3id.org/workflowhub/workflow-ro-crate/1.0", "Workflow RO-Crate"),
    ];
    let ids: Vec<Value> = profiles.iter().map(|(id, _)| json!({"@id": id})).collect();
    let described = if root.doc.is_empty() { "A run of a Heartian graph." } else { root.doc };
    let mut entities = vec![
        json!({"@id": "ro-crate-metadata.json", "@type": "CreativeWork", "about": {"@id": "./"}, "conformsTo": [
            {"@id": "https://w3id.org/ro/crate/1.1"}, {"@id": "https://w3id.org/workflowhub/workflow-ro-crate/1.0"},
        ]}),
        json!({"@id": "./", "@type": "Dataset", "name": format!("Run of {}", root.name), "description": described,
               "datePublished": root.end, "license": "Not stated; that of the recordings applies.", "conformsTo": ids,
               "hasPart": root.parts, "mainEntity": root.workflow, "mentions": root.actions}),
    ];
    entities.extend(profiles.iter().map(|(id, name)| {
        let version = id.rsplit('/').next().unwrap_or_default();
        json!({"@id": id, "@type": "CreativeWork", "name": name, "version": version})
    }));
    entities.extend(made.entities);
    json!({
        "@context": ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"],
        "@graph": entities,
    })
}

/// What the command line changed.
fn settings(story: &Story<'_>, made: &mut Crate) -> Vec<Value> {
    let pairs = story.sets.iter().filter_map(|set| set.split_once('='));
    pairs
        .map(|(name, value)| {
            made.put(
                &format!("#set/{}", encoded(name)),
                || json!({"@type": "PropertyValue", "name": name, "value": value}),
            )
        })
        .collect()
}

/// The action of one node, and the files it read.
fn node_action(story: &Story<'_>, node: &PlanNode, report: &NodeReport, made: &mut Crate) -> (Value, Vec<Value>) {
    let kind = made.put(&format!("#kind/{}", encoded(node.kind.kind)), || {
        let library = node.kind.implementation.map_or(String::new(), |digest| format!(", library {}", blake3(&digest)));
        json!({"@type": "SoftwareApplication", "name": node.kind.kind,
               "softwareVersion": format!("revision {}{library}", node.kind.revision),
               "description": node.kind.doc.split_whitespace().collect::<Vec<_>>().join(" ")})
    });
    let mut objects: Vec<Value> = Vec::new();
    for (from, port) in node.inputs.iter().flat_map(|input| &input.from) {
        let digest = story.reports.get(*from).and_then(|report| report.outputs.get(port.name));
        objects.extend(digest.map(|digest| json!({"@id": artifact_id(digest)})));
    }
    let sources = source_files(story, node, report, made);
    objects.extend(sources.iter().cloned());
    for (name, value) in &node.values {
        let doc = node.kind.param(name);
        objects.push(made.put(&format!("#param/{}.{}", encoded(&node.id), encoded(name)), || {
            let mut entity = Map::new();
            entity.insert("@type".to_owned(), json!("PropertyValue"));
            entity.insert("name".to_owned(), json!(format!("{}.{name}", node.id)));
            let plain = value.is_number() || value.is_string() || value.is_boolean();
            entity.insert("value".to_owned(), if plain { value.clone() } else { json!(value.to_string()) });
            entity.extend(doc.and_then(|doc| doc.unit).map(|unit| ("unitText".to_owned(), json!(unit))));
            Value::Object(entity)
        }));
    }
    let results: Vec<Value> = report
        .outputs
        .iter()
        .map(|(port, digest)| {
            made.put(&artifact_id(digest), || {
                let artifact = node.kind.output(port).map_or("", |port| port.artifact.name);
                json!({"@type": "CreativeWork", "name": format!("{}.{port}", node.id), "additionalType": artifact,
                       "encodingFormat": "safetensors", "identifier": blake3(digest)})
            })
        })
        .collect();
    let did = match report.status {
        Status::Hit => "from the cache".to_owned(),
        Status::Ran => format!("ran in {}", clock::span(report.seconds)),
        Status::Failed => "failed".to_owned(),
        Status::Skipped => "was not reached".to_owned(),
    };
    let action = made.put(&format!("#node/{}", encoded(&node.id)), || {
        let mut action = json!({
            "@type": "CreateAction",
            "name": format!("{} ({})", node.id, node.kind.kind),
            "description": did,
            "instrument": kind,
            "object": objects,
            "result": results,
            "actionStatus": status(matches!(report.status, Status::Hit | Status::Ran)),
        });
        if let Some(key) = &report.key {
            action["identifier"] = json!(blake3(key));
        }
        if let Some(error) = &report.error {
            action["error"] = json!(error.message);
        }
        action
    });
    (action, sources)
}

/// The files a node read, by the digests that stand in its key.
fn source_files(story: &Story<'_>, node: &PlanNode, report: &NodeReport, made: &mut Crate) -> Vec<Value> {
    if node.sources.is_empty() {
        return Vec::new();
    }
    let record = report.key.as_ref().and_then(|key| story.cache.recorded(key));
    let preimage: Value = record.and_then(|record| serde_json::from_str(&record.preimage).ok()).unwrap_or_default();
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    let mut files = Vec::new();
    for source in &node.sources {
        let at = seen.entry(source.parameter).or_default();
        let digest = preimage["sources"][source.parameter][*at].as_str().unwrap_or_default().to_owned();
        *at += 1;
        let id = format!("#source/{}.{}/{}", encoded(&node.id), source.parameter, *at);
        files.push(made.put(&id, || {
            let mut entity = json!({"@type": "CreativeWork", "name": source.path.display().to_string()});
            if !digest.is_empty() {
                entity["identifier"] = json!(format!("blake3:{digest}"));
            }
            entity
        }));
    }
    files
}

/// Each figure, and the artifact it stands in.
fn figures(delivered: &Delivered, made: &mut Crate) -> Vec<Value> {
    let figure = |(name, value): (&String, &f64)| {
        let from = delivered.origins.get(name).map(|digest| json!({"@id": artifact_id(digest)}));
        made.put(&format!("#metric/{}", encoded(name)), || {
            let value = if value.is_finite() { json!(value) } else { json!("not measured") };
            let mut entity = json!({"@type": "PropertyValue", "name": name, "value": value});
            if let Some(from) = from {
                entity["isBasedOn"] = from;
            }
            entity
        })
    };
    delivered.metrics.iter().map(figure).collect()
}

fn status(well: bool) -> Value {
    let name = if well { "CompletedActionStatus" } else { "FailedActionStatus" };
    json!({"@id": format!("http://schema.org/{name}")})
}

fn blake3(digest: &Digest) -> String {
    format!("blake3:{digest}")
}

fn artifact_id(digest: &Digest) -> String {
    format!("#blake3/{digest}")
}

/// A name as part of an `@id`: what a URI cannot hold is written as `%XX`.
fn encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.' | b'/' | b'~');
    let write = |byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    name.bytes().map(write).collect()
}

fn host() -> String {
    let named = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let named = named.or_else(|| std::env::var("HOSTNAME").ok()).or_else(|| std::env::var("COMPUTERNAME").ok());
    named.map_or("unknown".to_owned(), |name| name.trim().to_owned())
}
