//! The pretrained networks: which files they are, where they rest, and how a user obtains them.
//!
//! Nothing is vendored. [`install`] fetches two packages with the user's own package client, cuts the networks out,
//! checks their SHA-256 against the digests pinned here, and moves each into place in one step. Files rest in
//! `HEARTIAN_MODELS`, else in the user's data directory under `heartian/models`; they are checked again on every load.

mod archive;
mod fetch;

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::nets::{Detector, LandmarkNet, NetError, PersonMatte};
use fetch::Client;

/// What can go wrong with installing or loading networks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelsError {
    /// A network is not there.
    #[error("the {name} network is not installed (looked for {}): run `heartian models install`", path.display())]
    NotInstalled {
        /// Which network.
        name: &'static str,
        /// Where it should be.
        path: PathBuf,
    },
    /// A file is not the one pinned here.
    #[error("{} is not the {name} network this version pins (its SHA-256 is {found}): run `heartian models install`", path.display())]
    Checksum {
        /// Which network.
        name: &'static str,
        /// The file, or the package member it came from.
        path: PathBuf,
        /// The digest found.
        found: String,
    },
    /// Neither client is on PATH.
    #[error("fetching the networks needs `npm` or `pip` on PATH, and neither was found; install Node.js or Python, or copy the networks from another machine into {}", directory.display())]
    NoClient {
        /// Where the networks go.
        directory: PathBuf,
    },
    /// A client ran but did not deliver.
    #[error(
        "{0}; check that the package registry can be reached (proxy, offline?) and run `heartian models install` again"
    )]
    Fetch(String),
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
}

/// A package in a registry.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Package {
    pub client: Client,
    pub name: &'static str,
    pub version: &'static str,
}

/// One network inside a package.
struct Source {
    package: &'static Package,
    /// Path inside the package.
    member: &'static str,
    /// Bytes of that member; all of it when `None`.
    range: Option<(usize, usize)>,
    sha256: &'static str,
}

/// One network.
struct Model {
    name: &'static str,
    file: &'static str,
    /// In order of preference. The two publications differ in metadata, not in weights.
    sources: [Source; 2],
}

const FACE_MESH: Package = Package { client: Client::Npm, name: "@mediapipe/face_mesh", version: "0.4.1657299874" };
const SELFIE: Package =
    Package { client: Client::Npm, name: "@mediapipe/selfie_segmentation", version: "0.1.1675465747" };
const WHEEL: Package = Package { client: Client::Pip, name: "mediapipe", version: "0.10.14" };
const FACE_MESH_DATA: &str = "package/face_mesh_solution_packed_assets.data";

const MODELS: [Model; 3] = [
    Model {
        name: "face detection",
        file: "face_detection_short_range.tflite",
        sources: [
            Source {
                package: &FACE_MESH,
                member: FACE_MESH_DATA,
                range: Some((3_757_224, 3_986_256)),
                sha256: "3bc182eb9f33925d9e58b5c8d59308a760f4adea8f282370e428c51212c26633",
            },
            Source {
                package: &WHEEL,
                member: "mediapipe/modules/face_detection/face_detection_short_range.tflite",
                range: None,
                sha256: "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8",
            },
        ],
    },
    Model {
        name: "face landmark",
        file: "face_landmark.tflite",
        sources: [
            Source {
                package: &FACE_MESH,
                member: FACE_MESH_DATA,
                range: Some((2_495_952, 3_737_848)),
                sha256: "c603fa6149219a3e9487dc9abd7a0c24474c77263273d24868378cdf40aa26d1",
            },
            Source {
                package: &WHEEL,
                member: "mediapipe/modules/face_landmark/face_landmark.tflite",
                range: None,
                sha256: "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
            },
        ],
    },
    Model {
        name: "person segmentation",
        file: "selfie_segmentation.tflite",
        sources: [
            Source {
                package: &SELFIE,
                member: "package/selfie_segmentation.tflite",
                range: None,
                sha256: "8d13b7fae74af625c641226813616a2117bd6bca19eb3b75574621fc08557f27",
            },
            Source {
                package: &WHEEL,
                member: "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
                range: None,
                sha256: "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
            },
        ],
    },
];

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

/// One network as it rests on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// What it does.
    pub name: &'static str,
    /// Where it rests.
    pub path: PathBuf,
    /// Whether it can be used.
    pub state: State,
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

