//! UBFC-rPPG, second data set: `subjectN/vid.avi`, raw BGR24, and `ground_truth.txt`, three lines of numbers: the pulse, the
//! heart rate, the times in seconds.
//!
//! There is one sample a frame, taken as the frame was: where the counts agree, the third line times both. Where they do
//! not, the frames keep the rate of the AVI header.

use std::path::Path;

use super::{DataSet, DataSetError, Place, Recording, read_text};
use crate::ppg::Trace;
use crate::video::{self, FrameSource, VideoError};

const VIDEO: &str = "vid.avi";
const LABELS: &str = "ground_truth.txt";

/// A subject's folder, or its video with the labels beside it.
pub fn locate(path: &Path) -> Option<Place> {
    let folder = match path.parent() {
        _ if path.is_dir() => path,
        Some(folder) if folder.as_os_str().is_empty() => Path::new("."),
        parent => parent?,
    };
    let (video, labels) = (folder.join(VIDEO), folder.join(LABELS));
    let ours = if path.is_dir() { video.is_file() } else { path.file_name()? == VIDEO && labels.is_file() };
    // Given from within its folder, the path has no folder name of its own.
    let name = folder.canonicalize().ok()?.file_name()?.to_string_lossy().into_owned();
    ours.then_some(Place { set: DataSet::Ubfc, name, video, labels })
}

/// The lines of the labels.
struct Labels {
    pulse: Vec<f64>,
    /// Seconds from the first sample, when they increase and are one a sample.
    times_seconds: Option<Vec<f64>>,
}

fn labels(path: &Path) -> Result<Labels, DataSetError> {
    let text = read_text(path)?;
    let wrong = |reason: String| DataSetError::Damaged { path: path.to_owned(), reason };
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    let mut numbers = |what: &str| -> Result<Vec<f64>, DataSetError> {
        let words = lines.next().unwrap_or_default().split_whitespace();
        let number =
            |word: &str| word.parse::<f64>().map_err(|_| wrong(format!("`{word}` in the {what} is no number")));
        words.map(number).collect()
    };
    let (pulse, _, times) = (numbers("pulse")?, numbers("heart rate")?, numbers("times")?);
    if pulse.is_empty() {
        return Err(wrong("its first line, the pulse, is empty".into()));
    }
    let increase = times.iter().all(|time| time.is_finite()) && times.windows(2).all(|pair| pair[1] > pair[0]);
    let first = times.first().copied().unwrap_or(0.0);
    let fits = increase && times.len() == pulse.len();
    Ok(Labels { times_seconds: fits.then(|| times.iter().map(|time| time - first).collect()), pulse })
}

pub fn frames(place: &Place) -> Result<Box<dyn FrameSource + Send>, VideoError> {
    let source = video::open_plain(&place.video, 0.0, f64::NAN)?;
    let times = labels(&place.labels).ok().and_then(|labels| labels.times_seconds);
    Ok(match times.filter(|times| source.frame_count() == Some(times.len())) {
        Some(times) => video::retimed(source, times),
        None => source,
    })
}

pub fn trace(place: &Place) -> Result<Trace, DataSetError> {
    let Labels { pulse, times_seconds } = labels(&place.labels)?;
    let (times, note) = match times_seconds {
        Some(times) => (times, None),
        None => {
            let step = header(place).and_then(|(_, hertz)| hertz).map_or(1.0 / DataSet::HERTZ, |hertz| 1.0 / hertz);
            let note = "its third line holds no time for each sample: one sample a frame was assumed";
            ((0..pulse.len()).map(|k| k as f64 * step).collect(), Some(note.to_owned()))
        }
    };
    let mut trace = Trace::new(&place.labels, times, pulse)?;
    trace.notes.extend(note);
    Ok(trace)
}

/// Number of frames and their rate by the AVI header.
fn header(place: &Place) -> Option<(usize, Option<f64>)> {
    let mut source = video::open_plain(&place.video, 0.0, f64::NAN).ok()?;
    let count = source.frame_count()?;
    let mut seconds = || source.next_frame().ok()?.map(|frame| frame.seconds);
    let hertz = seconds().zip(seconds()).map(|(first, second)| 1.0 / (second - first));
    Some((count, hertz.filter(|hertz| hertz.is_finite() && *hertz > 0.0)))
}

pub fn inspect(place: &Place, recording: &mut Recording) {
    recording.label("subject", place.name.trim_start_matches("subject"));
    match header(place) {
        Some((frames, hertz)) => (recording.frames, recording.hertz) = (Some(frames), hertz),
        None => recording.missing.push(format!("{VIDEO} that can be read")),
    }
    match trace(place) {
        Ok(trace) => {
            // The same clock as the frames': see above.
            let same = recording.frames == Some(trace.series.len());
            recording.hertz = if same { Some(trace.series.rate_hertz()) } else { recording.hertz };
            recording.pulse(&trace);
        }
        Err(error) => recording.missing.push(format!("pulse: {error}")),
    }
}
