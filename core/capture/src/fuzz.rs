//! Seeded damage to whole files, for the tests of every reader: the suite runs a moment of it, and
//! `HEARTIAN_FUZZ_SECONDS=300 cargo test -p heartian-capture --lib fuzz -- --nocapture` as long as one likes.

use std::time::{Duration, Instant};

/// Values that lie at the edges of what readers expect.
const EDGES: [u32; 10] = [0, 1, 2, 0x7f, 0x80, 0xffff, 0x0100_0000, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff];

/// A stream of damage.
pub(crate) struct Damage(u64);

impl Damage {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// Some number below `limit`; 0 when that is 0.
    pub fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as usize % limit.max(1)
    }

    /// A few changes to a whole file: bits, words of edge values, cuts, doubled and swapped stretches.
    pub fn to(&mut self, whole: &[u8]) -> Vec<u8> {
        let mut out = whole.to_vec();
        for _ in 0..=self.below(6) {
            let at = self.below(out.len());
            match self.below(8) {
                0 | 1 if !out.is_empty() => out[at] ^= 1 << self.below(8),
                2 if !out.is_empty() => out[at] = self.below(256) as u8,
                3 | 4 if out.len() >= at + 4 => {
                    let edge = EDGES[self.below(EDGES.len())];
                    let bytes = if self.below(2) == 0 { edge.to_le_bytes() } else { edge.to_be_bytes() };
                    out[at..at + 4].copy_from_slice(&bytes);
                }
                5 if self.below(4) == 0 => out.truncate(at),
                6 => {
                    let stretch = out[at..(at + self.below(64)).min(out.len())].to_vec();
                    let to = self.below(out.len());
                    out.splice(to..to, stretch);
                }
                _ => {
                    let end = (at + self.below(16)).min(out.len());
                    out.drain(at..end);
                }
            }
        }
        out
    }
}

/// Damages one of `files` again and again and hands it over: `short` times, or as long as the environment says.
pub(crate) fn rounds(name: &str, short: u64, files: &[Vec<u8>], mut read: impl FnMut(&[u8])) {
    let seconds = std::env::var("HEARTIAN_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    let end = seconds.map(|seconds| Instant::now() + Duration::from_secs(seconds));
    let mut count = 0;
    while end.map_or(count < short, |end| Instant::now() < end) {
        let mut damage = Damage::new(count + 1);
        let file = &files[damage.below(files.len())];
        read(&damage.to(file));
        count += 1;
    }
    if seconds.is_some() {
        println!("{name}: {count} damaged files");
    }
}
