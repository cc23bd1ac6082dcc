//! Frames of a video, one at a time, with their true times.
//!
//! H.264 in MP4 is read and decoded here; so are uncompressed AVI, folders of pictures and the recordings of public data
//! sets ([`crate::dataset`]); everything else goes through the user's `ffmpeg`. A source holds a few frames, never the
//! clip. Frames come in display order with strictly increasing times, in seconds from the start of the recording; they are
//! sRGB-encoded RGB, upright. Uneven times stay as they are, unless an even rate is asked for.

mod ahead;
mod array;
mod avi;
mod bitmap;
mod bits;
mod boxes;
mod ffmpeg;
mod folder;
mod mp4;
mod picture;
mod resample;
mod retimed;
mod yuv;

use std::path::{Path, PathBuf};

pub use ahead::for_each_frame;
pub(crate) use array::{ArrayVideo, Columns, Scale};
pub(crate) use folder::{name, natural, pictures};

use heartian_space::Rgb8Image;
use resample::Resampling;

/// What can go wrong with reading a video.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// No such file or folder.
    #[error("{}: there is no such file or folder; give the path of a video, or of a folder of frames", path.display())]
    Missing {
        /// The path given.
        path: PathBuf,
    },
    /// The file is not a video this program or ffmpeg understands.
    #[error("{}: not a video ({reason}); give an MP4 or AVI file, or a folder of PNG, JPEG or EXR frames", path.display())]
    NotVideo {
        /// The path given.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
    /// The video has no frame, or none in the part asked for.
    #[error("{}: no frame at or after {start_seconds} s; choose an earlier start or another recording", path.display())]
    NoFrames {
        /// The path given.
        path: PathBuf,
        /// Where reading should have begun.
        start_seconds: f64,
    },
    /// The file ends before its last frame.
    #[error("{}: the file is cut short at frame {frame} ({reason}); copy it again from where it came", path.display())]
    Truncated {
        /// The path given.
        path: PathBuf,
        /// First frame that cannot be read.
        frame: usize,
        /// What is missing.
        reason: String,
    },
    /// A frame does not decode.
    #[error("{}: frame {frame} does not decode ({reason}); re-encode the video with `ffmpeg -i {} -c:v libx264 -pix_fmt yuv420p out.mp4`", path.display(), path.display())]
    Decode {
        /// The path given.
        path: PathBuf,
        /// Frame number.
        frame: usize,
        /// The decoder's words.
        reason: String,
    },
    /// The format needs ffmpeg and there is none.
    #[error("{}: {what} needs the `ffmpeg` program on PATH, which was not found; install ffmpeg, or convert the video to H.264 in MP4 elsewhere", path.display())]
    NeedsFfmpeg {
        /// The path given.
        path: PathBuf,
        /// The format.
        what: String,
    },
    /// A picture file is damaged, or none.
    #[error("{}: not a picture that is read ({reason}); replace or remove it", path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
    /// The header contradicts the frames.
    #[error("{}: frame {frame} is not what the header says ({reason}); convert it anew from where it came", path.display())]
    Header {
        /// The path given.
        path: PathBuf,
        /// Frame number.
        frame: usize,
        /// The contradiction.
        reason: String,
    },
    /// A recording of a data set is damaged.
    #[error(transparent)]
    DataSet(#[from] crate::dataset::DataSetError),
    /// Frames of different sizes.
    #[error("{}: the frame is {}×{} pixels where the ones before are {}×{}; all frames must have one size", path.display(), found.0, found.1, expected.0, expected.1)]
    FrameSize {
        /// The file.
        path: PathBuf,
        /// Width and height of the first frame.
        expected: (usize, usize),
        /// Width and height of this one.
        found: (usize, usize),
    },
    /// The list of frame times does not fit the frames.
    #[error("{}: {reason}", path.display())]
    Times {
        /// The times file.
        path: PathBuf,
        /// What is wrong and what to do.
        reason: String,
    },
    /// A file cannot be read.
    #[error("{}: {error}; check the path and that you may read it", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
}

/// One frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedFrame {
    /// Seconds from the start of the recording.
    pub seconds: f64,
    /// Its picture.
    pub image: Rgb8Image,
}

/// Frames one after another.
pub trait FrameSource {
    /// The next frame, or `None` after the last. After an error or `None` the source is at its end.
    ///
    /// # Errors
    /// When the file is cut short or damaged.
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError>;

    /// Frames from the start to the end, where the container tells.
    fn frame_count(&self) -> Option<usize>;

    /// What was doubtful so far and read all the same, for the user.
    fn notes(&self) -> &[String] {
        &[]
    }
}

/// Which part of a video to read, and at what rate frames without times run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoOptions {
    /// Frames before this time are passed over.
    pub start_seconds: f64,
    /// Rate of a folder of pictures without a file of times, hertz.
    pub folder_hertz: f64,
    /// Rate to which uneven frames are brought, hertz; as they are when left out.
    pub resample_hertz: Option<f64>,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self { start_seconds: 0.0, folder_hertz: 30.0, resample_hertz: None }
    }
}

/// A video opened for reading.
pub struct Video {
    frames: Increasing,
    resampling: Option<Resampling>,
}

/// Frames from the start asked for, of one size, at increasing times.
struct Increasing {
    path: PathBuf,
    source: Box<dyn FrameSource + Send>,
    start_seconds: f64,
    last: Option<(f64, (usize, usize))>,
    count: usize,
    /// Frames that did not come after the one before, and the first of them.
    backward: usize,
    notes: Vec<String>,
}

impl std::fmt::Debug for Video {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Video")
            .field("path", &self.frames.path)
            .field("count", &self.frames.count)
            .finish_non_exhaustive()
    }
}

