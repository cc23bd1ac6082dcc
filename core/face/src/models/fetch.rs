//! Fetching one pinned package with the user's own package client, into a temporary folder.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::catalogue::Package;
use super::{ModelsError, archive};

/// A package client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Client {
    /// `npm pack`: downloads a package as it is and runs nothing of it.
    Npm,
    /// `pip download`: downloads a wheel without its dependencies.
    Pip,
}

impl Client {
    pub fn name(self) -> &'static str {
        match self {
            Self::Npm => "npm",
            Self::Pip => "pip",
        }
    }

    /// Programs to try, with their leading arguments.
    fn programs(self) -> &'static [&'static [&'static str]] {
        match self {
            Self::Npm if cfg!(windows) => &[&["npm.cmd"]],
            Self::Npm => &[&["npm"]],
            Self::Pip => &[&["pip"], &["pip3"], &["python3", "-m", "pip"], &["python", "-m", "pip"]],
        }
    }

    /// One more try each: who is offline should hear of it soon. Registries and mirrors are the client's own settings.
    fn arguments(self, package: &Package) -> Vec<String> {
        let Package { name, version, .. } = package;
        match self {
            Self::Npm => {
                let patience = ["--fetch-retries=1", "--fetch-retry-mintimeout=1000", "--silent"].map(str::to_owned);
                ["pack".to_owned(), format!("{name}@{version}")].into_iter().chain(patience).collect()
            }
            // Pinned tags: any pip fetches the same wheel, whatever its own Python and platform.
            Self::Pip => {
                ["download", "--no-deps", "--retries=1", "--only-binary=:all:", "--python-version", "311", "--platform"]
                    .into_iter()
                    .map(str::to_owned)
                    .chain(["manylinux2014_x86_64".into(), format!("{name}=={version}")])
                    .collect()
            }
        }
    }
}

/// What to say before trying the other client after this error; `None` when that would not help.
pub(super) fn after(error: &ModelsError) -> Option<&'static str> {
    match error {
        ModelsError::NoClient { .. } => Some("npm is not on PATH; trying pip"),
        ModelsError::Fetch { .. } => Some("npm did not deliver; trying pip"),
        ModelsError::Package { .. } | ModelsError::Checksum { .. } => {
            Some("npm's package is not the pinned one; trying pip")
        }
        _ => None,
    }
}

/// A package on disk, removed when dropped.
pub(crate) struct Fetched {
    _folder: tempfile::TempDir,
    archive: PathBuf,
}

impl Fetched {
    /// The package's file.
    pub fn archive(&self) -> &Path {
        &self.archive
    }

    /// A member, or a range of its bytes.
    pub fn member(&self, package: &Package, name: &str, range: Option<(usize, usize)>) -> Result<Vec<u8>, ModelsError> {
        let wrong = |reason| ModelsError::Package { package: format!("{} {}", package.name, package.version), reason };
        let bytes = archive::member(&self.archive, name).map_err(wrong)?;
        match range {
            None => Ok(bytes),
            Some((from, to)) => {
                bytes.get(from..to).map(<[u8]>::to_vec).ok_or_else(|| wrong(format!("`{name}` is too short")))
            }
        }
    }
}

/// Downloads a package. `directory` is only named in errors.
pub(crate) fn fetch(package: &Package, directory: &Path) -> Result<Fetched, ModelsError> {
    let failed = |reason: String| ModelsError::Fetch { reason, directory: directory.to_owned() };
    let folder = tempfile::tempdir().map_err(|error| ModelsError::File { path: std::env::temp_dir(), error })?;
    for program in package.client.programs() {
        let mut command = Command::new(program[0]);
        command
            .args(&program[1..])
            .args(package.client.arguments(package))
            .current_dir(folder.path())
            .stdin(Stdio::null());
        match command.output() {
            Ok(output) if output.status.success() => {
                let archive = only_file(folder.path()).ok_or_else(|| {
                    failed(format!("{} left no {} package behind", package.client.name(), package.name))
                })?;
                return Ok(Fetched { _folder: folder, archive });
            }
            Ok(output) => {
                let reason = last_words(&output.stderr);
                let Package { name, version, client } = package;
                return Err(failed(format!("{} could not fetch {name} {version} ({reason})", client.name())));
            }
            Err(_) => {}
        }
    }
    let clients = match package.client {
        Client::Npm => "`npm`",
        Client::Pip => "`pip`",
    };
    Err(ModelsError::NoClient { clients, directory: directory.to_owned() })
}

fn only_file(folder: &Path) -> Option<PathBuf> {
    std::fs::read_dir(folder).ok()?.filter_map(Result::ok).map(|entry| entry.path()).find(|path| path.is_file())
}

/// The client's last error lines in one, without addresses: those may carry credentials.
fn last_words(stderr: &[u8]) -> String {
    let text = String::from_utf8_lossy(stderr);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let last = lines.iter().rev().find(|line| line.to_lowercase().contains("err")).or(lines.last()).copied();
    let words = last.unwrap_or("no reason given").split_whitespace().filter(|word| !word.contains("://"));
    words.collect::<Vec<_>>().join(" ").chars().take(200).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_never_reach_a_message() {
        let said = last_words(
            b"npm error code E404\nnpm error 404 Not Found - GET https://user:secret@example.org/x - gone\n\n",
        );
        assert!(said.contains("404") && !said.contains("secret"), "{said}");
        assert_eq!(last_words(b""), "no reason given");
    }
}
