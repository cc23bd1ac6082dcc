//! A sampled signal with its true times, as contact PPG arrives: any rate, possibly uneven.
//!
//! Always holds: as many values as times, at least one; times finite and strictly increasing; values finite.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::SpaceError;

/// Values at times.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Sample times, seconds, strictly increasing.
    pub times_seconds: Vec<f64>,
    /// Sample values, in the sensor's own units.
    pub values: Vec<f64>,
}

impl Series {
    /// Checks and wraps.
    ///
    /// # Errors
    /// When empty, of unequal lengths, with times that do not increase or values that are not finite.
    pub fn new(times_seconds: Vec<f64>, values: Vec<f64>) -> Result<Self, SpaceError> {
        if times_seconds.is_empty() {
            return Err(SpaceError::Empty("the series"));
        }
        if times_seconds.len() != values.len() {
            let (expected, found) = (times_seconds.len(), values.len());
            return Err(SpaceError::Length { what: "the series' values", expected, found });
        }
        check_times("the series", &times_seconds)?;
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            let (seconds, value) = (times_seconds[index], values[index]);
            return Err(SpaceError::NotFinite { what: "the series", index, seconds, value });
        }
        Ok(Self { times_seconds, values })
    }

    /// Number of samples, ≥ 1.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Never true of a checked series.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Mean sampling rate, hertz; 0 for one sample.
    pub fn rate_hertz(&self) -> f64 {
        let span = self.times_seconds[self.len() - 1] - self.times_seconds[0];
        if span > 0.0 { (self.len() - 1) as f64 / span } else { 0.0 }
    }

    /// Linear interpolation at `times_seconds` (increasing). Up to `slack_seconds` beyond either end the end value holds.
    ///
    /// # Errors
    /// When a time lies further outside, naming both spans: a trace shorter than its clip is never padded in silence.
    pub fn resampled(&self, times_seconds: &[f64], slack_seconds: f64) -> Result<Self, SpaceError> {
        let (Some(&wanted_from), Some(&wanted_to)) = (times_seconds.first(), times_seconds.last()) else {
            return Err(SpaceError::Empty("the list of times"));
        };
        check_times("the list of times", times_seconds)?;
        let (from, to) = (self.times_seconds[0], self.times_seconds[self.len() - 1]);
        if wanted_from < from - slack_seconds || wanted_to > to + slack_seconds {
            return Err(SpaceError::Span { what: "the series", from, to, wanted_from, wanted_to });
        }
        let values = times_seconds.iter().map(|&time| self.at(time)).collect();
        Self::new(times_seconds.to_vec(), values)
    }

    /// Linear interpolation; the end values hold outside.
    pub fn at(&self, seconds: f64) -> f64 {
        let after = self.times_seconds.partition_point(|&time| time <= seconds);
        if after == 0 {
            return self.values[0];
        }
        if after == self.len() {
            return self.values[self.len() - 1];
        }
        let (t0, t1) = (self.times_seconds[after - 1], self.times_seconds[after]);
        let fraction = (seconds - t0) / (t1 - t0);
        self.values[after - 1] + fraction * (self.values[after] - self.values[after - 1])
    }
}

/// Refuses times that are not finite and strictly increasing.
pub(crate) fn check_times(what: &'static str, times_seconds: &[f64]) -> Result<(), SpaceError> {
    let mut before = f64::NEG_INFINITY;
    for (index, &seconds) in times_seconds.iter().enumerate() {
        if !seconds.is_finite() || seconds <= before {
            return Err(SpaceError::Times { what, index, seconds });
        }
        before = seconds;
    }
    Ok(())
}

impl Artifact for Series {
    const TYPE: ArtifactType = ArtifactType { name: "series", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        Bundle::new().tensor("times_seconds", &[self.len()], &self.times_seconds)?.tensor(
            "values",
            &[self.len()],
            &self.values,
        )
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Self::new(reader.tensor("times_seconds")?.1, reader.tensor("values")?.1)
            .map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resampling_is_linear_and_never_pads_in_silence() -> Result<(), SpaceError> {
        let series = Series::new(vec![0.0, 1.0, 3.0], vec![0.0, 2.0, 6.0])?;
        assert_eq!(series.resampled(&[0.5, 2.0, 3.01], 0.02)?.values, [1.0, 4.0, 6.0]);
        assert!(matches!(series.resampled(&[0.0, 4.0], 0.02), Err(SpaceError::Span { .. })));
        assert!(matches!(Series::new(vec![0.0, 0.0], vec![1.0, 1.0]), Err(SpaceError::Times { index: 1, .. })));
        assert!(matches!(Series::new(vec![0.0], vec![f64::NAN]), Err(SpaceError::NotFinite { .. })));
        assert!(matches!(Series::new(vec![], vec![]), Err(SpaceError::Empty(_))));
        Ok(())
    }
}
