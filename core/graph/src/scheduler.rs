//! Runs a plan: asks the cache first, runs what is missing, several nodes at once where resources allow.
//!
//! Always holds: a node runs only when all its inputs are present and verified; what a node made is in the cache before
//! its turn ends, so that a kill loses only what was being worked on. Values are decoded only for nodes that run, and
//! kept only for nodes that wait. Which nodes ran at once changes no byte of what they make.

mod audit;
mod board;
mod execute;
mod work;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use heartian_artifact::BundleReader;

use crate::artifacts::AnyArtifact;
use crate::cache::{Cache, CacheError, Record};
use crate::context::{Cancel, Observer, Status};
use crate::diagnostic::Problem;
use crate::digest::Digest;
use crate::key::{Statement, source_digests};
use crate::node::NodeError;
use crate::plan::Plan;

/// How to run.
#[derive(Clone)]
pub struct RunOptions {
    /// To stop early.
    pub cancel: Cancel,
    /// Who hears of progress.
    pub observer: Arc<dyn Observer>,
    /// After a failure, still run what does not depend on it.
    pub keep_going: bool,
    /// Most threads that nodes running at once may keep busy; at least 1.
    pub jobs: usize,
    /// Most memory that nodes running at once may say they need; a node that needs more runs alone.
    pub memory_bytes: u64,
    /// How often a long node may keep a state to resume from.
    pub checkpoint_every: Duration,
}

impl Default for RunOptions {
    fn default() -> Self {
        let jobs = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            cancel: Cancel::default(),
            observer: Arc::new(()),
            keep_going: false,
            jobs,
            memory_bytes: u64::MAX,
            checkpoint_every: Duration::from_secs(20),
        }
    }
}

/// How a node's turn ended.
#[derive(Clone, Debug)]
pub struct NodeReport {
    /// Its id in the graph.
    pub id: Arc<str>,
    /// Its kind.
    pub kind: &'static str,
    /// How its turn ended.
    pub status: Status,
    /// Wall time of its turn.
    pub seconds: f64,
    /// How long it ran when its outputs were made, whether in this run or, for a hit, in an earlier one; 0 without outputs.
    pub work_seconds: f64,
    /// Its action key, when its inputs were known.
    pub key: Option<Digest>,
    /// Digests of its outputs by port, when there are any.
    pub outputs: BTreeMap<&'static str, Digest>,
    /// Why it failed.
    pub error: Option<NodeError>,
}

impl NodeReport {
    /// A node that had no turn.
    fn of(plan: &Plan, at: usize) -> Self {
        Self {
            id: plan.nodes[at].id.clone(),
            kind: plan.nodes[at].kind.kind,
            status: Status::Skipped,
            seconds: 0.0,
            work_seconds: 0.0,
            key: None,
            outputs: BTreeMap::new(),
            error: None,
        }
    }

    /// The failure with its place in the graph, if it failed.
    pub fn problem(&self, plan: &Plan) -> Option<Problem> {
        let error = self.error.as_ref()?;
        let node = plan.nodes.iter().find(|node| node.id == self.id)?;
        let parameter = error.parameter.map_or(String::new(), |name| format!(", parameter `{name}`"));
        let message = format!("node `{}` ({}){parameter}: {}", self.id, self.kind, error.message);
        Some(Problem::new(node.place(error.parameter), message).maybe_help(error.remedy.clone()))
    }
}

pub use audit::{AuditReport, Verdict};

/// What the cache knows of one node before a run.
#[derive(Clone, Debug)]
pub struct Preview {
    /// Its action key and the key's preimage, a JSON text, when all that feeds it is cached.
    pub key: Option<(Digest, String)>,
    /// Its record, when it would be a hit.
    pub record: Option<Record>,
}

/// A plan with its source files digested, ready to run.
pub struct Run<'a> {
    plan: &'a Plan,
    cache: &'a Cache,
    statements: Vec<Result<Statement, NodeError>>,
}

