//! States of unfinished nodes, by action key: digest of the state, then the state.

use crate::digest::Digest;

use super::{Cache, CacheError};

/// Bytes of the digest in front.
const HEAD: usize = 32;

impl Cache {
    fn checkpoint_path(&self, key: &Digest) -> std::path::PathBuf {
        self.sharded("checkpoints", key, "state")
    }

    /// Keeps a state; it replaces the last one of the key as a whole.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub(crate) fn put_checkpoint(&self, key: &Digest, state: &[u8]) -> Result<(), CacheError> {
        self.write(&self.checkpoint_path(key), &[Digest::of(state).as_bytes(), state])
    }

    /// The last state kept for a key; a damaged one is none.
    pub(crate) fn checkpoint(&self, key: &Digest) -> Option<Vec<u8>> {
        let mut bytes = std::fs::read(self.checkpoint_path(key)).ok()?;
        let head: [u8; HEAD] = bytes.get(..HEAD)?.try_into().ok()?;
        bytes.drain(..HEAD);
        (Digest::of(&bytes) == Digest::from(head)).then_some(bytes)
    }

    /// Forgets the state of a finished node.
    pub(crate) fn drop_checkpoint(&self, key: &Digest) {
        let _ = std::fs::remove_file(self.checkpoint_path(key));
    }
}
