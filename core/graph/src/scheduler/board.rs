//! Where each node of a run stands, and which are ready. Plain bookkeeping: runs nothing, waits for nothing.
//!
//! Always holds: a node is ready when all that feeds it is settled well; `pending` counts the wires of a node whose
//! producers are not, `readers` the wires of an output whose consumers are not settled at all. Nothing recurses.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use crate::context::Status;
use crate::digest::Digest;
use crate::plan::Plan;

use super::NodeReport;

/// How far a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// For its inputs, or in the queue.
    Waiting,
    Running,
    Settled,
}

pub(super) struct Board<'p> {
    plan: &'p Plan,
    /// By node, who reads it: one entry a wire.
    consumers: Vec<Vec<usize>>,
    phase: Vec<Phase>,
    pending: Vec<u32>,
    /// Unsettled readers by node and output port.
    readers: HashMap<(usize, &'static str), u32>,
    /// A running node whose inputs were made anew meanwhile.
    recheck: Vec<bool>,
    ready: BinaryHeap<Reverse<usize>>,
    turns: Vec<Option<NodeReport>>,
}

impl<'p> Board<'p> {
    pub fn new(plan: &'p Plan) -> Self {
        let count = plan.nodes.len();
        let mut board = Self {
            plan,
            consumers: vec![Vec::new(); count],
            phase: vec![Phase::Waiting; count],
            pending: vec![0; count],
            readers: HashMap::new(),
            recheck: vec![false; count],
            ready: BinaryHeap::new(),
            turns: vec![None; count],
        };
        for at in 0..count {
            for (from, port) in wires(plan, at) {
                board.consumers[from].push(at);
                board.pending[at] += 1;
                *board.readers.entry((from, port)).or_default() += 1;
            }
            if board.pending[at] == 0 {
                board.ready.push(Reverse(at));
            }
        }
        board
    }

    /// The next node whose inputs are all there, in the order of the plan.
    pub fn next_ready(&mut self) -> Option<usize> {
        while let Some(Reverse(at)) = self.ready.pop() {
            let failed = self.phase[at] == Phase::Settled && !self.is_done(at);
            if self.pending[at] == 0 && self.phase[at] != Phase::Running && !failed {
                return Some(at);
            }
        }
        None
    }

    /// The node's turn begins, perhaps another one because its inputs are not what they were.
    pub fn begin(&mut self, at: usize) {
        if self.is_done(at) {
            self.unsettle(at);
        }
    }

    /// The node works now.
    pub fn start(&mut self, at: usize) {
        self.phase[at] = Phase::Running;
        self.recheck[at] = false;
    }

    /// Whether the node's turn went well with this very key before.
    pub fn is_settled_with(&self, at: usize, key: &Digest) -> bool {
        self.is_done(at) && self.turns[at].as_ref().and_then(|turn| turn.key) == Some(*key)
    }

    pub fn is_done(&self, at: usize) -> bool {
        let well = |turn: &NodeReport| matches!(turn.status, Status::Hit | Status::Ran);
        self.phase[at] == Phase::Settled && self.turns[at].as_ref().is_some_and(well)
    }

    pub fn digest(&self, at: usize, port: &str) -> Option<Digest> {
        self.turns[at].as_ref()?.outputs.get(port).copied()
    }

    /// How many wires from this output end at nodes that are not settled.
    pub fn readers(&self, at: usize, port: &'static str) -> u32 {
        self.readers.get(&(at, port)).copied().unwrap_or(0)
    }

    /// The node's turn is over. Consumers become ready; gives the outputs that nobody waits for any more.
    pub fn settle(&mut self, at: usize, report: NodeReport) -> Vec<(usize, &'static str)> {
        let well = matches!(report.status, Status::Hit | Status::Ran);
        self.turns[at] = Some(report);
        self.phase[at] = Phase::Settled;
        let mut released = Vec::new();
        for wire in wires(self.plan, at) {
            if let Some(count) = self.readers.get_mut(&wire) {
                *count = count.saturating_sub(1);
                if *count == 0 {
                    released.push(wire);
                }
            }
        }
        if well {
            for index in 0..self.consumers[at].len() {
                let consumer = self.consumers[at][index];
                self.pending[consumer] = self.pending[consumer].saturating_sub(1);
                if self.pending[consumer] == 0 {
                    self.recheck[consumer] |= self.phase[consumer] == Phase::Running;
                    self.ready.push(Reverse(consumer));
                }
            }
        }
        if std::mem::take(&mut self.recheck[at]) {
            self.ready.push(Reverse(at));
        }
        released
    }

    /// A running node could not use what `producer` made, which is lost: that takes another turn, unless it did so
    /// meanwhile, and the node waits for it. Says whether the producer has to work again.
    pub fn put_back(&mut self, at: usize, producer: usize) -> bool {
        let lost = !std::mem::take(&mut self.recheck[at]) && self.is_done(producer);
        self.wait(at);
        if lost {
            self.unsettle(producer);
            self.turns[producer] = None;
            self.wait(producer);
        }
        lost
    }

    /// The node has no turn now; when its inputs are there it gets one.
    pub fn wait(&mut self, at: usize) {
        self.phase[at] = Phase::Waiting;
        if self.pending[at] == 0 {
            self.ready.push(Reverse(at));
        }
    }

    fn unsettle(&mut self, at: usize) {
        self.phase[at] = Phase::Waiting;
        for wire in wires(self.plan, at) {
            *self.readers.entry(wire).or_default() += 1;
        }
        for consumer in &self.consumers[at] {
            self.pending[*consumer] += 1;
        }
    }

    /// All reports, in the order of the plan; who had no turn is skipped.
    pub fn finish(self) -> Vec<NodeReport> {
        let skipped = |(at, turn): (usize, Option<NodeReport>)| turn.unwrap_or_else(|| NodeReport::of(self.plan, at));
        self.turns.into_iter().enumerate().map(skipped).collect()
    }
}

/// What feeds a node, one entry a wire.
fn wires(plan: &Plan, at: usize) -> impl Iterator<Item = (usize, &'static str)> {
    let inputs = plan.nodes[at].inputs.iter();
    inputs.flat_map(|input| input.from.iter().map(|(from, port)| (*from, port.name)))
}
