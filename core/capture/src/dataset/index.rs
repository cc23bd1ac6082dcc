//! What a folder of a data set holds: every recording with its labels, its length, and what is missing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::{DataSet, DataSetError, Place, ibvp, locate, mmpd, pure, scamps, trace, ubfc};
use crate::ppg::Trace;
use crate::video;

/// Recordings lie at most this deep below a data set's folder.
const DEEPEST: usize = 4;
/// How far the pulse may end before the last frame and still cover it, seconds.
const SLACK_SECONDS: f64 = 0.1;

/// One recording, without its frames.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Recording {
    /// Which data set.
    pub set: DataSet,
    /// Its name within the set.
    pub name: String,
    /// What `frames.source` takes.
    pub source: PathBuf,
    /// Labels in the data set's own words.
    pub labels: BTreeMap<String, String>,
    /// Number of frames, where it can be told without reading them.
    pub frames: Option<usize>,
    /// Mean frame rate, hertz.
    pub hertz: Option<f64>,
    /// Length, seconds.
    pub seconds: Option<f64>,
    /// Samples of the pulse.
    pub ppg_samples: Option<usize>,
    /// Rate of the pulse, hertz.
    pub ppg_hertz: Option<f64>,
    /// What is not there, cannot be read, or has holes.
    pub missing: Vec<String>,
}

impl Recording {
    /// Looks at the headers and the pulse of a recording.
    pub fn of(place: &Place, source: &Path) -> Self {
        let mut recording = Self {
            set: place.set,
            name: place.name.clone(),
            source: source.to_owned(),
            labels: BTreeMap::new(),
            frames: None,
            hertz: None,
            seconds: None,
            ppg_samples: None,
            ppg_hertz: None,
            missing: Vec::new(),
        };
        match place.set {
            DataSet::Ubfc => ubfc::inspect(place, &mut recording),
            DataSet::Pure => pure::inspect(place, &mut recording),
            DataSet::Mmpd => mmpd::inspect(place, &mut recording),
            DataSet::Scamps => scamps::inspect(place, &mut recording),
            DataSet::Ibvp => ibvp::inspect(place, &mut recording),
        }
        recording.seconds = recording.frames.zip(recording.hertz).map(|(frames, hertz)| frames as f64 / hertz);
        recording.check_length();
        recording
    }

    /// Whether each label named has one of the values given, whatever their case. A label it does not have fits nothing.
    pub fn fits(&self, wanted: &BTreeMap<String, Vec<String>>) -> bool {
        wanted.iter().all(|(label, values)| {
            let own = self.labels.get(label);
            own.is_some_and(|own| values.iter().any(|value| value.trim().to_lowercase() == own.to_lowercase()))
        })
    }

    pub(super) fn label(&mut self, name: &str, value: &str) {
        self.labels.insert(name.to_owned(), value.to_owned());
    }

    pub(super) fn pulse(&mut self, trace: &Trace) {
        self.ppg_samples = Some(trace.series.len());
        self.ppg_hertz = Some(trace.series.rate_hertz()).filter(|hertz| *hertz > 0.0);
        self.missing.extend(trace.notes.iter().cloned());
        if let (Some(frames), Some(hertz), Some(last)) = (self.frames, self.hertz, trace.series.times_seconds.last()) {
            let end = frames.saturating_sub(1) as f64 / hertz;
            if *last < end - SLACK_SECONDS {
                self.missing.push(format!("pulse after {last:.2} s; the video ends at {end:.2} s"));
            }
        }
    }

    pub(super) fn trace_of(&mut self, place: &Place) {
        match trace(place) {
            Ok(trace) => self.pulse(&trace),
            Err(error) => self.missing.push(format!("pulse: {error}")),
        }
    }

    fn check_length(&mut self) {
        if self.frames.is_some_and(|frames| frames < 2) {
            self.missing.push("frames: a pulse needs more than one".into());
        }
    }
}

/// Every recording at or below a folder, in natural order. Folders that hold none are passed over.
///
/// # Errors
/// When the folder itself cannot be read.
pub fn list(folder: &Path) -> Result<Vec<Recording>, DataSetError> {
    if let Some(place) = locate(folder) {
        return Ok(vec![Recording::of(&place, folder)]);
    }
    let mut found = Vec::new();
    descend(folder, DEEPEST, &mut found).map_err(|error| DataSetError::File { path: folder.to_owned(), error })?;
    Ok(found)
}

fn descend(folder: &Path, depth: usize, found: &mut Vec<Recording>) -> std::io::Result<()> {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>()?;
    entries.sort_by(|a, b| video::natural(&video::name(a), &video::name(b)));
    for entry in entries {
        // A subject's video file is told by its folder.
        if let Some(place) = locate(&entry).filter(|place| entry.is_dir() || place.set != DataSet::Ubfc) {
            found.push(Recording::of(&place, &entry));
        } else if entry.is_dir() && depth > 1 {
            // A folder that may not be entered holds nothing for us.
            let _ = descend(&entry, depth - 1, found);
        }
    }
    Ok(())
}
