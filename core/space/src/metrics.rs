//! Named figures of merit, in the order of their names. Keys are stable: later versions add and never rename.

use std::collections::BTreeMap;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

/// Figures by dotted name, with the unit in the name (`attribute.hr_error_bpm`). A figure that could not be measured is
/// NaN, and becomes `null` in JSON.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metrics(pub BTreeMap<String, f64>);

impl Metrics {
    /// No figures.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a figure; the last of equal names wins.
    pub fn with(mut self, name: &str, value: f64) -> Self {
        self.0.insert(name.to_owned(), value);
        self
    }

    /// The figure of that name.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.get(name).copied()
    }
}

impl Artifact for Metrics {
    const TYPE: ArtifactType = ArtifactType { name: "metrics", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        Bundle::new().meta("metrics", &self.0)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let figures: BTreeMap<String, Option<f64>> = reader.meta("metrics")?;
        Ok(Self(figures.into_iter().map(|(name, value)| (name, value.unwrap_or(f64::NAN))).collect()))
    }
}
