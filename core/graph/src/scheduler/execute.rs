//! The run itself: one thread decides, others work.
//!
//! The deciding thread alone looks keys up and knows where each node stands. Threads that work are started when there is
//! work for them, so that a run of hits starts none.

use std::collections::{BTreeMap, HashMap};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::Scope;
use std::time::Instant;

use crate::cache::{Ledger, Record};
use crate::context::{Event, Status};
use crate::digest::Digest;
use crate::node::{NodeError, Resources};

use super::board::Board;
use super::work::{Feed, Job, Outcome, Slot, panicked};
use super::{NodeReport, Run, RunOptions};

/// How often one node is recomputed because what the cache holds of it is damaged, before the cache itself is blamed.
const HEAL_LIMIT: u32 = 3;
/// Nodes may lean on deep call stacks as a main thread allows; unused pages cost nothing.
const STACK_BYTES: usize = 8 << 20;

/// A job done, or given up.
struct Done {
    at: usize,
    outcome: Result<Outcome, NodeError>,
    seconds: f64,
}

impl Run<'_> {
    /// Runs the plan. Never stops for a node's failure without a word about every node.
    pub fn execute(&self, options: &RunOptions) -> Vec<NodeReport> {
        let (jobs, queue) = channel();
        let (done, results) = channel();
        let queue = Mutex::new(queue);
        std::thread::scope(|scope| {
            let crew = Crew { scope, run: self, options, queue: &queue, jobs, done, size: 0 };
            Foreman::new(self, options, crew).manage(&results)
        })
    }
}

/// The threads that work.
struct Crew<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    run: &'env Run<'env>,
    options: &'env RunOptions,
    queue: &'env Mutex<Receiver<Job>>,
    jobs: Sender<Job>,
    done: Sender<Done>,
    size: usize,
}

impl Crew<'_, '_> {
    /// Gives a job to a thread that is free; `running` of them are not.
    fn send(&mut self, job: Job, running: usize) {
        if running >= self.size {
            let (run, options, queue, done) = (self.run, self.options, self.queue, self.done.clone());
            let work = move || {
                loop {
                    let job = queue.lock().unwrap_or_else(PoisonError::into_inner).recv();
                    let Ok(job) = job else { break };
                    let (at, start) = (job.at, Instant::now());
                    let outcome = catch_unwind(AssertUnwindSafe(|| run.work(job, options)))
                        .unwrap_or_else(|payload| Err(panicked(&*payload)));
                    if done.send(Done { at, outcome, seconds: start.elapsed().as_secs_f64() }).is_err() {
                        break;
                    }
                }
            };
            let started = std::thread::Builder::new().stack_size(STACK_BYTES).spawn_scoped(self.scope, work);
            if let Err(error) = started
                && self.size == 0
            {
                let error = NodeError::new(format!("no thread can be started: {error}"));
                let _ = self.done.send(Done { at: job.at, outcome: Err(error), seconds: 0.0 });
                return;
            }
            self.size += 1;
        }
        // The receiver lives as long as the run.
        let _ = self.jobs.send(job);
    }
}

/// Who decides.
struct Foreman<'r, 'scope, 'env> {
    run: &'r Run<'r>,
    options: &'r RunOptions,
    board: Board<'r>,
    crew: Crew<'scope, 'env>,
    /// What has to run and waits for resources, in the order of the plan.
    waiting: BTreeMap<usize, (Digest, String)>,
    /// What runs, and what it was granted.
    running: HashMap<usize, (Digest, Resources)>,
    /// Keys of what waits or runs, and the nodes that wait for the end of another one with the same key.
    twins: HashMap<Digest, Vec<usize>>,
    /// Values in memory by node and port, until their last reader is settled.
    held: HashMap<(usize, &'static str), Slot>,
    /// How often a node was recomputed because of damage.
    heals: HashMap<usize, u32>,
    ledger: Option<Ledger>,
    stopped: bool,
}

impl<'r, 'scope, 'env> Foreman<'r, 'scope, 'env> {
    fn new(run: &'r Run<'r>, options: &'r RunOptions, crew: Crew<'scope, 'env>) -> Self {
        Self {
            run,
            options,
            board: Board::new(run.plan),
            crew,
            waiting: BTreeMap::new(),
            running: HashMap::new(),
            twins: HashMap::new(),
            held: HashMap::new(),
            heals: HashMap::new(),
            ledger: run.cache.ledger(&run.fingerprint()),
            stopped: false,
        }
    }

    fn manage(mut self, results: &Receiver<Done>) -> Vec<NodeReport> {
        loop {
            self.stopped |= self.options.cancel.requested();
            while !self.stopped
                && let Some(at) = self.board.next_ready()
            {
                self.consider(at);
                self.stopped |= self.options.cancel.requested();
            }
            if !self.stopped {
                self.dispatch();
            }
            if self.running.is_empty() {
                break;
            }
            let Ok(done) = results.recv() else { break };
            self.finish(done);
        }
        self.ledger.into_iter().for_each(Ledger::finish);
        let reports = self.board.finish();
        for report in reports.iter().filter(|report| report.status == Status::Skipped) {
            let event = Event::Finished { node: &report.id, status: Status::Skipped, seconds: 0.0 };
            self.options.observer.event(&event);
        }
        reports
    }

