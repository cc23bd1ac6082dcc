//! A plugin with one node that writes pseudo-random bytes and does next to nothing else: what a run of such nodes costs
//! is the cost of the engine. The bytes depend on the parameters and on every byte of the inputs.

use heartian_plugin::{Call, Error, Inputs, Node, Outputs, Port, export, params};

params! {
    /// Writes pseudo-random bytes that depend on its parameters and inputs.
    pub struct Blob {
        /// How many bytes.
        bytes: u64 = 1_048_576, unit("B"), range(0.0, 1e10);
        /// Other seeds give other bytes.
        seed: u64 = 1;
    }
}

impl Node for Blob {
    const KIND: &'static str = "Blob";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[Port::many("in", "org.heartian.blob/1", "Bytes to depend on.").optional()];
    const OUTPUTS: &'static [Port] = &[Port::one("out", "org.heartian.blob/1", "The bytes.")];

    fn run(&self, inputs: &Inputs<'_>, _: &Call) -> Result<Outputs, Error> {
        let state = inputs.many("in").fold(mixed(self.seed), |state, input| absorb(state, input.bytes));
        Ok(Outputs::new().put("out", squeeze(state, usize::try_from(self.bytes)?)))
    }
}

export!(Blob);

/// A word whose bits all depend on all of the bits given (the finaliser of SplitMix64).
fn mixed(word: u64) -> u64 {
    let word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ (word >> 31)
}

/// The state after reading these bytes: four chains side by side, so that it runs at the speed of memory.
fn absorb(state: u64, bytes: &[u8]) -> u64 {
    let mut chains = [0, 1, 2, 3].map(|lane: u64| state ^ lane);
    let (blocks, rest) = bytes.as_chunks::<32>();
    for block in blocks {
        for (chain, word) in chains.iter_mut().zip(block.as_chunks::<8>().0) {
            *chain = (*chain ^ u64::from_le_bytes(*word)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
        }
    }
    let rest = rest.iter().fold(bytes.len() as u64, |word, byte| mixed(word ^ u64::from(*byte)));
    chains.iter().fold(rest, |word, chain| mixed(word ^ chain))
}

/// That many bytes: SplitMix64, a counter mixed.
fn squeeze(state: u64, count: usize) -> Vec<u8> {
    let mut bytes = vec![0; count.next_multiple_of(8)];
    let mut counter = state;
    for word in bytes.as_chunks_mut::<8>().0 {
        counter = counter.wrapping_add(0x9e37_79b9_7f4a_7c15);
        *word = mixed(counter).to_le_bytes();
    }
    bytes.truncate(count);
    bytes
}
