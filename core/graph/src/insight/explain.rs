//! Why a node is a hit or a miss: which field of its key changed, from what to what, back to the node that caused it.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::time::SystemTime;

use serde::Serialize;
use serde_json::Value;

use crate::digest::Digest;
use crate::plan::Plan;
use crate::scheduler::Preview;

use super::history::{Change, Entry, History};

/// A chain of causes is followed this far.
const CAUSES: usize = 32;

/// How a node stands to the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Standing {
    /// Its outputs are in the cache.
    Hit,
    /// It ran, or will run.
    Miss,
    /// Something it reads must run first; if that writes the bytes it wrote before, this is a hit.
    Waits,
    /// It was not reached, or its key cannot be known.
    Unknown,
}

/// A node to be explained.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Its id in the graph.
    pub id: String,
    /// Its kind.
    pub kind: String,
    /// How it stands.
    pub standing: Standing,
    /// Its action key, when known.
    pub key: Option<Digest>,
    /// The key's preimage, parsed; null when it is not known.
    pub fields: Value,
    /// Digests of its outputs, when known.
    pub outputs: Vec<Digest>,
    /// Ids of the nodes that feed it and must run first.
    pub waits_for: Vec<String>,
    /// Only records made before this explain it.
    pub before: Option<SystemTime>,
}

/// How a node's key differs from that of an earlier record.
#[derive(Clone, Debug, Serialize)]
pub struct Cause {
    /// The node whose key it is.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// The earlier record's key.
    pub earlier: Digest,
    /// When the earlier record was made.
    #[serde(skip)]
    pub made: SystemTime,
    /// What differs.
    pub changes: Vec<Change>,
}

/// Why a node is what it is.
#[derive(Clone, Debug, Serialize)]
pub struct Explanation {
    /// Its id in the graph.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// How it stands.
    pub standing: Standing,
    /// Its action key, when known.
    pub key: Option<Digest>,
    /// When its record was made, for a hit and for what has run.
    #[serde(skip)]
    pub made: Option<SystemTime>,
    /// How long it took then, in seconds.
    pub seconds: Option<f64>,
    /// Ids of the nodes that feed it and must run first.
    pub waits_for: Vec<String>,
    /// The difference to the nearest earlier record, then that of the node upstream which caused it, and so on. Empty
    /// for a hit, and for the first of its kind.
    pub causes: Vec<Cause>,
}

/// The nodes of a plan that has not run.
pub fn subjects_of_plan(plan: &Plan, previews: &[Preview]) -> Vec<Subject> {
    let nodes = plan.nodes.iter().zip(previews);
    let subject = |(node, preview): (&crate::PlanNode, &Preview)| {
        let producers = node.inputs.iter().flat_map(|input| &input.from).map(|(from, _)| *from);
        let mut missing: Vec<usize> = producers.filter(|from| previews[*from].record.is_none()).collect();
        missing.sort_unstable();
        missing.dedup();
        let standing = match (&preview.key, &preview.record) {
            (_, Some(_)) => Standing::Hit,
            (Some(_), None) => Standing::Miss,
            (None, None) if !missing.is_empty() => Standing::Waits,
            (None, None) => Standing::Unknown,
        };
        Subject {
            id: node.id.to_string(),
            kind: node.kind.kind.to_owned(),
            standing,
            key: preview.key.as_ref().map(|(key, _)| *key),
            fields: preview.key.as_ref().map_or(Value::Null, |(_, text)| parse(text)),
            outputs: preview.record.iter().flat_map(|record| record.outputs.values()).map(|o| o.digest).collect(),
            waits_for: missing.into_iter().map(|index| plan.nodes[index].id.to_string()).collect(),
            before: None,
        }
    };
    nodes.map(subject).collect()
}

fn parse(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or(Value::Null)
}

/// A node of a finished run, as the run's folder records it.
#[derive(Clone, Debug)]
pub struct PastNode {
    /// Its id in the graph.
    pub id: String,
    /// Its kind.
    pub kind: String,
    /// How its turn ended.
    pub status: crate::Status,
    /// Its action key, when it was known.
    pub key: Option<Digest>,
    /// Digests of its outputs by port.
    pub outputs: BTreeMap<String, Digest>,
}

/// The nodes of a run that is over.
pub fn subjects_of_run(nodes: &[PastNode], history: &History) -> Vec<Subject> {
    let subject = |node: &PastNode| {
        let entry = node.key.as_ref().and_then(|key| history.get(key));
        let standing = match node.status {
            crate::Status::Hit => Standing::Hit,
            crate::Status::Ran => Standing::Miss,
            crate::Status::Failed if node.key.is_some() => Standing::Miss,
            crate::Status::Failed | crate::Status::Skipped => Standing::Unknown,
        };
        Subject {
            id: node.id.clone(),
            kind: node.kind.clone(),
            standing,
            key: node.key,
            fields: entry.map_or(Value::Null, |entry| entry.fields.clone()),
            outputs: node.outputs.values().copied().collect(),
            waits_for: Vec::new(),
            before: entry.map(|entry| entry.made),
        }
    };
    nodes.iter().map(subject).collect()
}

/// Explains nodes against what the cache remembers.
pub struct Explainer<'a> {
    history: &'a History,
    subjects: &'a [Subject],
    writers: HashMap<Digest, usize>,
}

impl<'a> Explainer<'a> {
    /// Explains `subjects`, which are all nodes of one plan or run.
    pub fn new(history: &'a History, subjects: &'a [Subject]) -> Self {
        let outputs = subjects.iter().enumerate();
        let writers = outputs.flat_map(|(index, subject)| subject.outputs.iter().map(move |digest| (*digest, index)));
        Self { history, subjects, writers: writers.collect() }
    }

    /// Why one node is what it is.
    pub fn explain(&self, index: usize) -> Explanation {
        let subject = &self.subjects[index];
        let entry = subject.key.as_ref().and_then(|key| self.history.get(key));
        let causes = if subject.standing == Standing::Miss { self.causes(subject) } else { Vec::new() };
        Explanation {
            node: subject.id.clone(),
            kind: subject.kind.clone(),
            standing: subject.standing,
            key: subject.key,
            made: entry.map(|entry| entry.made),
            seconds: entry.map(|entry| entry.record.seconds),
            waits_for: subject.waits_for.clone(),
            causes,
        }
    }

    /// From the node upwards: at each step the first input that changed leads to the node that wrote it.
    fn causes(&self, subject: &Subject) -> Vec<Cause> {
        let mut causes = Vec::new();
        let mut seen = HashSet::new();
        let cause = |subject: &Subject, (entry, changes): (&Entry, Vec<Change>)| Cause {
            node: subject.id.clone(),
            kind: subject.kind.clone(),
            earlier: entry.key,
            made: entry.made,
            changes,
        };
        let mut next =
            self.history.nearest(&subject.kind, &subject.fields, subject.before).map(|found| cause(subject, found));
        while let Some(found) = next.take().filter(|_| causes.len() < CAUSES) {
            let upstream = found.changes.iter().find_map(|change| {
                let (from, to) = change.input()?;
                let writer = &self.subjects[*self.writers.get(&to)?];
                let earlier = self.history.writer(&from, &writer.fields)?;
                // Of another kind, it is another wire, which is the whole of the explanation.
                let same = earlier.0.fields["kind"] == writer.kind.as_str();
                (same && seen.insert(writer.id.clone())).then(|| cause(writer, earlier))
            });
            causes.push(found);
            next = upstream;
        }
        causes
    }
}
