//! `plugins.lock`: the libraries whose nodes may run inside the program, by digest.
//!
//! A library that is not in it runs in a child process. That guards against mistakes, not against malice: a plugin is a
//! program and can do what its user can.

use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::digest::Digest;

/// A trusted library.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrustedPlugin {
    /// The name it gives itself, for people.
    pub name: String,
    /// The version it gives itself, for people.
    pub version: String,
    /// Digest of the file: what counts.
    pub digest: Digest,
}

/// The file's content.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PluginLock {
    /// Trusted libraries, by name and version.
    pub trusted: Vec<TrustedPlugin>,
}

impl PluginLock {
    /// Reads a lock; one that is not there trusts nobody.
    ///
    /// # Errors
    /// When it cannot be read or is damaged.
    pub fn read(path: &Path) -> Result<Self, String> {
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(error) => return Err(format!("`{}` cannot be read: {error}", path.display())),
        };
        serde_json::from_slice(&bytes).map_err(|error| format!("`{}` is damaged: {error}", path.display()))
    }

    /// Whether a library is trusted.
    pub fn trusts(&self, digest: &Digest) -> bool {
        self.trusted.iter().any(|plugin| plugin.digest == *digest)
    }

    /// Adds a library.
    pub fn add(&mut self, plugin: TrustedPlugin) {
        self.trusted.retain(|known| known.digest != plugin.digest);
        self.trusted.push(plugin);
        self.trusted.sort_by(|a, b| (&a.name, &a.version).cmp(&(&b.name, &b.version)));
    }

    /// Writes the lock, whole or not at all.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        writeln!(file, "{}", serde_json::to_string_pretty(self)?)?;
        file.persist(path)?;
        Ok(())
    }
}
