//! What a running node may ask of its host, and what the host tells its observer.
//!
//! Nothing here may change what a node computes, except `seed`, which is in the cache key.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::cache::Cache;
use crate::digest::Digest;

/// One report of a long computation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Steps done.
    pub step: u64,
    /// Steps in all; 0 when unknown.
    pub total: u64,
    /// Name and value of a live figure (`psnr_db`).
    pub metric: Option<(&'static str, f64)>,
}

/// How a node's turn ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// The outputs were already in the cache.
    Hit,
    /// It ran.
    Ran,
    /// It ran and failed.
    Failed,
    /// Something it needs failed, or the run stopped before its turn.
    Skipped,
}

impl Status {
    /// The word in `metrics.json`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Hit => "hit",
            Self::Ran => "ran",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
        }
    }
}

/// What happens during a run.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// A node starts.
    Started {
        /// Its id in the graph.
        node: &'a str,
        /// Its kind.
        kind: &'a str,
    },
    /// Another run is at work on the very same node; this one waits for it.
    Waiting {
        /// Its id in the graph.
        node: &'a str,
        /// Its kind.
        kind: &'a str,
    },
    /// A running node reports.
    Progress {
        /// Its id in the graph.
        node: &'a str,
        /// How far it is.
        progress: Progress,
    },
    /// A running node, or the host on its behalf, has something to say.
    Warning {
        /// Its id in the graph.
        node: &'a str,
        /// One line.
        text: &'a str,
    },
    /// A node's turn is over.
    Finished {
        /// Its id in the graph.
        node: &'a str,
        /// How.
        status: Status,
        /// How long it took.
        seconds: f64,
    },
}

/// Hears of a run's events; called from the threads of the nodes, several at once.
pub trait Observer: Send + Sync {
    /// Something happened.
    fn event(&self, event: &Event<'_>);
}

impl Observer for () {
    fn event(&self, _: &Event<'_>) {}
}

/// A request to stop, shared between who asks and who works.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Asks to stop.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether someone asked.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Where a node's states are kept while it runs.
#[derive(Debug)]
pub(crate) struct Checkpoints {
    cache: Cache,
    key: Digest,
    every: Duration,
    last: Mutex<Instant>,
}

impl Checkpoints {
    /// States of the node with this key, kept no more often than `every`.
    pub fn new(cache: &Cache, key: Digest, every: Duration) -> Self {
        Self { cache: cache.clone(), key, every, last: Mutex::new(Instant::now()) }
    }
}

/// A running node's view of its host.
#[derive(Clone)]
pub struct Context {
    node: Arc<str>,
    seed: u64,
    threads: usize,
    cancel: Cancel,
    observer: Arc<dyn Observer>,
    checkpoints: Option<Arc<Checkpoints>>,
}

impl Context {
    /// A context for the node `node`, one thread of its own, without checkpoints.
    pub fn new(node: &str, seed: u64, cancel: Cancel, observer: Arc<dyn Observer>) -> Self {
        Self { node: node.into(), seed, threads: 1, cancel, observer, checkpoints: None }
    }

    /// With this many threads of its own.
    pub(crate) fn with_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// With a place to keep states.
    pub(crate) fn with_checkpoints(self, checkpoints: Checkpoints) -> Self {
        Self { checkpoints: Some(Arc::new(checkpoints)), ..self }
    }

    /// A context that nobody watches, for tests and examples.
    pub fn silent() -> Self {
        Self::new("node", 0, Cancel::default(), Arc::new(()))
    }

    /// The graph's seed. It is in the cache key.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// How many threads of its own the node may keep busy: those it asked for in [`crate::Node::resources`], or fewer.
    /// Must not change what it computes.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Reports `step` of `total` (0: unknown) and perhaps a live figure. `Break` means the user asked to stop: return
    /// [`crate::NodeError::cancelled`] or any error soon.
    pub fn progress(&self, step: u64, total: u64, metric: Option<(&'static str, f64)>) -> ControlFlow<()> {
        self.observer.event(&Event::Progress { node: &self.node, progress: Progress { step, total, metric } });
        if self.cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// The request to stop, for who must wait for something else meanwhile.
    pub(crate) fn canceller(&self) -> Cancel {
        self.cancel.clone()
    }

    /// Whether the user asked to stop.
    pub fn cancelled(&self) -> bool {
        self.cancel.requested()
    }

    /// The last state that an earlier run of this very node kept (same kind, revision, parameters, inputs and seed)
    /// before it was stopped or killed. Whoever goes on from it must give the bytes of an uninterrupted run. A state that
    /// does not fit, for whatever reason, is to be ignored.
    pub fn resume(&self) -> Option<Vec<u8>> {
        let kept = self.checkpoints.as_ref()?;
        kept.cache.checkpoint(&kept.key)
    }

    /// Offers a state to resume from; it is made and kept only when some seconds have passed since the last one, or when
    /// the user asked to stop. Call it after each step, and once more before returning because of a request to stop.
    /// What cannot be kept is not: the node goes on.
    pub fn checkpoint(&self, state: impl FnOnce() -> Option<Vec<u8>>) {
        let Some(kept) = &self.checkpoints else { return };
        let mut last = kept.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.elapsed() < kept.every && !self.cancelled() {
            return;
        }
        if let Some(Err(error)) = state().map(|state| kept.cache.put_checkpoint(&kept.key, &state)) {
            self.warn(&format!("its state is not kept, and an interrupted run starts over: {error}"));
        }
        *last = Instant::now();
    }

    /// Tells the user one line, such as a doubtful input that is used all the same.
    pub fn warn(&self, text: &str) {
        self.observer.event(&Event::Warning { node: &self.node, text });
    }
}