    /// A node whose inputs are all there: a hit is settled, anything else waits for resources.
    fn consider(&mut self, at: usize) {
        let start = Instant::now();
        let (key, preimage) = match self.run.key(at, &|from, port| self.board.digest(from, port)) {
            Ok(found) => found,
            Err(error) => return self.settle(at, None, Err(error), 0.0),
        };
        if self.board.is_settled_with(at, &key) {
            return;
        }
        self.board.begin(at);
        if let Some(record) = self.run.cache.record(&key) {
            let seconds = start.elapsed().as_secs_f64();
            self.settle(at, Some(key), Ok((Status::Hit, record)), seconds);
        } else if let Some(twins) = self.twins.get_mut(&key) {
            twins.push(at);
        } else {
            self.twins.insert(key, Vec::new());
            self.waiting.insert(at, (key, preimage));
        }
    }

    /// Starts what fits beside what runs, in the order of the plan; what does not fit may be overtaken.
    fn dispatch(&mut self) {
        let granted = |running: &HashMap<usize, (Digest, Resources)>| -> usize {
            running.values().map(|(_, granted)| granted.threads).sum()
        };
        while granted(&self.running) < self.options.jobs.max(1)
            && let Some(at) = self.waiting.keys().copied().find(|at| self.fits(&self.needs(*at)))
            && let Some((key, preimage)) = self.waiting.remove(&at)
        {
            let needs = self.needs(at);
            let job = Job { at, key, preimage, feeds: self.feeds(at), threads: needs.threads };
            // Before anything long starts, so that a collection of garbage beside this run knows what it uses.
            self.ledger.iter_mut().for_each(Ledger::publish);
            self.board.start(at);
            self.crew.send(job, self.running.len());
            self.running.insert(at, (key, needs));
        }
    }

    /// What a node asks for, no more than there is.
    fn needs(&self, at: usize) -> Resources {
        let asked = self.run.plan.nodes[at].node.resources();
        Resources {
            threads: asked.threads.clamp(1, self.options.jobs.max(1)),
            memory_bytes: asked.memory_bytes.min(self.options.memory_bytes),
            gpu: asked.gpu,
        }
    }

    fn fits(&self, needs: &Resources) -> bool {
        let granted = || self.running.values().map(|(_, granted)| granted);
        let threads: usize = granted().map(|granted| granted.threads).sum();
        let memory = granted().fold(0u64, |sum, granted| sum.saturating_add(granted.memory_bytes));
        threads + needs.threads <= self.options.jobs.max(1)
            && memory.saturating_add(needs.memory_bytes) <= self.options.memory_bytes
            && !(needs.gpu && granted().any(|granted| granted.gpu))
    }

    /// Where a node's inputs come from.
    fn feeds(&mut self, at: usize) -> Vec<Feed> {
        let mut feeds = Vec::new();
        for input in &self.run.plan.nodes[at].inputs {
            for (from, port) in &input.from {
                let Some(digest) = self.board.digest(*from, port.name) else { continue };
                let slot = self.held.entry((*from, port.name)).or_default().clone();
                feeds.push(Feed { port: input.port.name, from: *from, output: port, digest, slot });
            }
        }
        feeds
    }

    /// A job came back.
    fn finish(&mut self, done: Done) {
        let Done { at, outcome, seconds } = done;
        let Some((key, _)) = self.running.remove(&at) else { return };
        match outcome {
            Ok(Outcome::Damaged { producer, reason }) => self.heal(at, producer, (key, reason)),
            Ok(Outcome::Finished { status, record, values }) => {
                for (port, value) in values {
                    if self.board.readers(at, port) > 0 {
                        self.held.insert((at, port), Arc::new(Mutex::new(Some(value))));
                    }
                }
                self.settle(at, Some(key), Ok((status, record)), seconds);
            }
            Err(error) => {
                let error = if self.options.cancel.requested() { NodeError::cancelled() } else { error };
                self.settle(at, Some(key), Err(error), seconds);
            }
        }
        for twin in self.twins.remove(&key).unwrap_or_default() {
            self.board.wait(twin);
        }
    }

    /// What `producer` made cannot be used: it is made again, unless that has not helped before.
    fn heal(&mut self, at: usize, producer: usize, (key, reason): (Digest, String)) {
        let heals = self.heals.entry(producer).or_default();
        if *heals >= HEAL_LIMIT {
            let id = &self.run.plan.nodes[producer].id;
            let error = NodeError::new(format!("what the cache keeps of node `{id}` cannot be used: {reason}"));
            let error = error.remedy("choose another cache folder with --cache DIR");
            return self.settle(at, Some(key), Err(error), 0.0);
        }
        if self.board.put_back(at, producer) {
            *heals += 1;
            for port in self.run.plan.nodes[producer].kind.outputs {
                self.held.remove(&(producer, port.name));
            }
        }
    }

    /// A node's turn is over.
    fn settle(&mut self, at: usize, key: Option<Digest>, outcome: Result<(Status, Record), NodeError>, seconds: f64) {
        let node = &self.run.plan.nodes[at];
        let mut report = NodeReport { key, seconds, ..NodeReport::of(self.run.plan, at) };
        match outcome {
            Ok((status, record)) => {
                (report.status, report.work_seconds) = (status, record.seconds);
                for text in record.warnings.iter().filter(|_| status == Status::Hit) {
                    self.options.observer.event(&Event::Warning { node: &node.id, text });
                }
                let digest = |port: &'static str| record.outputs.get(port).map(|output| (port, output.digest));
                report.outputs = node.kind.outputs.iter().filter_map(|port| digest(port.name)).collect();
                if let (Some(ledger), Some(key)) = (&mut self.ledger, &key) {
                    ledger.note(key);
                }
            }
            Err(error) => {
                (report.status, report.error) = (Status::Failed, Some(error));
                self.stopped |= !self.options.keep_going;
            }
        }
        let status = report.status;
        self.options.observer.event(&Event::Finished { node: &node.id, status, seconds });
        for released in self.board.settle(at, report) {
            self.held.remove(&released);
        }
    }
}
