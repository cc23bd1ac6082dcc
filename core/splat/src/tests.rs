//! Tests of the whole crate: parity of fast and naive texts, finite differences, poison, determinism, the peers' scenes.

mod gradients;
mod levels;
mod lights;
mod losses;
mod peers;
mod poison;
pub(crate) mod scenes;
