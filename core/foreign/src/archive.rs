//! Zip archives, a member at a time and no further than the caller allows: a compressed bomb unfolds to nothing.

use std::io::{Read, Seek};

use zip::ZipArchive;

use crate::ForeignError;

/// Longest member name told in an error.
const SHOWN: usize = 80;

/// A zip archive over any seekable source.
pub struct Archive<R>(ZipArchive<R>);

impl<R: Read + Seek> Archive<R> {
    /// Reads the directory.
    ///
    /// # Errors
    /// When it is damaged or the source is no zip archive.
    pub fn open(source: R) -> Result<Self, ForeignError> {
        let zip = ZipArchive::new(source);
        zip.map(Self).map_err(|error| ForeignError::damaged(format!("its zip directory is damaged ({error})")))
    }

    /// Names of all members, in no order to rely on.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.file_names()
    }

    /// Whether there is a member of this name.
    pub fn contains(&self, name: &str) -> bool {
        self.0.index_for_name(name).is_some()
    }

    /// A member's bytes, unpacked.
    ///
    /// # Errors
    /// When there is none of this name, it is damaged, or it holds more than `most` bytes (found by unpacking, not by
    /// what the directory claims).
    pub fn member(&mut self, name: &str, most: u64) -> Result<Vec<u8>, ForeignError> {
        let shown: String = name.chars().take(SHOWN).collect::<String>().escape_debug().collect();
        let fail = |error: String| ForeignError::damaged(format!("its member `{shown}` cannot be read ({error})"));
        let file = self.0.by_name(name).map_err(|error| fail(error.to_string()))?;
        let mut bytes = Vec::new();
        file.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(|error| fail(error.to_string()))?;
        if bytes.len() as u64 > most {
            return Err(ForeignError::too_large(format!("its member `{shown}` is longer than {most} bytes")));
        }
        Ok(bytes)
    }
}
