//! One node's work on a thread of its own: claim its key, gather its inputs, run it guarded, check what it made, store it.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use heartian_artifact::ArtifactError;

use crate::artifacts::{AnyArtifact, Inputs, Outputs};
use crate::cache::{Claim, Record};
use crate::context::{Checkpoints, Context, Event, Observer, Status};
use crate::digest::Digest;
use crate::node::{NodeError, Port};
use crate::registry::NodeKind;

use super::{Run, RunOptions};

/// First and longest wait between two looks at a key that someone else computes.
const LOOK_AGAIN: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(50)];

/// A value that several nodes may read: whoever needs it first decodes it, the others wait.
pub(super) type Slot = Arc<Mutex<Option<AnyArtifact>>>;

/// One wire into a node.
pub(super) struct Feed {
    pub port: &'static str,
    pub from: usize,
    pub output: &'static Port,
    pub digest: Digest,
    pub slot: Slot,
}

/// A node that has to run.
pub(super) struct Job {
    pub at: usize,
    pub key: Digest,
    pub preimage: String,
    pub feeds: Vec<Feed>,
    pub threads: usize,
}

/// What came of it.
pub(super) enum Outcome {
    /// It ran; or someone else did meanwhile, and it is a hit without values.
    Finished { status: Status, record: Record, values: Vec<(&'static str, AnyArtifact)> },
    /// What feeds it is damaged, and has been dropped from the cache.
    Damaged { producer: usize, reason: String },
}

impl Run<'_> {
    /// Does a job.
    pub(super) fn work(&self, job: Job, options: &RunOptions) -> Result<Outcome, NodeError> {
        let key = job.key;
        let claim = self.claim(&job, options)?;
        if let Some(record) = self.cache.record(&key) {
            return Ok(Outcome::Finished { status: Status::Hit, record, values: Vec::new() });
        }
        let inputs = match self.gather(&job)? {
            Ok(inputs) => inputs,
            Err(damaged) => return Ok(damaged),
        };
        let Job { at, preimage, threads, .. } = job;
        let node = &self.plan.nodes[at];
        options.observer.event(&Event::Started { node: &node.id, kind: node.kind.kind });
        let start = Instant::now();
        let recorder = Arc::new(Recorder { inner: options.observer.clone(), warnings: Mutex::default() });
        let context = Context::new(&node.id, self.plan.seed, options.cancel.clone(), recorder.clone())
            .with_threads(threads)
            .with_checkpoints(Checkpoints::new(self.cache, key, options.checkpoint_every));
        let outputs = self.guarded(at, &inputs, &context)?;
        drop(inputs);
        let mut stored = BTreeMap::new();
        for (port, artifact) in outputs.iter() {
            let mut put = None;
            let unusable = |error: ArtifactError| unusable(port, &error.to_string());
            artifact.in_pieces(&mut |pieces| put = Some(self.cache.put(pieces))).map_err(unusable)?;
            stored.extend(put.transpose()?.map(|output| (port.to_owned(), output)));
        }
        let warnings = std::mem::take(&mut *recorder.warnings.lock().unwrap_or_else(PoisonError::into_inner));
        let record = Record { outputs: stored, warnings, seconds: start.elapsed().as_secs_f64(), preimage };
        self.cache.put_record(&key, &record)?;
        self.cache.drop_checkpoint(&key);
        drop(claim);
        let values = outputs.iter().map(|(port, artifact)| (port, artifact.clone())).collect();
        Ok(Outcome::Finished { status: Status::Ran, record, values })
    }

    /// Waits until nobody else computes the key.
    fn claim(&self, job: &Job, options: &RunOptions) -> Result<Claim, NodeError> {
        let [mut pause, longest] = LOOK_AGAIN;
        let node = &self.plan.nodes[job.at];
        let mut told = false;
        loop {
            if let Some(claim) = self.cache.try_claim(&job.key)? {
                return Ok(claim);
            }
            if !told {
                options.observer.event(&Event::Waiting { node: &node.id, kind: node.kind.kind });
                told = true;
            }
            if options.cancel.requested() {
                return Err(NodeError::cancelled());
            }
            std::thread::sleep(pause);
            pause = (pause * 2).min(longest);
        }
    }

    /// The node's inputs, from memory or from the cache; `Err` inside names a producer whose output is damaged.
    fn gather(&self, job: &Job) -> Result<Result<Inputs, Outcome>, NodeError> {
        let mut inputs = Inputs::new();
        for feed in &job.feeds {
            let mut slot = feed.slot.lock().unwrap_or_else(PoisonError::into_inner);
            if slot.is_none() {
                match self.cache.open_verified(&feed.digest)?.map(|file| feed.output.decode_file(file)) {
                    Some(Ok(artifact)) => *slot = Some(artifact),
                    other => {
                        self.cache.forget(&feed.digest);
                        let reason =
                            other.and_then(Result::err).map_or("damaged".to_owned(), |error| error.to_string());
                        return Ok(Err(Outcome::Damaged { producer: feed.from, reason }));
                    }
                }
            }
            if let Some(artifact) = &*slot {
                inputs = inputs.with(feed.port, artifact.clone());
            }
        }
        Ok(Ok(inputs))
    }

    /// Runs the node; a panic is an error of the node, as is an output it does not declare.
    pub(super) fn guarded(&self, at: usize, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let node = &self.plan.nodes[at];
        let outputs = catch_unwind(AssertUnwindSafe(|| node.node.run(inputs, context)))
            .unwrap_or_else(|payload| Err(panicked(&*payload)))?;
        check(&node.kind, &outputs)?;
        Ok(outputs)
    }
}
/// Passes events on and keeps the warnings, which a later hit repeats.
struct Recorder {
    inner: Arc<dyn Observer>,
    warnings: Mutex<Vec<String>>,
}

impl Observer for Recorder {
    fn event(&self, event: &Event<'_>) {
        if let Event::Warning { text, .. } = event {
            self.warnings.lock().unwrap_or_else(PoisonError::into_inner).push((*text).to_owned());
        }
        self.inner.event(event);
    }
}

/// A panic as an error of the node.
pub(super) fn panicked(payload: &(dyn Any + Send)) -> NodeError {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or("no message".into());
    NodeError::new(format!("the node panicked: {text}"))
        .remedy("this is a mistake in the node, not in your graph; please report it with this message")
}

fn unusable(port: &str, reason: &str) -> NodeError {
    NodeError::new(format!("its output `{port}` is unusable: {reason}"))
        .remedy("this is a mistake in the node, not in your graph; please report it with this message")
}

/// Every required port written, no other, each with the type it declares.
fn check(kind: &NodeKind, outputs: &Outputs) -> Result<(), NodeError> {
    for (name, artifact) in outputs.iter() {
        let found = artifact.artifact_type();
        match kind.output(name) {
            Some(port) if port.artifact == found => {}
            Some(port) => return Err(unusable(name, &format!("it is `{}`, not `{}`", found.name, port.artifact.name))),
            None => return Err(unusable(name, "the node does not declare it")),
        }
    }
    let missing = kind.outputs.iter().find(|port| port.required && outputs.get(port.name).is_none());
    missing.map_or(Ok(()), |port| Err(unusable(port.name, "it was not written")))
}
