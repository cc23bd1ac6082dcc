//! A node that makes as many bytes as it is told in as many steps and with as many resources, and keeps its state.

use std::time::Duration;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};
use heartian_graph::{Context, Inputs, Node, NodeError, NodeKind, Outputs, Port, Registry, Resources, params};

#[derive(Clone, Debug, PartialEq)]
pub struct Bytes(pub Vec<u8>);

impl Artifact for Bytes {
    const TYPE: ArtifactType = ArtifactType { name: "bytes", version: 1 };
    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        Bundle::new().tensor("bytes", &[self.0.len()], &self.0)
    }
    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Ok(Self(reader.shaped("bytes", &[None])?))
    }
}

params! {
    /// Makes bytes that depend on its inputs and its seed, and on nothing else.
    pub struct Bulk {
        /// How many.
        bytes: usize = 64;
        /// Which.
        seed: u64 = 0;
        /// Does not change the bytes, unlike what the key must suppose.
        flavour: u64 = 0;
        /// Steps on the way.
        steps: u64 = 1;
        /// Milliseconds a step.
        pause: u64 = 0, unkeyed();
        /// Fails at this step of a run that starts at the beginning.
        fails_at: u64 = u64::MAX, unkeyed();
        /// Threads it asks for.
        threads: usize = 1, unkeyed();
        /// Memory it asks for.
        memory: u64 = 0, unkeyed();
        /// Whether it asks for the GPU.
        gpu: bool = false, unkeyed();
    }
}

/// SplitMix64's mixing.
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Node for Bulk {
    const KIND: &'static str = "Bulk";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[Port::many::<Bytes>("in", "What the bytes depend on.").optional()];
    const OUTPUTS: &'static [Port] = &[Port::one::<Bytes>("out", "The bytes.")];

    fn resources(&self) -> Resources {
        Resources { threads: self.threads, memory_bytes: self.memory, gpu: self.gpu }
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let state = |bytes: Vec<u8>| Some([0, 8].map(|at| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())));
        let resumed = context.resume().and_then(state);
        let [from, mut sum] = resumed.unwrap_or([0, mix(self.seed.wrapping_add(1))]);
        for step in from..self.steps {
            for input in inputs.many::<Bytes>("in")? {
                sum = input.0.iter().fold(sum, |sum, byte| mix(sum ^ u64::from(*byte)));
            }
            sum = mix(sum.wrapping_add(step));
            std::thread::sleep(Duration::from_millis(self.pause));
            if resumed.is_none() && step == self.fails_at {
                return Err(NodeError::new("a hard place"));
            }
            context.checkpoint(|| Some([step + 1, sum].map(u64::to_le_bytes).concat()));
            if context.progress(step + 1, self.steps, Some(("started_from", from as f64))).is_break() {
                return Err(NodeError::cancelled());
            }
        }
        let bytes = (0..self.bytes.div_ceil(8) as u64).flat_map(|index| mix(sum.wrapping_add(index)).to_le_bytes());
        Ok(Outputs::new().put("out", Bytes(bytes.take(self.bytes).collect())))
    }
}

pub fn registry() -> Registry {
    Registry::of([NodeKind::of::<Bulk>()])
}

/// a → b → c → {d, e, f} → g → h → i → j, each with these parameters.
pub fn block(params: &str) -> String {
    let wires = [
        ("a", ""),
        ("b", "\"a.out\""),
        ("c", "\"b.out\""),
        ("d", "\"c.out\""),
        ("e", "\"c.out\""),
        ("f", "\"c.out\""),
        ("g", "\"d.out\", \"e.out\", \"f.out\""),
        ("h", "\"g.out\""),
        ("i", "\"h.out\""),
        ("j", "\"i.out\""),
    ];
    let nodes = wires.iter().enumerate().map(|(seed, (id, from))| {
        format!("\"{id}\": (kind: \"Bulk\", params: (seed: {seed}, {params}), inputs: {{\"in\": [{from}]}}),\n")
    });
    format!("Graph(name: \"block\", nodes: {{\n{}}})", nodes.collect::<String>())
}
