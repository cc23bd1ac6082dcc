//! iBVP: `pXX_y/pXX_y_rgb/*.bmp` at 30 frames a second and `pXX_y_bvp.csv`: a header, the pulse in the first column, its
//! quality in the fourth; laid over the frames by number. Samples of quality 0.3 or less are holes in the trace.

use std::path::Path;

use super::{DataSet, DataSetError, Place, Recording, read_text, times_over_frames};
use crate::ppg::Trace;
use crate::video::{self, FrameSource, VideoError};

/// Samples this good or worse are left out, as the data set's readers do.
const BAD_QUALITY: f64 = 0.3;
const QUALITY_COLUMN: usize = 3;

/// A recording's folder, or the folder of its frames.
pub fn locate(path: &Path) -> Option<Place> {
    let whole = path.canonicalize().ok()?;
    let last = whole.file_name()?.to_str()?;
    let (name, folder) = match last.strip_suffix("_rgb") {
        Some(name) => (name, whole.parent()?),
        None => (last, whole.as_path()),
    };
    let (video, labels) = (folder.join(format!("{name}_rgb")), folder.join(format!("{name}_bvp.csv")));
    // With the frames alone it could be any folder of pictures.
    let ours = video.is_dir() && (labels.is_file() || path.join(format!("{name}_rgb")).is_dir());
    ours.then(|| Place { set: DataSet::Ibvp, name: name.to_owned(), video, labels })
}

pub fn frames(place: &Place) -> Result<Box<dyn FrameSource + Send>, VideoError> {
    video::open_plain(&place.video, 0.0, DataSet::HERTZ)
}

pub fn trace(place: &Place) -> Result<Trace, DataSetError> {
    let wrong = |reason: String| DataSetError::Damaged { path: place.labels.clone(), reason };
    let frames = video::pictures(&place.video).map_err(|error| wrong(error.to_string()))?.len();
    let mut pulse = Vec::new();
    for (number, line) in read_text(&place.labels)?.lines().enumerate().skip(1) {
        if line.trim().is_empty() {
            continue;
        }
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let value = cells[0].parse::<f64>().map_err(|_| {
            let shown: String = cells[0].chars().take(40).collect();
            wrong(format!("line {}: the pulse is `{shown}`, not a number", number + 1))
        })?;
        let quality = cells.get(QUALITY_COLUMN).and_then(|cell| cell.parse::<f64>().ok());
        pulse.push(if quality.is_some_and(|quality| !(quality > BAD_QUALITY)) { f64::NAN } else { value });
    }
    Ok(Trace::new(&place.labels, times_over_frames(pulse.len(), frames, DataSet::HERTZ), pulse)?)
}

pub fn inspect(place: &Place, recording: &mut Recording) {
    if let Some((subject, session)) = place.name.split_once('_') {
        recording.label("subject", subject.trim_start_matches('p'));
        recording.label("session", session);
    }
    match video::pictures(&place.video) {
        Ok(files) => (recording.frames, recording.hertz) = (Some(files.len()), Some(DataSet::HERTZ)),
        Err(error) => recording.missing.push(format!("frames: {error}")),
    }
    recording.trace_of(place);
}
