//! Recordings of public data sets, as their owners hand them out: UBFC-rPPG (second data set), PURE, MMPD, SCAMPS, iBVP.
//!
//! A recording is recognised by its place and its first bytes, never by what someone says it is. Its frames come through
//! [`crate::video::open`] with their true times where the data set keeps them; its contact PPG lies on the same clock, in
//! seconds from the first frame. Samples that are no number, and stretches the data set itself marks as bad, are holes in
//! the trace: reported, never filled here. Labels keep the data set's own words.

mod hdf5;
mod ibvp;
mod index;
mod mat;
mod mmpd;
mod pure;
mod scamps;
mod ubfc;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

pub use index::{Recording, list};

use crate::ppg::Trace;
use crate::video::{FrameSource, VideoError};

/// Largest file of labels that is read, bytes: an hour of PURE is below.
const LARGEST_LABELS: u64 = 1 << 26;

/// What can be wrong with a recording of a data set.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataSetError {
    /// A file or folder cannot be read.
    #[error("{}: {error}; check the path and that you may read it", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A file is not what the data set's layout says.
    #[error("{}: {reason}; fetch it again from the data set's owners", path.display())]
    Damaged {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A part of the recording is not there.
    #[error("{}: there is no {what}; fetch it again from the data set's owners", path.display())]
    Missing {
        /// The recording.
        path: PathBuf,
        /// Which part.
        what: &'static str,
    },
    /// The pulse cannot be used.
    #[error(transparent)]
    Ppg(#[from] crate::ppg::PpgError),
    /// A video of a size that no recording has.
    #[error("{frames} frames of {width}×{height} pixels is no size of a recording")]
    Absurd {
        /// Number of frames claimed.
        frames: usize,
        /// Width claimed, pixels.
        width: usize,
        /// Height claimed, pixels.
        height: usize,
    },
    /// A video has more or fewer values than its size says.
    #[error("the video has {} values than its size says", if *more { "more" } else { "fewer" })]
    Count {
        /// More, rather than fewer.
        more: bool,
    },
    /// A value of a video is no brightness.
    #[error("frame {frame} holds the value {value}, where brightness runs from 0 to {most}")]
    Brightness {
        /// Frame number.
        frame: usize,
        /// The value.
        value: f64,
        /// White.
        most: u32,
    },
    /// The temporary folder is full or cannot be written.
    #[error(
        "the frames cannot be laid out in the temporary folder ({0}); make room there, or name another with TMPDIR"
    )]
    Temporary(std::io::Error),
}

impl From<DataSetError> for String {
    fn from(error: DataSetError) -> Self {
        error.to_string()
    }
}

/// A data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub enum DataSet {
    /// UBFC-rPPG, second data set: `subjectN/vid.avi`, `ground_truth.txt`.
    #[serde(rename = "UBFC-rPPG")]
    Ubfc,
    /// PURE: `SS-TT/SS-TT/*.png`, `SS-TT.json`.
    #[serde(rename = "PURE")]
    Pure,
    /// MMPD: `subjectN/pN_k.mat` (version 5).
    #[serde(rename = "MMPD")]
    Mmpd,
    /// SCAMPS: `*.mat` (version 7.3).
    #[serde(rename = "SCAMPS")]
    Scamps,
    /// iBVP: `pXX_y/pXX_y_rgb/*.bmp`, `pXX_y_bvp.csv`.
    #[serde(rename = "iBVP")]
    Ibvp,
}

impl DataSet {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ubfc => "UBFC-rPPG",
            Self::Pure => "PURE",
            Self::Mmpd => "MMPD",
            Self::Scamps => "SCAMPS",
            Self::Ibvp => "iBVP",
        }
    }

    /// Frame rate of sets that keep no times, hertz.
    const HERTZ: f64 = 30.0;
}

/// Where the parts of one recording lie.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// Which data set.
    pub set: DataSet,
    /// The recording's name within it.
    pub name: String,
    /// The video: a file, or a folder of frames.
    pub video: PathBuf,
    /// The file with the pulse; it may be missing.
    pub labels: PathBuf,
}

/// The recording that a path names, when it is one of a data set: its folder, its video file or its frames' folder. Looks
/// at names and at the first bytes of `.mat` files only.
pub fn locate(path: &Path) -> Option<Place> {
    if path.is_dir() {
        ubfc::locate(path).or_else(|| pure::locate(path)).or_else(|| ibvp::locate(path))
    } else {
        ubfc::locate(path).or_else(|| locate_mat(path))
    }
}

fn locate_mat(path: &Path) -> Option<Place> {
    if !path.extension()?.eq_ignore_ascii_case("mat") {
        return None;
    }
    let mut head = Vec::new();
    File::open(path).ok()?.take(1024).read_to_end(&mut head).ok()?;
    let set = match () {
        () if hdf5::is_hdf5(&head) => DataSet::Scamps,
        () if mat::is_mat(&head) => DataSet::Mmpd,
        () => return None,
    };
    let name = path.file_stem()?.to_string_lossy().into_owned();
    Some(Place { set, name, video: path.to_owned(), labels: path.to_owned() })
}

/// The frames of a recording.
pub(crate) fn frames(place: &Place) -> Result<Box<dyn FrameSource + Send>, VideoError> {
    match place.set {
        DataSet::Ubfc => ubfc::frames(place),
        DataSet::Pure => pure::frames(place),
        DataSet::Mmpd => Ok(Box::new(mmpd::frames(place)?)),
        DataSet::Scamps => Ok(Box::new(scamps::frames(place)?)),
        DataSet::Ibvp => ibvp::frames(place),
    }
}

/// The contact PPG of a recording, on the clock of its frames.
///
/// # Errors
/// When there is none, or it is damaged.
pub fn trace(place: &Place) -> Result<Trace, DataSetError> {
    if !place.labels.is_file() {
        let path = place.labels.clone();
        return Err(DataSetError::Missing { path, what: "file with the pulse" });
    }
    match place.set {
        DataSet::Ubfc => ubfc::trace(place),
        DataSet::Pure => pure::trace(place),
        DataSet::Mmpd => mmpd::trace(place),
        DataSet::Scamps => scamps::trace(place),
        DataSet::Ibvp => ibvp::trace(place),
    }
}

/// A text file of labels.
fn read_text(path: &Path) -> Result<String, DataSetError> {
    let io = |error| DataSetError::File { path: path.to_owned(), error };
    let file = File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    file.take(LARGEST_LABELS + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > LARGEST_LABELS {
        let reason = format!("it is longer than {LARGEST_LABELS} bytes");
        return Err(DataSetError::Damaged { path: path.to_owned(), reason });
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Times of samples that a data set lays over its frames by number alone: the first on the first frame, the last on the
/// last, evenly, as every reader of the set does.
fn times_over_frames(samples: usize, frames: usize, hertz: f64) -> Vec<f64> {
    let span = frames.saturating_sub(1) as f64 / hertz;
    let step = span / samples.saturating_sub(1).max(1) as f64;
    (0..samples).map(|k| k as f64 * step).collect()
}

#[cfg(test)]
mod tests;
