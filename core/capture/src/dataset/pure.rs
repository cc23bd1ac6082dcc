//! PURE: `SS-TT/SS-TT/*.png` and `SS-TT/SS-TT.json` with the pulse at 60 Hz under `/FullPackage` and the frames' times under
//! `/Image`. Clocks count nanoseconds; a frame's time is also in its name. Subject SS did task TT.

use std::path::Path;

use serde::Deserialize;

use super::{DataSet, DataSetError, Place, Recording, read_text, times_over_frames};
use crate::ppg::Trace;
use crate::video::{self, FrameSource, VideoError};

/// What the six tasks are called.
const TASKS: [&str; 6] =
    ["Steady", "Talking", "Slow Translation", "Fast Translation", "Small Rotation", "Medium Rotation"];
/// Shortest run of digits in a name that is a time in nanoseconds.
const CLOCK_DIGITS: usize = 15;

#[derive(Deserialize)]
struct Document {
    #[serde(rename = "/FullPackage", default)]
    package: Vec<Package>,
    #[serde(rename = "/Image", default)]
    images: Vec<Image>,
}

#[derive(Deserialize)]
struct Package {
    #[serde(rename = "Timestamp", default)]
    nanoseconds: Option<u64>,
    #[serde(rename = "Value")]
    value: Value,
}

#[derive(Deserialize)]
struct Value {
    #[serde(default)]
    waveform: Option<f64>,
}

#[derive(Deserialize)]
struct Image {
    #[serde(rename = "Timestamp", default)]
    nanoseconds: Option<u64>,
}

/// A recording's folder, or the folder of its frames.
pub fn locate(path: &Path) -> Option<Place> {
    let whole = path.canonicalize().ok()?;
    let name = whole.file_name()?.to_str()?.to_owned();
    let numbered = matches!(name.as_bytes(), [a, b, b'-', c, d] if [a, b, c, d].iter().all(|c| c.is_ascii_digit()));
    if !numbered {
        return None;
    }
    let json = format!("{name}.json");
    let (frames, labels) = match path.join(&name) {
        inner if inner.is_dir() => (inner, path.join(json)),
        _ if whole.parent()?.join(&json).is_file() => (path.to_owned(), whole.parent()?.join(json)),
        _ => return None,
    };
    Some(Place { set: DataSet::Pure, name, video: frames, labels })
}

fn document(path: &Path) -> Result<Document, DataSetError> {
    let wrong = |reason: String| DataSetError::Damaged { path: path.to_owned(), reason };
    serde_json::from_str(&read_text(path)?).map_err(|error| wrong(error.to_string()))
}

/// The frames' clock in nanoseconds: by their names, else by the list in the labels when it is one a frame.
fn clock(place: &Place) -> Result<(usize, Option<Vec<u64>>), VideoError> {
    let files = video::pictures(&place.video)?;
    let by_name: Option<Vec<u64>> = files.iter().map(|path| time_in(&video::name(path))).collect();
    let by_list = || {
        let images = document(&place.labels).ok()?.images;
        let times: Option<Vec<u64>> = images.iter().map(|image| image.nanoseconds).collect();
        times.filter(|times| times.len() == files.len())
    };
    let increasing = |times: &Vec<u64>| times.windows(2).all(|pair| pair[1] > pair[0]);
    Ok((files.len(), by_name.filter(increasing).or_else(|| by_list().filter(increasing))))
}

/// The nanoseconds in a frame's name.
fn time_in(name: &str) -> Option<u64> {
    let runs = name.split(|c: char| !c.is_ascii_digit());
    runs.filter(|run| run.len() >= CLOCK_DIGITS).find_map(|run| run.parse().ok())
}

fn seconds_since(first: u64, nanoseconds: u64) -> f64 {
    (i128::from(nanoseconds) - i128::from(first)) as f64 * 1e-9
}

pub fn frames(place: &Place) -> Result<Box<dyn FrameSource + Send>, VideoError> {
    let source = video::open_plain(&place.video, 0.0, DataSet::HERTZ)?;
    let (_, clock) = clock(place)?;
    Ok(match clock {
        Some(times) => {
            let first = times.first().copied().unwrap_or(0);
            video::retimed(source, times.into_iter().map(|time| seconds_since(first, time)).collect())
        }
        None => source,
    })
}

pub fn trace(place: &Place) -> Result<Trace, DataSetError> {
    let wrong = |reason: String| DataSetError::Damaged { path: place.labels.clone(), reason };
    let package = document(&place.labels)?.package;
    if package.is_empty() {
        return Err(wrong("there is nothing under `/FullPackage`".into()));
    }
    let values: Vec<f64> = package.iter().map(|one| one.value.waveform.unwrap_or(f64::NAN)).collect();
    let (count, clock) = clock(place).map_err(|error| wrong(error.to_string()))?;
    let stamps: Option<Vec<u64>> = package.iter().map(|one| one.nanoseconds).collect();
    match (stamps, clock.and_then(|times| times.first().copied())) {
        (Some(stamps), Some(first)) => {
            let times = stamps.into_iter().map(|stamp| seconds_since(first, stamp)).collect();
            Ok(Trace::new(&place.labels, times, values)?)
        }
        _ => {
            let times = times_over_frames(values.len(), count, DataSet::HERTZ);
            let mut trace = Trace::new(&place.labels, times, values)?;
            trace
                .notes
                .push("its samples and frames have no common clock: they were laid over each other evenly".into());
            Ok(trace)
        }
    }
}

pub fn inspect(place: &Place, recording: &mut Recording) {
    let (subject, task) = place.name.split_once('-').unwrap_or((&place.name, ""));
    recording.label("subject", subject);
    recording.label("setup", task);
    if let Some(motion) = task.parse::<usize>().ok().and_then(|task| TASKS.get(task.checked_sub(1)?)) {
        recording.label("motion", motion);
    }
    match clock(place) {
        Ok((frames, clock)) => {
            recording.frames = Some(frames);
            let span = clock.and_then(|times| Some(seconds_since(*times.first()?, *times.last()?)));
            let mean = span.filter(|span| *span > 0.0).map(|span| (frames - 1) as f64 / span);
            recording.hertz = Some(mean.unwrap_or(DataSet::HERTZ));
        }
        Err(error) => recording.missing.push(format!("frames: {error}")),
    }
    recording.trace_of(place);
}