/// Every network and its state.
///
/// # Errors
/// When no folder can be told.
pub fn list() -> Result<Vec<Status>, ModelsError> {
    let directory = directory()?;
    let status = |model: &Model| {
        let path = directory.join(model.file);
        let state = match read_model(model, &directory) {
            Ok(_) => State::Installed,
            Err(ModelsError::NotInstalled { .. }) => State::Missing,
            Err(_) => State::Damaged,
        };
        Status { name: model.name, path, state }
    };
    Ok(MODELS.iter().map(status).collect())
}

/// Errs unless every network is installed and is the file pinned here.
///
/// # Errors
/// The first network that is missing or damaged.
pub fn verify() -> Result<(), ModelsError> {
    let directory = directory()?;
    MODELS.iter().try_for_each(|model| read_model(model, &directory).map(drop))
}

/// Fetches what is missing or damaged; `progress` gets one line per step. Nothing is fetched when all is there.
///
/// # Errors
/// No client, a registry that is not reached, a file that is not the one pinned, or a folder that cannot be written.
pub fn install(progress: &mut dyn FnMut(&str)) -> Result<Vec<Status>, ModelsError> {
    let directory = directory()?;
    let wanted: Vec<&Model> = MODELS.iter().filter(|model| read_model(model, &directory).is_err()).collect();
    if !wanted.is_empty() {
        let npm = install_from(&wanted, 0, &directory, progress);
        if let Err(error) = npm {
            let Some(fallback) = fetch::after(&error) else { return Err(error) };
            progress(fallback);
            if let Err(second) = install_from(&wanted, 1, &directory, progress) {
                let neither = matches!((&error, &second), (ModelsError::NoClient { .. }, ModelsError::NoClient { .. }));
                return Err(if neither || !matches!(second, ModelsError::NoClient { .. }) { second } else { error });
            }
        }
    }
    verify()?;
    list()
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
            let temporary = tempfile::NamedTempFile::new_in(directory).map_err(file)?;
            std::fs::write(temporary.path(), &bytes).map_err(file)?;
            let path = directory.join(model.file);
            temporary.persist(&path).map_err(|failed| ModelsError::File { path: path.clone(), error: failed.error })?;
            progress(&format!("installed {} ({} bytes)", model.name, bytes.len()));
        }
    }
    Ok(())
}

/// Errs unless the bytes are one of the two publications of a network.
fn check(model: &Model, bytes: &[u8], path: &Path) -> Result<(), ModelsError> {
    let found: String = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    if model.sources.iter().any(|source| source.sha256 == found) {
        return Ok(());
    }
    Err(ModelsError::Checksum { name: model.name, path: path.to_owned(), found })
}

fn read_model(model: &Model, directory: &Path) -> Result<Vec<u8>, ModelsError> {
    let path = directory.join(model.file);
    match std::fs::read(&path) {
        Ok(bytes) => check(model, &bytes, &path).map(|()| bytes),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            Err(ModelsError::NotInstalled { name: model.name, path })
        }
        Err(error) => Err(ModelsError::File { path, error }),
    }
}

/// The three networks a real recording needs.
#[derive(Debug)]
pub struct FaceNets {
    /// Finds faces.
    pub detector: Detector,
    /// Reads 468 landmarks.
    pub landmarks: LandmarkNet,
    /// Tells person from background.
    pub person: PersonMatte,
}

/// Loads the installed face detector alone, checking its digest.
///
/// # Errors
/// When it is missing or damaged; the message says how to install.
pub fn load_detector() -> Result<Detector, ModelsError> {
    Ok(Detector::parse(&read_model(&MODELS[0], &directory()?)?)?)
}

impl FaceNets {
    /// Loads the installed networks, checking each file's digest.
    ///
    /// # Errors
    /// When one is missing or damaged; the message says how to install.
    pub fn load() -> Result<Self, ModelsError> {
        let directory = directory()?;
        let [detector, landmarks, person] = &MODELS;
        Ok(Self {
            detector: Detector::parse(&read_model(detector, &directory)?)?,
            landmarks: LandmarkNet::parse(&read_model(landmarks, &directory)?)?,
            person: PersonMatte::parse(&read_model(person, &directory)?)?,
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
