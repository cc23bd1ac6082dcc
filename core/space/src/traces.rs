//! Labelled signals that travel together: a contact PPG, or the waveforms a reader recovered.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::Series;

/// One labelled signal.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// What it is in a report: `contact_ppg`, `prescribed`, `attribute`, `rendered.pos`, …
    pub label: String,
    /// The signal.
    pub series: Series,
}

/// Any number of labelled signals, in order; none when a recording came without PPG.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Traces(pub Vec<Trace>);

impl Traces {
    /// The first signal of that label.
    pub fn get(&self, label: &str) -> Option<&Series> {
        self.0.iter().find(|trace| trace.label == label).map(|trace| &trace.series)
    }
}

impl Artifact for Traces {
    const TYPE: ArtifactType = ArtifactType { name: "traces", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let labels: Vec<&str> = self.0.iter().map(|trace| trace.label.as_str()).collect();
        let mut bundle = Bundle::new().meta("labels", &labels)?;
        for (index, Trace { series, .. }) in self.0.iter().enumerate() {
            bundle = bundle.tensor(&format!("{index}.times_seconds"), &[series.len()], &series.times_seconds)?.tensor(
                &format!("{index}.values"),
                &[series.len()],
                &series.values,
            )?;
        }
        Ok(bundle)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let labels: Vec<String> = reader.meta("labels")?;
        let read = |(index, label): (usize, String)| {
            let times_seconds = reader.tensor(&format!("{index}.times_seconds"))?.1;
            let values = reader.tensor(&format!("{index}.values"))?.1;
            let series = Series::new(times_seconds, values);
            let series = series.map_err(|error| ArtifactError::Invalid(format!("{label}: {error}")))?;
            Ok(Trace { label, series })
        };
        labels.into_iter().enumerate().map(read).collect::<Result<_, _>>().map(Self)
    }
}
