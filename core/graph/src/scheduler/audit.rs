//! Audits: cached nodes run again, and what they make is compared byte by byte with what the cache keeps.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::artifacts::Inputs;
use crate::context::{Context, Event, Status};
use crate::digest::Digest;
use crate::node::NodeError;

use super::{Preview, Run, RunOptions};

/// What an audit says of one node.
#[derive(Clone, Debug)]
pub enum Verdict {
    /// The same bytes as in the cache.
    Same,
    /// Other bytes on these ports: the node is not a function of its key.
    Differs(Vec<&'static str>),
    /// It failed, or its inputs cannot be read, although it is cached.
    Failed(NodeError),
}

/// One audited node.
#[derive(Clone, Debug)]
pub struct AuditReport {
    /// Its id in the graph.
    pub id: Arc<str>,
    /// Its kind.
    pub kind: &'static str,
    /// Its action key.
    pub key: Digest,
    /// What came of it.
    pub verdict: Verdict,
}

impl Run<'_> {
    /// Recomputes a sample of the cached nodes, one after the other, and stores nothing. `share` is from 0 to 1; at least
    /// one node is recomputed if any is cached. Which ones depends on `choice` alone.
    pub fn audit(&self, share: f64, choice: u64, options: &RunOptions) -> Vec<AuditReport> {
        let previews = self.preview();
        let cached: Vec<usize> = (0..previews.len()).filter(|at| previews[*at].record.is_some()).collect();
        let count = (cached.len() as f64 * share.clamp(0.0, 1.0)).round() as usize;
        let count = count.clamp(cached.len().min(1), cached.len());
        let draw = |at: &usize| Digest::of(&[choice.to_le_bytes(), (*at as u64).to_le_bytes()].concat());
        let mut chosen = cached;
        chosen.sort_by_key(draw);
        chosen.truncate(count);
        chosen.sort_unstable();
        let mut reports = Vec::with_capacity(count);
        for at in chosen {
            if options.cancel.requested() {
                break;
            }
            let node = &self.plan.nodes[at];
            let Some((key, _)) = previews[at].key else { continue };
            options.observer.event(&Event::Started { node: &node.id, kind: node.kind.kind });
            let start = std::time::Instant::now();
            let verdict = match self.recompute(at, &previews, options) {
                Ok(ports) if ports.is_empty() => Verdict::Same,
                Ok(ports) => Verdict::Differs(ports),
                Err(_) if options.cancel.requested() => break,
                Err(error) => Verdict::Failed(error),
            };
            let status = if matches!(verdict, Verdict::Same) { Status::Ran } else { Status::Failed };
            let seconds = start.elapsed().as_secs_f64();
            options.observer.event(&Event::Finished { node: &node.id, status, seconds });
            reports.push(AuditReport { id: node.id.clone(), kind: node.kind.kind, key, verdict });
        }
        reports
    }

    /// Runs one cached node again; gives the ports whose bytes differ.
    fn recompute(&self, at: usize, previews: &[Preview], options: &RunOptions) -> Result<Vec<&'static str>, NodeError> {
        let node = &self.plan.nodes[at];
        let digest = |at: usize, port: &str| {
            previews[at].record.as_ref().and_then(|record| record.outputs.get(port)).map(|output| output.digest)
        };
        let mut inputs = Inputs::new();
        for input in &node.inputs {
            for (from, port) in &input.from {
                let Some(digest) = digest(*from, port.name) else { continue };
                let lost = || NodeError::new(format!("its input `{}` is damaged in the cache", input.port.name));
                let file = self.cache.open_verified(&digest)?.ok_or_else(lost)?;
                inputs = inputs.with(input.port.name, port.decode_file(file)?);
            }
        }
        let context = Context::new(&node.id, self.plan.seed, options.cancel.clone(), options.observer.clone());
        let threads = node.node.resources().threads.clamp(1, options.jobs.max(1));
        let outputs = self.guarded(at, &inputs, &context.with_threads(threads))?;
        let mut made = BTreeMap::new();
        for (port, artifact) in outputs.iter() {
            let digest = &mut |pieces: &[&[u8]]| {
                made.insert(port, Digest::of_pieces(pieces.iter().copied()));
            };
            artifact.in_pieces(digest)?;
        }
        let ports = node.kind.outputs.iter().map(|port| port.name);
        Ok(ports.filter(|port| made.get(port).copied() != digest(at, port)).collect())
    }
}
