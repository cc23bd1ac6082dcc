//! SCAMPS: `*.mat`, MATLAB version 7.3. `Xsub` is `T×H×W×3` in 0–1, `d_ppg` the pulse, one sample a frame; 30 frames a second.

use super::hdf5::Hdf5;
use super::{DataSet, DataSetError, Place, Recording, times_over_frames};
use crate::ppg::Trace;
use crate::video::{ArrayVideo, Columns, Scale};

const VIDEO: &str = "Xsub";
const PULSE: &str = "d_ppg";

fn wrong(place: &Place, reason: String) -> DataSetError {
    DataSetError::Damaged { path: place.video.clone(), reason }
}

/// Frames, rows and columns; HDF5 has MATLAB's axes from last to first.
fn size(file: &Hdf5) -> Result<[usize; 3], String> {
    let shape = file.shape(VIDEO)?;
    match shape[..] {
        [3, width, height, frames] => Ok([frames, height, width]),
        _ => Err(format!("`{VIDEO}` has the size {shape:?} (last axis first), not frames × rows × columns × 3")),
    }
}

pub fn frames(place: &Place) -> Result<ArrayVideo, DataSetError> {
    let read = || -> Result<ArrayVideo, String> {
        let file = Hdf5::open(&place.video)?;
        let scale = if file.is_bytes(VIDEO)? { Scale::Bytes } else { Scale::Unit };
        let mut columns = Columns::new(size(&file)?, scale)?;
        for channel in 0..3 {
            file.row::<String>(VIDEO, channel, &mut |values| Ok(columns.push(values)?))?;
        }
        Ok(columns.finish(DataSet::HERTZ)?)
    };
    read().map_err(|reason| wrong(place, reason))
}

pub fn trace(place: &Place) -> Result<Trace, DataSetError> {
    let read = || {
        let file = Hdf5::open(&place.video)?;
        Ok((size(&file)?[0], file.numbers(PULSE)?))
    };
    let (frames, pulse) = read().map_err(|reason| wrong(place, reason))?;
    Ok(Trace::new(&place.labels, times_over_frames(pulse.len(), frames, DataSet::HERTZ), pulse)?)
}

pub fn inspect(place: &Place, recording: &mut Recording) {
    let read = || -> Result<usize, String> {
        let file = Hdf5::open(&place.video)?;
        let names = file.names()?;
        if !names.iter().any(|name| name == VIDEO) {
            return Err(format!("there is no variable `{VIDEO}` among {names:?}"));
        }
        Ok(size(&file)?[0])
    };
    match read() {
        Ok(frames) => (recording.frames, recording.hertz) = (Some(frames), Some(DataSet::HERTZ)),
        Err(reason) => recording.missing.push(format!("video: {reason}")),
    }
    recording.trace_of(place);
}
