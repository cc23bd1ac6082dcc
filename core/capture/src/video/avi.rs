//! Uncompressed AVI: BGR24 or BGRX32 frames in RIFF chunks, bottom-up unless the height is negative, rows padded to four
//! bytes; files over a gigabyte continue in further `AVIX` lists. Other codings are left to ffmpeg.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use heartian_space::Rgb8Image;

use super::bitmap::{Bitmap, word};
use super::{FrameSource, TimedFrame, VideoError};

/// Frame intervals that a recording can have, seconds.
const SHORTEST_FRAME: f64 = 1e-4;
const LONGEST_FRAME: f64 = 60.0;

/// The picture format and rate.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Header {
    stream: u8,
    bitmap: Bitmap,
    seconds_per_frame: f64,
    frames: usize,
}

/// An uncompressed AVI at its next chunk.
pub(super) struct Avi {
    path: PathBuf,
    reader: BufReader<File>,
    length: u64,
    header: Header,
    frame: usize,
}

impl Avi {
    /// Opens a file; the inner error names a coding that needs ffmpeg.
    pub fn open(path: &Path) -> Result<Result<Self, String>, VideoError> {
        let io = |error| VideoError::File { path: path.to_owned(), error };
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut reader = BufReader::with_capacity(1 << 18, file);
        let mut head = vec![0; (1 << 16).min(length as usize)];
        reader.read_exact(&mut head).map_err(io)?;
        let header = match parse_header(&head) {
            Ok(Ok(header)) => header,
            Ok(Err(coding)) => return Ok(Err(coding)),
            Err(reason) => return Err(VideoError::NotVideo { path: path.to_owned(), reason: reason.to_owned() }),
        };
        reader.seek(SeekFrom::Start(12)).map_err(io)?;
        Ok(Ok(Self { path: path.to_owned(), reader, length, header, frame: 0 }))
    }

    /// Finds the next picture's chunk and returns its size; lists are entered, other chunks passed over.
    fn next_chunk(&mut self) -> std::io::Result<Option<u64>> {
        loop {
            let at = self.reader.stream_position()?;
            if at + 8 > self.length {
                return Ok(None);
            }
            let mut head = [0; 8];
            self.reader.read_exact(&mut head)?;
            let size = u64::from(word(&head, 4).unwrap_or(0));
            let tag = [head[0], head[1], head[2], head[3]];
            let stream = |digits: [u8; 2]| digits == [b'0' + self.header.stream / 10, b'0' + self.header.stream % 10];
            match tag {
                // A list's content follows its four-letter name.
                [b'R', b'I', b'F', b'F'] => {
                    self.reader.seek_relative(4)?;
                }
                [b'L', b'I', b'S', b'T'] => {
                    let mut name = [0; 4];
                    self.reader.read_exact(&mut name)?;
                    if &name != b"movi" && &name != b"rec " {
                        self.skip(at + 8 + size, size)?;
                    }
                }
                [a, b, b'd', b'b' | b'c'] if stream([a, b]) => return Ok(Some(size)),
                _ => self.skip(at + 8 + size, size)?,
            }
        }
    }

    /// Passes over a chunk's content and its padding.
    fn skip(&mut self, end: u64, size: u64) -> std::io::Result<()> {
        let to = end.saturating_add(size % 2).min(self.length);
        self.reader.seek(SeekFrom::Start(to)).map(drop)
    }

    fn picture(&mut self, size: u64) -> Result<Rgb8Image, VideoError> {
        let bitmap = self.header.bitmap;
        let (path, frame) = (self.path.clone(), self.frame);
        let wrong = |reason: String| VideoError::Truncated { path: path.clone(), frame, reason };
        let needed = bitmap.bytes() as u64;
        let at = self.reader.stream_position().map_err(|error| wrong(error.to_string()))?;
        if at.saturating_add(size) > self.length {
            return Err(wrong("its data lie beyond the end of the file".into()));
        }
        if size != needed {
            let (width, height) = (bitmap.width, bitmap.height);
            let reason = format!("it has {size} bytes where a picture of {width}×{height} has {needed}");
            return Err(VideoError::Header { path, frame, reason });
        }
        let mut bytes = vec![0; needed as usize];
        self.reader.read_exact(&mut bytes).map_err(|error| wrong(error.to_string()))?;
        self.skip(at + size, size).map_err(|error| wrong(error.to_string()))?;
        bitmap.picture(&bytes).ok_or_else(|| wrong("the picture is cut short".into()))
    }
}

/// Walks the header list for the first video stream.
fn parse_header(head: &[u8]) -> Result<Result<Header, String>, &'static str> {
    let (mut at, mut streams) = (12usize, 0u8);
    let (mut video, mut rate, mut frames) = (false, None, 0);
    while let (Some(tag), Some(size)) = (head.get(at..at + 4), word(head, at + 4)) {
        let body = at + 8;
        match tag {
            b"LIST" => {
                if head.get(body..body + 4) == Some(b"movi") {
                    break;
                }
                at = body + 4;
                continue;
            }
            b"strh" => {
                video = head.get(body..body + 4) == Some(b"vids");
                let (scale, per) = (word(head, body + 20).unwrap_or(0), word(head, body + 24).unwrap_or(0));
                rate = (scale > 0 && per > 0).then(|| f64::from(scale) / f64::from(per));
                frames = word(head, body + 32).unwrap_or(0) as usize;
                streams = streams.saturating_add(1);
            }
            b"strf" if video => {
                let seconds_per_frame = rate.ok_or("its frame rate is zero")?;
                if !(SHORTEST_FRAME..=LONGEST_FRAME).contains(&seconds_per_frame) {
                    return Err("its frame rate is absurd");
                }
                let stream = streams.saturating_sub(1);
                let header = |bitmap| Header { stream, bitmap, seconds_per_frame, frames };
                let unsupported = |coding| format!("AVI video coded as `{coding}`");
                return Ok(Bitmap::parse(head, body)?.map(header).map_err(unsupported));
            }
            _ => {}
        }
        let padded = (size as usize).saturating_add(size as usize % 2);
        at = body.saturating_add(padded);
    }
    Err("it has no video stream")
}

impl FrameSource for Avi {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        loop {
            let chunk = self.next_chunk().map_err(|error| VideoError::File { path: self.path.clone(), error })?;
            let Some(size) = chunk else {
                return if self.frame < self.header.frames && self.header.frames != u32::MAX as usize {
                    let reason = format!("{} frames announced", self.header.frames);
                    Err(VideoError::Truncated { path: self.path.clone(), frame: self.frame, reason })
                } else {
                    Ok(None)
                };
            };
            let seconds = self.frame as f64 * self.header.seconds_per_frame;
            // An empty chunk is a dropped frame: time passes, and no picture is made up for it.
            let image = (size > 0).then(|| self.picture(size)).transpose()?;
            self.frame += 1;
            if let Some(image) = image {
                return Ok(Some(TimedFrame { seconds, image }));
            }
        }
    }

    fn frame_count(&self) -> Option<usize> {
        (self.header.frames != u32::MAX as usize).then_some(self.header.frames)
    }
}