impl<'a> Run<'a> {
    /// Digests the source files.
    pub fn prepare(plan: &'a Plan, cache: &'a Cache) -> Self {
        let state = |node| source_digests(node, cache).map(|sources| Statement::new(node, &sources, plan.seed));
        Self { plan, cache, statements: plan.nodes.iter().map(state).collect() }
    }

    /// A digest of all that the run's results depend on, known before it starts: equal plans get equal ones.
    pub fn fingerprint(&self) -> Digest {
        let mut hasher = blake3::Hasher::new();
        let mut text = |text: &str| {
            hasher.update(&(text.len() as u64).to_le_bytes()).update(text.as_bytes());
        };
        text(&self.plan.name);
        for (node, statement) in self.plan.nodes.iter().zip(&self.statements) {
            text(&node.id);
            match statement {
                Ok(statement) => statement.parts().into_iter().for_each(&mut text),
                Err(error) => text(&error.message),
            }
            for input in &node.inputs {
                text(input.port.name);
                for (from, port) in &input.from {
                    text(&self.plan.nodes[*from].id);
                    text(port.name);
                }
            }
            text("");
        }
        for (index, port) in &self.plan.exports {
            text(&self.plan.nodes[*index].id);
            text(port.name);
        }
        hasher.finalize().into()
    }

    /// What would be a hit, and what not, by node of the plan. Behind a miss nothing is known: it may write the bytes
    /// it wrote before.
    pub fn preview(&self) -> Vec<Preview> {
        let mut found: Vec<Preview> = Vec::with_capacity(self.plan.nodes.len());
        for at in 0..self.plan.nodes.len() {
            let output = |from: usize, port: &str| {
                let record = found[from].record.as_ref()?;
                record.outputs.get(port).map(|output| output.digest)
            };
            let producers = self.plan.nodes[at].inputs.iter().flat_map(|input| &input.from);
            let known = producers.map(|(from, _)| *from).all(|from| found[from].record.is_some());
            let key = known.then(|| self.key(at, &output).ok()).flatten();
            let record = key.as_ref().and_then(|(key, _)| self.cache.record(key));
            found.push(Preview { key, record });
        }
        found
    }

    /// The node's key and its preimage, from the digests of what feeds it.
    fn key(&self, at: usize, output: &dyn Fn(usize, &str) -> Option<Digest>) -> Result<(Digest, String), NodeError> {
        let node = &self.plan.nodes[at];
        let statement = self.statements[at].as_ref().map_err(Clone::clone)?;
        let mut inputs = BTreeMap::new();
        for input in &node.inputs {
            let digests: Vec<Digest> = input.from.iter().filter_map(|(from, port)| output(*from, port.name)).collect();
            if input.port.required && digests.is_empty() {
                let from: Vec<String> = input
                    .from
                    .iter()
                    .map(|(from, port)| format!("`{}.{}`", self.plan.nodes[*from].id, port.name))
                    .collect();
                let message =
                    format!("its input `{}` needs {}, which was not produced", input.port.name, from.join(", "));
                return Err(NodeError::new(message).remedy(format!("give what {} is made of", from.join(", "))));
            }
            if !digests.is_empty() {
                inputs.insert(input.port.name, digests);
            }
        }
        let preimage = statement.preimage(&inputs);
        Ok((Digest::of(preimage.as_bytes()), preimage))
    }
}

/// Loads a cached artifact outside a run; nothing when it is absent or damaged.
///
/// # Errors
/// When the cache folder cannot be read.
pub fn load<T: heartian_artifact::Artifact>(cache: &Cache, digest: &Digest) -> Result<Option<Arc<T>>, CacheError> {
    let Some(file) = cache.open_verified(digest)? else { return Ok(None) };
    match BundleReader::of_file(file).and_then(AnyArtifact::decode::<T>) {
        Ok(artifact) => Ok(artifact.downcast()),
        Err(_) => {
            cache.forget(digest);
            Ok(None)
        }
    }
}
