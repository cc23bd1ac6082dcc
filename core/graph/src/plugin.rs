//! Plugins: shared libraries that bring kinds of nodes at run time.
//!
//! Always holds: a library is first loaded in a child process, so that one that crashes, hangs or talks rubbish is
//! reported and no more; its nodes run in child processes too, unless its digest is trusted; its digest is in every cache
//! key of its nodes; what a fully cached run needs to know of it is remembered. The ABI is `plugins/abi`.

mod converse;
mod description;
mod frame;
#[cfg(test)]
mod fuzz;
mod memory;
mod native;
mod node;
mod process;
mod search;
mod serve;
mod trust;
mod values;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};
use std::time::Duration;

use serde_json::Value;

use crate::digest::Digest;
use crate::registry::{Make, NodeKind, Registry};

use description::{Description, KindParts, leak};
use frame::Trouble;
use native::Native;
use node::LoadedKind;
use process::{Loaded, Worker};

pub use search::plugin_files;
pub use serve::serve_plugin;
pub use trust::{PluginLock, TrustedPlugin};

/// How to start a process that calls [`serve_plugin`]: the library's path, its digest and the memory limit in bytes are
/// added as three arguments.
#[derive(Clone, Debug)]
pub struct HostCommand {
    /// The program, usually this one.
    pub program: PathBuf,
    /// Its first arguments.
    pub arguments: Vec<OsString>,
}

/// What a plugin's process may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PluginLimits {
    /// Address space of a process, bytes; 0: any.
    pub memory_bytes: u64,
    /// How long a running node may give no sign of life: progress, a warning, an output.
    pub silence: Duration,
}

impl Default for PluginLimits {
    fn default() -> Self {
        Self { memory_bytes: 16 << 30, silence: Duration::from_secs(600) }
    }
}

/// Loads libraries.
#[derive(Clone, Debug)]
pub struct Plugins {
    /// How to start a process for a library.
    pub host: HostCommand,
    /// What such a process may take.
    pub limits: PluginLimits,
    /// Folder that remembers what libraries said of themselves.
    pub memory: Option<PathBuf>,
    /// Who may run in this process.
    pub lock: PluginLock,
}

/// A library that has been described.
#[derive(Clone)]
pub struct Plugin {
    /// Where it lies.
    pub path: PathBuf,
    /// The name it gives itself.
    pub name: &'static str,
    /// The version it gives itself.
    pub version: &'static str,
    /// Digest of the file.
    pub digest: Digest,
    /// Its nodes run in this process.
    pub trusted: bool,
    /// What it brings.
    pub kinds: Vec<NodeKind>,
}

/// Why a library cannot be used.
#[derive(Clone, Debug, thiserror::Error, miette::Diagnostic)]
#[non_exhaustive]
pub enum PluginError {
    /// The file is not there, or not to be read.
    #[error("the plugin `{path}` cannot be read: {reason}")]
    #[diagnostic(help("check the path; `heartian plugins ls` shows where plugins are looked for"))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// It is no plugin, not one for this program, or a broken one.
    #[error("the plugin `{path}` cannot be used: {reason}")]
    #[diagnostic(help("{remedy}"))]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// What to do.
        remedy: String,
    },
    /// Two bring the same kind.
    #[error("the plugin `{path}` brings the kind `{kind}`, which {other} brings already")]
    #[diagnostic(help("leave one of them out, or ask an author for another name"))]
    Twice {
        /// The file.
        path: PathBuf,
        /// The kind.
        kind: String,
        /// Who has it.
        other: String,
    },
}

impl Plugins {
    /// Describes a library, from memory if it was described before. `house` knows the program's own artifact types. The
    /// kinds' text is leaked: load each library once.
    ///
    /// # Errors
    /// When it cannot be read or used.
    pub fn load(&self, path: &Path, house: &Registry) -> Result<Plugin, PluginError> {
        self.load_with(path, house, false)
    }

    /// Describes a library whatever is remembered of it.
    ///
    /// # Errors
    /// When it cannot be read or used.
    pub fn load_afresh(&self, path: &Path, house: &Registry) -> Result<Plugin, PluginError> {
        self.load_with(path, house, true)
    }

