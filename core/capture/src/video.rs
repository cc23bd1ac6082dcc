//! Frames of a video, one at a time, with their true times.
//!
//! H.264 in MP4 is read and decoded here; so are folders of PNGs and uncompressed AVI; everything else goes through the
//! user's `ffmpeg`. A source holds a few frames, never the clip. Frames come in display order with strictly increasing
//! times, in seconds from the start of the recording; they are sRGB-encoded RGB, upright.

mod ahead;
mod avi;
mod bits;
mod boxes;
mod ffmpeg;
mod mp4;
mod png_folder;
mod yuv;

use std::path::{Path, PathBuf};

pub use ahead::for_each_frame;

use heartian_space::Rgb8Image;

/// What can go wrong with reading a video.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// No such file or folder.
    #[error("{}: there is no such file or folder; give the path of a video, or of a folder of PNG frames", path.display())]
    Missing {
        /// The path given.
        path: PathBuf,
    },
    /// The file is not a video this program or ffmpeg understands.
    #[error("{}: not a video ({reason}); give an MP4 or AVI file, or a folder of PNG frames", path.display())]
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
}

/// Which part of a video to read, and at what rate frames without times run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoOptions {
    /// Frames before this time are passed over.
    pub start_seconds: f64,
    /// Rate of a folder of PNGs without a file of times, hertz.
    pub folder_hertz: f64,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self { start_seconds: 0.0, folder_hertz: 30.0 }
    }
}

/// A video opened for reading.
pub struct Video {
    path: PathBuf,
    source: Box<dyn FrameSource + Send>,
    start_seconds: f64,
    last: Option<(f64, (usize, usize))>,
    count: usize,
}

impl std::fmt::Debug for Video {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Video").field("path", &self.path).field("count", &self.count).finish_non_exhaustive()
    }
}

/// Opens a video by what it is, not by its name.
///
/// # Errors
/// Missing, not a video, or a format that needs the `ffmpeg` program where there is none.
pub fn open(path: &Path, options: &VideoOptions) -> Result<Video, VideoError> {
    let source: Box<dyn FrameSource + Send> = if path.is_dir() {
        Box::new(png_folder::PngFolder::open(path, options.folder_hertz)?)
    } else {
        open_file(path, options)?
    };
    Ok(Video { path: path.to_owned(), source, start_seconds: options.start_seconds, last: None, count: 0 })
}

fn open_file(path: &Path, options: &VideoOptions) -> Result<Box<dyn FrameSource + Send>, VideoError> {
    let head = head(path)?;
    let unsupported = match (head.get(0..4), head.get(4..8), head.get(8..12)) {
        (Some(b"RIFF"), _, Some(b"AVI ")) => match avi::Avi::open(path)? {
            Ok(source) => return Ok(Box::new(source)),
            Err(what) => what,
        },
        (_, Some(b"ftyp" | b"moov" | b"mdat" | b"wide" | b"free" | b"skip"), _) => {
            match mp4::Mp4::open(path, options.start_seconds)? {
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

impl FrameSource for Video {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        while let Some(frame) = self.source.next_frame()? {
            // Half a millisecond of slack: times are rounded by containers.
            if frame.seconds < self.start_seconds - 5e-4 {
                continue;
            }
            let size = (frame.image.width, frame.image.height);
            if let Some((before, expected)) = self.last {
                if size != expected {
                    return Err(VideoError::FrameSize { path: self.path.clone(), expected, found: size });
                }
                if frame.seconds <= before {
                    continue;
                }
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

    fn frame_count(&self) -> Option<usize> {
        self.source.frame_count()
    }
}

#[cfg(test)]
mod tests;
