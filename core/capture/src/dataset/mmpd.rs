//! MMPD: `subjectN/pN_k.mat`, MATLAB version 5. `video` is `T×240×320×3` in 0–1, `GT_ppg` the pulse, laid over the frames by
//! number; 30 frames a second. All other variables of one value are labels: `light`, `motion`, `exercise`, `skin_color`,
//! `gender`, `glasser`, `hair_cover`, `makeup`.

use super::mat::{self, Array, Class};
use super::{DataSet, DataSetError, Place, Recording, times_over_frames};
use crate::ppg::Trace;
use crate::video::{ArrayVideo, Columns, Scale};

const VIDEO: &str = "video";
const PULSE: &str = "GT_ppg";
const LABELS: [&str; 8] = ["light", "motion", "exercise", "skin_color", "gender", "glasser", "hair_cover", "makeup"];

fn wrong(place: &Place, reason: String) -> DataSetError {
    DataSetError::Damaged { path: place.video.clone(), reason }
}

/// Frames, rows and columns of a video.
fn size(array: &Array) -> Result<[usize; 3], String> {
    match (array.class, &array.dimensions[..]) {
        (Class::Numbers | Class::Bytes, &[frames, height, width, 3]) => Ok([frames, height, width]),
        (Class::Numbers | Class::Bytes, _) => {
            Err(format!("`{VIDEO}` has the size {:?}, not frames × rows × columns × 3", array.dimensions))
        }
        _ => Err(format!("`{VIDEO}` is not an array of numbers")),
    }
}

pub fn frames(place: &Place) -> Result<ArrayVideo, DataSetError> {
    let mut video = None;
    mat::each(&place.video, &mut |array, values| {
        if array.name != VIDEO {
            return Ok(());
        }
        let scale = if array.class == Class::Bytes { Scale::Bytes } else { Scale::Unit };
        let mut columns = Columns::new(size(array)?, scale)?;
        values.stream(&mut |numbers| Ok(columns.push(numbers)?))?;
        video = Some(columns.finish(DataSet::HERTZ)?);
        Ok(())
    })
    .map_err(|reason| wrong(place, reason))?;
    video.ok_or_else(|| wrong(place, format!("there is no variable `{VIDEO}` in it")))
}

/// Everything but the pictures.
#[derive(Default)]
struct Contents {
    frames: Option<usize>,
    pulse: Option<Vec<f64>>,
    labels: Vec<(String, String)>,
    /// Labels that are neither text nor a number.
    odd: Vec<String>,
}

fn contents(place: &Place) -> Result<Contents, DataSetError> {
    let mut contents = Contents::default();
    mat::each(&place.video, &mut |array, values| {
        let single = array.len() == Some(1);
        match (array.name.as_str(), array.class) {
            (VIDEO, _) => contents.frames = Some(size(array)?[0]),
            (PULSE, Class::Numbers | Class::Bytes) => contents.pulse = Some(values.numbers()?),
            (PULSE, _) => return Err(format!("`{PULSE}` is not an array of numbers")),
            (name, Class::Text) => {
                let rows = array.dimensions.first().copied().unwrap_or(1);
                contents.labels.push((name.to_owned(), values.text(rows)?));
            }
            (name, Class::Numbers | Class::Bytes) if single => {
                let number = values.numbers()?.first().copied().unwrap_or(f64::NAN);
                contents.labels.push((name.to_owned(), number.to_string()));
            }
            (name, _) if LABELS.contains(&name) => contents.odd.push(name.to_owned()),
            _ => {}
        }
        Ok(())
    })
    .map_err(|reason| wrong(place, reason))?;
    Ok(contents)
}

fn over_frames(place: &Place, contents: Contents) -> Result<Trace, DataSetError> {
    let missing = |what| DataSetError::Missing { path: place.video.clone(), what };
    let pulse = contents.pulse.ok_or_else(|| missing("variable `GT_ppg`"))?;
    let frames = contents.frames.ok_or_else(|| missing("variable `video`"))?;
    let times = times_over_frames(pulse.len(), frames, DataSet::HERTZ);
    Ok(Trace::new(&place.labels, times, pulse)?)
}

pub fn trace(place: &Place) -> Result<Trace, DataSetError> {
    over_frames(place, contents(place)?)
}

pub fn inspect(place: &Place, recording: &mut Recording) {
    let subject = place.video.parent().and_then(|folder| folder.file_name()).map(|name| name.to_string_lossy());
    let subject = subject.as_deref().and_then(|name| name.strip_prefix("subject")).map(str::to_owned);
    recording.labels.extend(subject.map(|subject| ("subject".to_owned(), subject)));
    match contents(place) {
        Ok(contents) => {
            (recording.frames, recording.hertz) = (contents.frames, Some(DataSet::HERTZ));
            recording.labels.extend(contents.labels.iter().cloned());
            let known = |name: &str| contents.labels.iter().any(|(label, _)| label == name);
            for name in LABELS.iter().filter(|name| !known(name)) {
                let odd = contents.odd.iter().any(|odd| odd == name);
                let why = if odd { " (neither text nor a number)" } else { "" };
                recording.missing.push(format!("label {name}{why}"));
            }
            match over_frames(place, contents) {
                Ok(trace) => recording.pulse(&trace),
                Err(error) => recording.missing.push(format!("pulse: {error}")),
            }
        }
        Err(error) => recording.missing.push(error.to_string()),
    }
}
