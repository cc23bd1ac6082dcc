//! Named files as an artifact: reports and pictures that a run copies into its folder.
//!
//! Always holds: names are relative paths of ordinary components separated by `/`, so that writing them below a folder
//! stays below it.

use std::collections::BTreeMap;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

/// Files by name (`waveform.svg`, `sheet/01.png`).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Files(BTreeMap<String, Vec<u8>>);

impl Files {
    /// No files.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a file; the last of equal names wins.
    ///
    /// # Errors
    /// When the name is not a plain relative path.
    pub fn with(mut self, name: &str, bytes: Vec<u8>) -> Result<Self, ArtifactError> {
        let plain = |part: &str| {
            !part.is_empty() && part != "." && part != ".." && !part.contains(['\\', ':']) && !part.contains('\0')
        };
        if !name.split('/').all(plain) {
            return Err(ArtifactError::Invalid(format!("`{name}` is not a plain relative file name")));
        }
        self.0.insert(name.to_owned(), bytes);
        Ok(self)
    }

    /// Adds all files of another.
    pub fn extend(&mut self, other: &Self) {
        self.0.extend(other.0.iter().map(|(name, bytes)| (name.clone(), bytes.clone())));
    }

    /// Names and contents, in the order of the names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &[u8])> {
        self.0.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice()))
    }
}

impl Artifact for Files {
    const TYPE: ArtifactType = ArtifactType { name: "files", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        self.0.iter().try_fold(Bundle::new(), |bundle, (name, bytes)| bundle.tensor(name, &[bytes.len()], bytes))
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        reader.tensor_names().into_iter().try_fold(Self::new(), |files, name| {
            let bytes = reader.shaped::<u8>(&name, &[None])?;
            files.with(&name, bytes)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_survive_a_round_trip_and_names_stay_below() -> Result<(), ArtifactError> {
        let files = Files::new().with("a/b.png", vec![1, 2])?.with("empty.txt", Vec::new())?;
        let bytes = files.to_bundle()?.to_bytes()?;
        assert_eq!(Files::from_bundle(BundleReader::new(&bytes)?)?, files);
        for name in ["", "/etc/x", "../x", "a/../b", "a//b", "c:\\x", "./x", "a\0"] {
            assert!(Files::new().with(name, Vec::new()).is_err(), "{name:?}");
        }
        Ok(())
    }
}