/// Opens a video, or a recording of a data set, by what it is, not by its name.
///
/// # Errors
/// Missing, not a video, or a format that needs the `ffmpeg` program where there is none.
pub fn open(path: &Path, options: &VideoOptions) -> Result<Video, VideoError> {
    let source: Box<dyn FrameSource + Send> = match crate::dataset::locate(path) {
        Some(place) => crate::dataset::frames(&place)?,
        None => open_plain(path, options.start_seconds, options.folder_hertz)?,
    };
    let frames = Increasing {
        path: path.to_owned(),
        source,
        start_seconds: options.start_seconds,
        last: None,
        count: 0,
        backward: 0,
        notes: Vec::new(),
    };
    let resampling = options.resample_hertz.filter(|hertz| hertz.is_finite() && *hertz > 0.0).map(Resampling::new);
    Ok(Video { frames, resampling })
}

/// Opens a video file or a folder of pictures, whatever lies beside it.
pub(crate) fn open_plain(
    path: &Path,
    start_seconds: f64,
    folder_hertz: f64,
) -> Result<Box<dyn FrameSource + Send>, VideoError> {
    if path.is_dir() { Ok(Box::new(folder::Folder::open(path, folder_hertz)?)) } else { open_file(path, start_seconds) }
}

/// Gives a source's frames other times, one a frame.
pub(crate) fn retimed(source: Box<dyn FrameSource + Send>, times_seconds: Vec<f64>) -> Box<dyn FrameSource + Send> {
    Box::new(retimed::Retimed::new(source, times_seconds))
}

fn open_file(path: &Path, start_seconds: f64) -> Result<Box<dyn FrameSource + Send>, VideoError> {
    let head = head(path)?;
    let unsupported = match (head.get(0..4), head.get(4..8), head.get(8..12)) {
        (Some(b"RIFF"), _, Some(b"AVI ")) => match avi::Avi::open(path)? {
            Ok(source) => return Ok(Box::new(source)),
            Err(what) => what,
        },
        (_, Some(b"ftyp" | b"moov" | b"mdat" | b"wide" | b"free" | b"skip"), _) => {
            match mp4::Mp4::open(path, start_seconds)? {
                Ok(source) => return Ok(Box::new(source)),
                Err(what) => what,
            }
        }
        (Some([0x1a, 0x45, 0xdf, 0xa3]), ..) => "WebM or Matroska".to_owned(),
        _ => "this format".to_owned(),
    };
    Ok(Box::new(ffmpeg::Ffmpeg::open(path, &unsupported)?))
}

/// The first bytes of a file; an empty file is not a video.
fn head(path: &Path) -> Result<Vec<u8>, VideoError> {
    use std::io::Read;
    let wrong = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => VideoError::Missing { path: path.to_owned() },
        _ => VideoError::File { path: path.to_owned(), error },
    };
    let mut head = Vec::new();
    std::fs::File::open(path).map_err(wrong)?.take(64).read_to_end(&mut head).map_err(wrong)?;
    if head.is_empty() {
        return Err(VideoError::NotVideo { path: path.to_owned(), reason: "the file is empty".into() });
    }
    Ok(head)
}

impl Increasing {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        while let Some(frame) = self.source.next_frame()? {
            // Half a millisecond of slack: times are rounded by containers.
            if frame.seconds < self.start_seconds - 5e-4 {
                continue;
            }
            let size = (frame.image.width, frame.image.height);
            let (before, expected) = self.last.unwrap_or((f64::NEG_INFINITY, size));
            if size != expected {
                return Err(VideoError::FrameSize { path: self.path.clone(), expected, found: size });
            }
            if !(frame.seconds > before) {
                self.left_out(frame.seconds, before);
                continue;
            }
            self.last = Some((frame.seconds, size));
            self.count += 1;
            return Ok(Some(frame));
        }
        if self.count == 0 {
            return Err(VideoError::NoFrames { path: self.path.clone(), start_seconds: self.start_seconds });
        }
        Ok(None)
    }

    /// Remembers a frame that is not shown after the one before it.
    fn left_out(&mut self, seconds: f64, before: f64) {
        self.backward += 1;
        let others = if self.backward > 1 { format!(", and {} more so", self.backward - 1) } else { String::new() };
        let first = match self.notes.first() {
            Some(note) => note.split(", and ").next().unwrap_or_default().to_owned(),
            None => format!(
                "the frame after frame {} is timed {seconds:.3} s, not after its {before:.3} s; left out",
                self.count.saturating_sub(1)
            ),
        };
        self.notes = vec![first + &others];
    }
}

impl FrameSource for Video {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let Self { frames, resampling } = self;
        match resampling {
            Some(resampling) => resampling.next(|| frames.next_frame()),
            None => frames.next_frame(),
        }
    }

    fn frame_count(&self) -> Option<usize> {
        if self.resampling.is_some() { None } else { self.frames.source.frame_count() }
    }

    fn notes(&self) -> &[String] {
        &self.frames.notes
    }
}

impl Video {
    /// What was doubtful so far and read all the same: a line each, for the user.
    pub fn warnings(&self) -> Vec<String> {
        let resampling = self.resampling.iter().flat_map(|resampling| &resampling.notes);
        let notes = self.frames.source.notes().iter().chain(&self.frames.notes).chain(resampling);
        notes.map(|note| format!("{}: {note}", self.frames.path.display())).collect()
    }
}

/// Reads a damaged AVI to its end, whatever that is.
#[cfg(test)]
pub(crate) fn fuzz_avi(path: &Path) {
    if let Ok(Ok(mut source)) = avi::Avi::open(path) {
        while let Ok(Some(_)) = source.next_frame() {}
    }
}

#[cfg(test)]
mod tests;
