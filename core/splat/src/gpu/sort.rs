//! Recording a radix sort: three dispatches a digit of eight bits.

use super::device::Gpu;
use super::params::SortPass;
use super::program::{Call, Groups, Recording, Source};

/// Pairs to sort: keys and values, each with a second buffer to go to and fro.
pub(crate) struct Pairs<'a> {
    pub keys: [&'a wgpu::Buffer; 2],
    pub values: [&'a wgpu::Buffer; 2],
    pub totals: &'a wgpu::Buffer,
    pub table: &'a wgpu::Buffer,
    pub digits: &'a wgpu::Buffer,
}

/// Adds a stable sort by the digits of `passes` (a buffer of [`SortPass`] each); gives in which of the two buffers the
/// pairs end. `blocks` is the dispatch over blocks of pairs.
pub(crate) fn record(
    recording: &mut Recording,
    gpu: &Gpu,
    pairs: &Pairs<'_>,
    passes: &[wgpu::Buffer],
    blocks: Groups,
) -> usize {
    for (index, pass) in passes.iter().enumerate() {
        let (from, to) = (index % 2, (index + 1) % 2);
        let (table, digits) = ((4, pairs.table), (5, pairs.digits));
        let (constants, totals, keys) = ((0, pass), (1, pairs.totals), (2, pairs.keys[from]));
        let mut add = |entry, bindings: &[(u32, &wgpu::Buffer)], groups| {
            recording.add(gpu, 1, &Call { source: Source::Sort, entry, bindings, groups });
        };
        add("tally", &[constants, totals, keys, table], blocks);
        add("offsets", &[constants, totals, table, digits], Groups::Linear(256));
        let (values, out) = ((3, pairs.values[from]), [(6, pairs.keys[to]), (7, pairs.values[to])]);
        add("scatter", &[constants, totals, keys, values, table, digits, out[0], out[1]], blocks);
    }
    passes.len() % 2
}

/// Bits of the digits that tell `keys` apart from below.
pub(crate) fn passes_for(keys: usize) -> u32 {
    (usize::BITS - keys.saturating_sub(1).leading_zeros()).div_ceil(8).max(1)
}

/// The constants of each pass over `bits`·8 bits of the keys counted in `word` of the totals.
pub(crate) fn constants(passes: u32, word: u32, stride: u32, indexed: bool) -> Vec<SortPass> {
    (0..passes)
        .map(|pass| SortPass { shift: 8 * pass, word, stride, indexed: u32::from(indexed && pass == 0) })
        .collect()
}
