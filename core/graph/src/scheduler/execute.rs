//! One node's work: run it guarded, check what it made, store it.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use crate::artifacts::Outputs;
use crate::cache::Record;
use crate::context::{Context, Event, Observer, Status};
use crate::digest::Digest;
use crate::node::NodeError;
use crate::registry::NodeKind;

use super::{Outcome, Run, RunOptions, State};

impl Run<'_> {
    /// Runs the node and stores what it made.
    pub(super) fn run(
        &self,
        at: usize,
        (key, preimage): (Digest, String),
        state: &mut State,
        options: &RunOptions,
    ) -> Result<Outcome, NodeError> {
        let node = &self.plan.nodes[at];
        let inputs = match self.inputs(at, state)? {
            Ok(inputs) => inputs,
            Err(producer) => return Ok(Outcome::Damaged { producer }),
        };
        options.observer.event(&Event::Started { node: &node.id, kind: node.kind.kind });
        let start = Instant::now();
        let recorder = Arc::new(Recorder { inner: options.observer.clone(), warnings: Mutex::default() });
        let context = Context::new(&node.id, self.plan.seed, options.cancel.clone(), recorder.clone());
        let outputs = catch_unwind(AssertUnwindSafe(|| node.node.run(&inputs, &context)))
            .unwrap_or_else(|payload| Err(panicked(&*payload)))?;
        drop(inputs);
        check(&node.kind, &outputs)?;
        let mut stored = BTreeMap::new();
        for (port, artifact) in outputs.iter() {
            let bytes = artifact.to_bytes().map_err(|error| unusable(port, &error.to_string()))?;
            stored.insert(port.to_owned(), self.cache.put_bytes(&bytes)?);
            state.held[at].insert(port, artifact.clone());
        }
        let warnings = std::mem::take(&mut *recorder.warnings.lock().unwrap_or_else(PoisonError::into_inner));
        let record = Record { outputs: stored, warnings, seconds: start.elapsed().as_secs_f64(), preimage };
        self.cache.put_record(&key, &record)?;
        Ok(Outcome::Finished { status: Status::Ran, record })
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

fn panicked(payload: &(dyn Any + Send)) -> NodeError {
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
