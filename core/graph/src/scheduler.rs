//! Runs a plan: asks the cache first, runs what is missing, stores what was made, forgets what nobody needs any more.
//!
//! Always holds: a node runs only when all its inputs are present and verified; what a node made is in the cache before
//! the next one starts, so that a kill loses at most one node's work. Values are decoded only for nodes that run.

mod execute;

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Instant;

use crate::artifacts::{AnyArtifact, Inputs};
use crate::cache::{Cache, CacheError, Record};
use crate::context::{Cancel, Event, Observer, Status};
use crate::diagnostic::Problem;
use crate::digest::Digest;
use crate::key::{Statement, source_digests};
use crate::node::NodeError;
use crate::plan::Plan;

/// How often one node is recomputed because what the cache holds of it is damaged, before the cache itself is blamed.
const HEAL_LIMIT: u32 = 3;

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
}

impl Default for RunOptions {
    fn default() -> Self {
        let jobs = std::thread::available_parallelism().map_or(1, usize::from);
        Self { cancel: Cancel::default(), observer: Arc::new(()), keep_going: false, jobs, memory_bytes: u64::MAX }
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
    /// Its action key, when its inputs were known.
    pub key: Option<Digest>,
    /// Digests of its outputs by port, when there are any.
    pub outputs: BTreeMap<&'static str, Digest>,
    /// Why it failed.
    pub error: Option<NodeError>,
}

impl NodeReport {
    /// The failure with its place in the graph, if it failed.
    pub fn problem(&self, plan: &Plan) -> Option<Problem> {
        let error = self.error.as_ref()?;
        let node = plan.nodes.iter().find(|node| node.id == self.id)?;
        let parameter = error.parameter.map_or(String::new(), |name| format!(", parameter `{name}`"));
        let message = format!("node `{}` ({}){parameter}: {}", self.id, self.kind, error.message);
        Some(Problem::new(node.place(error.parameter), message).maybe_help(error.remedy.clone()))
    }
}

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

    /// Runs the plan. Never stops for a node's failure without a word about every node.
    pub fn execute(&self, options: &RunOptions) -> Vec<NodeReport> {
        let count = self.plan.nodes.len();
        let last_use = self.last_use();
        let mut state = State { turns: vec![None; count], held: vec![BTreeMap::new(); count], heals: vec![0; count] };
        let mut stopped = false;
        let mut at = 0;
        while at < count {
            stopped |= options.cancel.requested();
            match self.turn(at, &mut state, options, stopped) {
                Step::Back(producer) => at = producer,
                Step::Done => {
                    let failed = state.turns[at].as_ref().is_some_and(|turn| turn.status == Status::Failed);
                    stopped |= failed && !options.keep_going;
                    let producers = self.plan.nodes[at].inputs.iter().flat_map(|input| &input.from);
                    for index in producers.map(|(from, _)| *from).chain([at]) {
                        let used = |port| last_use.get(&(index, port)).is_some_and(|last| *last > at);
                        state.held[index].retain(|port, _| used(*port));
                    }
                    at += 1;
                }
            }
        }
        state.turns.into_iter().flatten().collect()
    }

    /// The last node to read each output; absent when nobody does.
    fn last_use(&self) -> HashMap<(usize, &'static str), usize> {
        let nodes = self.plan.nodes.iter().enumerate();
        let wires = nodes.flat_map(|(index, node)| node.inputs.iter().map(move |input| (index, input)));
        wires
            .flat_map(|(index, input)| input.from.iter().map(move |(from, port)| ((*from, port.name), index)))
            .collect()
    }

