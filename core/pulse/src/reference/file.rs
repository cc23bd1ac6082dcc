//! A pulse from a file, on its own clock: another person's recording, any waveform, a list of beats or of intervals. Its
//! start falls on the clip's first frame.

use std::path::{Path, PathBuf};

use heartian_space::{CsvKind, Series, read_csv};

use crate::error::PulseError;

use super::Reference;

/// Headers of the files that hold a pulse.
const KINDS: [CsvKind; 3] = [
    CsvKind { header: &["time_s", "ppg"], values: &["the time", "the PPG value"] },
    CsvKind { header: &["beat_s"], values: &["the time of the beat"] },
    CsvKind { header: &["rr_ms"], values: &["the interval"] },
];

/// What a file holds.
#[derive(Clone, Debug, PartialEq)]
pub enum PulseFile {
    /// `time_s,ppg`: a contact PPG or any waveform, at any rate.
    Waveform(Series),
    /// `beat_s` (times of systolic peaks, seconds) or `rr_ms` (intervals, milliseconds): when beats fall.
    Beats(Vec<f64>),
}

impl PulseFile {
    /// Reads a CSV whose header is `time_s,ppg`, `beat_s` or `rr_ms`.
    ///
    /// # Errors
    /// Names the file and the line that cannot be read, times out of order, and intervals that are not positive.
    pub fn read(path: &Path) -> Result<Self, PulseError> {
        let (kind, mut columns) = read_csv(path, &KINDS)?;
        let at_fault = |reason: String| PulseError::File { path: PathBuf::from(path), reason };
        let last = columns.pop().unwrap_or_default();
        match kind {
            0 => {
                let series = Series::new(columns.pop().unwrap_or_default(), last);
                series.map(Self::Waveform).map_err(|error| at_fault(error.to_string()))
            }
            1 => match (1..last.len()).find(|&k| last[k] <= last[k - 1]) {
                Some(k) => Err(at_fault(format!("beat {k} ({} s) is not after the one before it; sort them", last[k]))),
                None => Ok(Self::Beats(last)),
            },
            _ => match last.iter().position(|&interval| interval <= 0.0) {
                Some(k) => Err(at_fault(format!("interval {k} is {} ms; it must be above 0", last[k]))),
                None => {
                    let mut at = 0.0;
                    let after = |interval: &f64| {
                        at += interval / 1000.0;
                        at
                    };
                    Ok(Self::Beats(std::iter::once(0.0).chain(last.iter().map(after)).collect()))
                }
            },
        }
    }

    /// The reference at a clip's frame times; the file's own start falls on the first.
    ///
    /// # Errors
    /// When it does not reach over the clip, or carries no pulse the frame rate can show.
    pub fn reference(&self, times_seconds: &[f64]) -> Result<Reference, PulseError> {
        let start = times_seconds.first().copied().unwrap_or(0.0);
        match self {
            Self::Waveform(series) => {
                let shift = start - series.times_seconds[0];
                let times = series.times_seconds.iter().map(|time| time + shift).collect();
                Reference::from_ppg(&Series::new(times, series.values.clone())?, times_seconds)
            }
            Self::Beats(beats) => {
                let shifted: Vec<f64> = beats.iter().map(|beat| beat + start).collect();
                Reference::from_beats(&shifted, times_seconds)
            }
        }
    }
}