    fn load_with(&self, path: &Path, house: &Registry, afresh: bool) -> Result<Plugin, PluginError> {
        let unreadable = |error: std::io::Error| PluginError::Read { path: path.to_owned(), reason: error.to_string() };
        let whole = std::fs::canonicalize(path).map_err(unreadable)?;
        let ask = |digest: &Digest| self.ask(&whole, digest);
        let known = memory::recall(self.memory.as_deref(), &whole, afresh, ask).map_err(unreadable)?;
        let unusable = |trouble: Trouble| PluginError::Unusable {
            path: path.to_owned(),
            reason: trouble.message,
            remedy: trouble.remedy.unwrap_or("report it to its author".to_owned()),
        };
        let document = known.said.map_err(unusable)?.to_string();
        let described = Description::read(document.as_bytes()).and_then(|text| Ok((text.kinds(house)?, text)));
        let (kinds, text) = described.map_err(|reason| unusable(Trouble::new(reason)))?;
        Ok(self.leak((whole, known.digest), &text, kinds))
    }

    /// Asks a library, in a child process, what it is.
    fn ask(&self, path: &Path, digest: &Digest) -> Result<Value, Trouble> {
        let document = Worker::start(&self.host, (path, digest), &self.limits)?.describe(&self.limits)?;
        Description::read(&document).map_err(Trouble::new)?;
        serde_json::from_slice(&document).map_err(|error| Trouble::new(error.to_string()))
    }

    fn leak(&self, (path, digest): (PathBuf, Digest), text: &Description, kinds: Vec<KindParts>) -> Plugin {
        let (name, version) = (leak(&text.name), leak(&text.version));
        let library: &'static Loaded = Box::leak(Box::new(Loaded {
            name,
            version,
            path: path.clone(),
            digest,
            host: self.host.clone(),
            limits: self.limits,
            trusted: self.lock.trusts(&digest),
            native: OnceLock::new(),
            idle: Mutex::default(),
            metrics: Mutex::default(),
        }));
        let kind = |parts| {
            let kind: &'static LoadedKind = Box::leak(Box::new(LoadedKind { parts, library }));
            NodeKind {
                kind: kind.parts.kind,
                revision: kind.parts.revision,
                implementation: Some(digest),
                doc: kind.parts.doc,
                inputs: kind.parts.inputs,
                outputs: kind.parts.outputs,
                params: kind.parts.params,
                make: Make::Loaded(Box::leak(Box::new(kind))),
            }
        };
        let kinds = kinds.into_iter().map(kind).collect();
        Plugin { path, name, version, digest, trusted: library.trusted, kinds }
    }
}

/// Loads a library into this process, which must be there to be lost or the library trusted, if it still is what was
/// digested.
fn load_verified(path: &Path, digest: &Digest) -> Result<Native, Trouble> {
    let bytes = std::fs::read(path).map_err(|error| Trouble::new(format!("it cannot be read: {error}")))?;
    if Digest::of(&bytes) != *digest {
        return Err(Trouble::new("the file has changed since this run began").remedy("run again"));
    }
    // SAFETY: the caller has a process to lose, or the user trusts the library's author.
    unsafe { Native::load(path) }
}

impl Registry {
    /// Adds the kinds that a library brings.
    ///
    /// # Errors
    /// When one of them is there already; then none is added.
    pub fn add(&mut self, plugin: &Plugin) -> Result<(), PluginError> {
        if let Some(kind) = plugin.kinds.iter().find(|kind| self.get(kind.kind).is_some()) {
            let loaded = self.get(kind.kind).is_some_and(|known| known.implementation.is_some());
            let other = if loaded { "another plugin" } else { "the program itself" };
            let (path, kind) = (plugin.path.clone(), kind.kind.to_owned());
            return Err(PluginError::Twice { path, kind, other: other.to_owned() });
        }
        self.extend(plugin.kinds.iter().copied());
        Ok(())
    }
}