    /// One node's turn.
    fn turn(&self, at: usize, state: &mut State, options: &RunOptions, stopped: bool) -> Step {
        let node = &self.plan.nodes[at];
        let start = Instant::now();
        let mut report = NodeReport {
            id: node.id.clone(),
            kind: node.kind.kind,
            status: Status::Skipped,
            seconds: 0.0,
            key: None,
            outputs: BTreeMap::new(),
            error: None,
        };
        let fed = node.inputs.iter().flat_map(|input| &input.from).all(|(from, _)| state.is_done(*from));
        if stopped && state.is_done(at) {
            return Step::Done;
        }
        if !stopped && fed {
            let outcome = self.key(at, &|from, port| state.digest(from, port)).and_then(|(key, preimage)| {
                report.key = Some(key);
                if state.is_done(at) && state.turns[at].as_ref().and_then(|turn| turn.key) == report.key {
                    return Ok(None);
                }
                match self.cache.record(&key) {
                    Some(record) => Ok(Some(Outcome::hit(record))),
                    None => self.run(at, (key, preimage), state, options).map(Some),
                }
            });
            match outcome {
                Ok(None) => return Step::Done,
                Ok(Some(Outcome::Damaged { producer })) => {
                    state.turns[producer] = None;
                    state.heals[producer] += 1;
                    return Step::Back(producer);
                }
                Ok(Some(Outcome::Finished { status, record })) => {
                    report.status = status;
                    for text in record.warnings.iter().filter(|_| status == Status::Hit) {
                        options.observer.event(&Event::Warning { node: &node.id, text });
                    }
                    let digest = |port: &'static str| record.outputs.get(port).map(|output| (port, output.digest));
                    report.outputs = node.kind.outputs.iter().filter_map(|port| digest(port.name)).collect();
                }
                Err(error) => {
                    let cancelled = options.cancel.requested();
                    report.status = Status::Failed;
                    report.error = Some(if cancelled { NodeError::cancelled() } else { error });
                }
            }
        }
        report.seconds = start.elapsed().as_secs_f64();
        let (status, seconds) = (report.status, report.seconds);
        options.observer.event(&Event::Finished { node: &node.id, status, seconds });
        state.turns[at] = Some(report);
        Step::Done
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

    /// The node's inputs, from memory or from the cache; `Err` inside names a producer whose output is damaged.
    fn inputs(&self, at: usize, state: &mut State) -> Result<Result<Inputs, usize>, NodeError> {
        let mut inputs = Inputs::new();
        for input in &self.plan.nodes[at].inputs {
            for (from, port) in &input.from {
                let Some(digest) = state.digest(*from, port.name) else { continue };
                if let Some(artifact) = state.held[*from].get(port.name) {
                    inputs = inputs.with(input.port.name, artifact.clone());
                    continue;
                }
                let decoded = self.cache.bytes(&digest)?.map(|bytes| port.decode(bytes));
                if let Some(Ok(artifact)) = decoded {
                    state.held[*from].insert(port.name, artifact.clone());
                    inputs = inputs.with(input.port.name, artifact);
                    continue;
                }
                if state.heals[*from] >= HEAL_LIMIT {
                    let reason = decoded.and_then(Result::err).map_or("damaged".to_owned(), |error| error.to_string());
                    let id = &self.plan.nodes[*from].id;
                    let message = format!("what the cache keeps of `{id}.{}` cannot be used: {reason}", port.name);
                    return Err(NodeError::new(message).remedy("choose another cache folder with --cache DIR"));
                }
                self.cache.forget(&digest);
                return Ok(Err(*from));
            }
        }
        Ok(Ok(inputs))
    }
}

/// What is known of each node while a run goes on.
struct State {
    turns: Vec<Option<NodeReport>>,
    /// Values in memory, until their last use.
    held: Vec<BTreeMap<&'static str, AnyArtifact>>,
    /// How often the node was recomputed because of damage.
    heals: Vec<u32>,
}

impl State {
    fn is_done(&self, index: usize) -> bool {
        self.turns[index].as_ref().is_some_and(|turn| matches!(turn.status, Status::Hit | Status::Ran))
    }

    fn digest(&self, index: usize, port: &str) -> Option<Digest> {
        self.turns[index].as_ref()?.outputs.get(port).copied()
    }
}

enum Step {
    Done,
    Back(usize),
}

/// What came of a node whose inputs are known.
enum Outcome {
    Finished { status: Status, record: Record },
    Damaged { producer: usize },
}

impl Outcome {
    fn hit(record: Record) -> Self {
        Self::Finished { status: Status::Hit, record }
    }
}

/// Loads a cached artifact outside a run; nothing when it is absent or damaged.
///
/// # Errors
/// When the cache folder cannot be read.
pub fn load<T: heartian_artifact::Artifact>(cache: &Cache, digest: &Digest) -> Result<Option<Arc<T>>, CacheError> {
    let Some(bytes) = cache.bytes(digest)? else { return Ok(None) };
    match AnyArtifact::decode::<T>(&bytes) {
        Ok(artifact) => Ok(artifact.downcast()),
        Err(_) => {
            cache.forget(digest);
            Ok(None)
        }
    }
}
