//! What a node's outputs depend on, as one canonical JSON text: the preimage of its action key.
//!
//! In it: kind, revision or library digest, parameters that affect the output, contents of source files and inputs,
//! seed, the on-disk form of the outputs, the device where that is not the CPU. Never in it: ids, graph names, paths, times, thread counts, host.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde_json::{Map, Value, json};

use crate::cache::Cache;
use crate::digest::{Digest, canonical};
use crate::node::NodeError;
use crate::plan::PlanNode;

/// Raised when the meaning of a key changes, so that old records are not found.
const VERSION: &str = "heartian-key/2";

/// Content digests of a node's source files, by parameter.
pub(crate) type SourceDigests = BTreeMap<&'static str, Vec<Digest>>;

/// Digests all source files of a node.
pub(crate) fn source_digests(node: &PlanNode, cache: &Cache) -> Result<SourceDigests, NodeError> {
    let mut digests = SourceDigests::new();
    for source in &node.sources {
        let digest = cache.source_digest(&source.path).map_err(|error| {
            let message = format!("`{}` cannot be read: {error}", source.path.display());
            let remedy = source.remedy.clone().unwrap_or("check the path and its permissions".into());
            NodeError::new(message).parameter(source.parameter).remedy(remedy)
        })?;
        digests.entry(source.parameter).or_default().push(digest);
    }
    Ok(digests)
}

/// A node's preimage but for its inputs: what is known before anything runs.
#[derive(Clone, Debug)]
pub(crate) struct Statement {
    before: String,
    after: String,
}

impl Statement {
    /// All of a node's preimage that does not come over wires.
    pub fn new(node: &PlanNode, sources: &SourceDigests, seed: u64) -> Self {
        let keyed = |name: &str| {
            let named = node.kind.param(name).is_none_or(|param| param.keyed);
            named && !sources.contains_key(name)
        };
        let params = node.values.iter().filter(|(name, _)| keyed(name));
        let params: Map<String, Value> = params.map(|(name, value)| (name.clone(), value.clone())).collect();
        let form = |port: &crate::Port| (port.name.to_owned(), json!([port.artifact.name, port.artifact.version]));
        let outputs: Map<String, Value> = node.kind.outputs.iter().map(form).collect();
        let implementation = node.kind.implementation.map(|digest| format!("\"implementation\":\"{digest}\","));
        let mut after = json!({
            "key": VERSION,
            "kind": node.kind.kind,
            "outputs": outputs,
            "params": params,
            "revision": node.kind.revision,
            "seed": seed,
            "sources": sources,
        });
        if let (Some(numerics), Value::Object(after)) = (node.node.numerics(), &mut after) {
            after.insert("numerics".into(), numerics.into());
        }
        // "implementation" and "inputs" sort before all other names, so the whole is canonical too.
        Self {
            before: format!("{{{}\"inputs\":", implementation.unwrap_or_default()),
            after: format!(",{}", &canonical(&after)[1..]),
        }
    }

    /// The whole preimage. `inputs` holds, by port, the digests of what is wired, absent values left out.
    pub fn preimage(&self, inputs: &BTreeMap<&str, Vec<Digest>>) -> String {
        let digests = inputs.values().map(Vec::len).sum::<usize>();
        let mut text = String::with_capacity(self.before.len() + self.after.len() + 70 * digests + 24 * inputs.len());
        text.push_str(&self.before);
        text.push('{');
        for (index, (port, digests)) in inputs.iter().enumerate() {
            let comma = if index == 0 { "" } else { "," };
            // Writing to a string cannot fail.
            let _ = write!(text, "{comma}{}:[", Value::from(*port));
            for (index, digest) in digests.iter().enumerate() {
                let comma = if index == 0 { "" } else { "," };
                let _ = write!(text, "{comma}\"{digest}\"");
            }
            text.push(']');
        }
        text.push('}');
        text.push_str(&self.after);
        text
    }

    /// Its text, in two parts.
    pub fn parts(&self) -> [&str; 2] {
        [&self.before, &self.after]
    }
}
