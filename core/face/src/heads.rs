//! Where head models come from: built in, installed, or the user's own file.

mod align;
pub(crate) mod anny;
mod flame;
mod lids;
mod parts;
pub(crate) mod stored;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use crate::{FaceError, HeadModel, models};

/// A choice of head model.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum HeadSource {
    /// The head of formulas, always there.
    #[default]
    Procedural,
    /// The head that `heartian models install head` fetched and converted.
    Installed,
    /// The user's FLAME 2020 or 2023 (`.pkl` or `.npz`), or a head file of our own (`.safetensors`).
    File {
        /// The model.
        model: PathBuf,
        /// Where the face mesh's landmarks sit on it (`.npz` or `.npy` with `lmk_face_idx`, `lmk_b_coords` and
        /// `landmark_indices`); without, they are found by aligning the built-in head.
        landmarks: Option<PathBuf>,
    },
}

impl HeadModel {
    /// Loads a head model.
    ///
    /// # Errors
    /// When it is not installed, or a file is missing, damaged, of another layout, or names anything in its pickle that
    /// no array needs. Nothing in a file is ever executed.
    pub fn load(source: &HeadSource) -> Result<HeadModel, FaceError> {
        match source {
            HeadSource::Procedural => Ok(HeadModel::procedural()),
            HeadSource::Installed => models::load_head().map_err(|error| FaceError::HeadNotInstalled(Box::new(error))),
            HeadSource::File { model, landmarks } => from_file(model, landmarks.as_deref()),
        }
    }
}

fn from_file(path: &Path, landmarks: Option<&Path>) -> Result<HeadModel, FaceError> {
    let bytes = read(path)?;
    let wrong = |reason: String| FaceError::HeadFile { path: path.to_owned(), reason };
    // Eight bytes of length, then the JSON header of safetensors.
    if bytes.get(8) == Some(&b'{') {
        return stored::Stored::from_bytes(&bytes).map_err(|error| wrong(error.to_string()))?.into_head();
    }
    let raw = flame::Raw::read(&bytes).map_err(wrong)?;
    let embedding = match landmarks {
        None => None,
        Some(path) => {
            let wrong = |reason: String| FaceError::HeadFile { path: path.to_owned(), reason };
            Some(flame::Embedding::read(&read(path)?).map_err(wrong)?)
        }
    };
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("flame");
    flame::head(raw, embedding, stem).map_err(wrong)
}

/// Reads a file of at most a gigabyte.
fn read(path: &Path) -> Result<Vec<u8>, FaceError> {
    use std::io::Read;
    let wrong = |reason: String| FaceError::HeadFile { path: path.to_owned(), reason };
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|error| wrong(error.to_string()))?;
    file.take((1 << 30) + 1).read_to_end(&mut bytes).map_err(|error| wrong(error.to_string()))?;
    if bytes.len() > 1 << 30 { Err(wrong("it is larger than 1 GiB".into())) } else { Ok(bytes) }
}
