//! Named words that belong beside the figures of a run: which model was used. Keys are stable, as those of metrics are.

use std::collections::BTreeMap;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

/// Words by dotted name (`track.head_model`).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Labels(pub BTreeMap<String, String>);

impl Labels {
    /// One word.
    pub fn of(name: &str, word: &str) -> Self {
        Self(BTreeMap::from([(name.to_owned(), word.to_owned())]))
    }
}

impl Artifact for Labels {
    const TYPE: ArtifactType = ArtifactType { name: "labels", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        Bundle::new().meta("labels", &self.0)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Ok(Self(reader.meta("labels")?))
    }
}
