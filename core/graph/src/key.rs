//! What a node's outputs depend on, as one JSON value: the preimage of its action key.
//!
//! In it: kind, revision, parameters that affect the output, contents of source files and inputs, seed, the on-disk form
//! of the outputs. Never in it: ids, graph names, paths, times, thread counts, host.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::cache::Cache;
use crate::digest::Digest;
use crate::node::NodeError;
use crate::plan::PlanNode;

/// Raised when the meaning of a key changes, so that old records are not found.
const VERSION: &str = "heartian-key/1";

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

/// The preimage of a node's key; `inputs` holds, by port, the digests of what is wired, absent values left out.
pub(crate) fn preimage(node: &PlanNode, sources: &SourceDigests, inputs: Value, seed: u64) -> Value {
    let keyed = |name: &str| {
        let named = node.kind.param(name).is_none_or(|param| param.keyed);
        named && !sources.contains_key(name)
    };
    let params: Map<String, Value> =
        node.values.iter().filter(|(name, _)| keyed(name)).map(|(name, value)| (name.clone(), value.clone())).collect();
    let forms =
        node.kind.outputs.iter().map(|port| (port.name.to_owned(), json!([port.artifact.name, port.artifact.version])));
    json!({
        "key": VERSION,
        "kind": node.kind.kind,
        "revision": node.kind.revision,
        "params": params,
        "sources": sources,
        "inputs": inputs,
        "seed": seed,
        "outputs": forms.collect::<Map<_, _>>(),
    })
}
