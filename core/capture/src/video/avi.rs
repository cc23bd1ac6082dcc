//! Uncompressed AVI: BGR24 or BGRX32 frames in RIFF chunks, bottom-up unless the height is negative, rows padded to four
//! bytes; files over a gigabyte continue in further `AVIX` lists. Other codings are left to ffmpeg.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use heartian_space::Rgb8Image;

use super::{FrameSource, TimedFrame, VideoError};

/// The picture format and rate.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Header {
    stream: u8,
    width: usize,
    height: usize,
    bottom_up: bool,
    bytes_per_pixel: usize,
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
    last: Option<Rgb8Image>,
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
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
        Ok(Ok(Self { path: path.to_owned(), reader, length, header, frame: 0, last: None }))
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
                        self.skip(size.saturating_sub(4), at + 8 + size)?;
                    }
                }
                [a, b, b'd', b'b' | b'c'] if stream([a, b]) => return Ok(Some(size)),
                _ => self.skip(size, at + 8 + size)?,
            }
        }
    }

    /// Passes over a chunk's content and its padding.
    fn skip(&mut self, size: u64, end: u64) -> std::io::Result<()> {
        let to = end.saturating_add(size % 2).min(self.length);
        self.reader.seek(SeekFrom::Start(to)).map(drop)
    }

    fn picture(&mut self, size: u64) -> Result<Option<Rgb8Image>, VideoError> {
        let Header { width, height, bottom_up, bytes_per_pixel, .. } = self.header;
        if size == 0 {
            // An empty chunk repeats the picture before it.
            return Ok(self.last.clone());
        }
        let stride = (width * bytes_per_pixel).next_multiple_of(4);
        let (path, frame) = (self.path.clone(), self.frame);
        let wrong = |reason: String| VideoError::Truncated { path: path.clone(), frame, reason };
        let needed = (stride * height) as u64;
        let at = self.reader.stream_position().map_err(|error| wrong(error.to_string()))?;
        if size < needed {
            return Err(wrong(format!("{size} bytes where a picture has {needed}")));
        }
        if at.saturating_add(size) > self.length {
            return Err(wrong("its data lie beyond the end of the file".into()));
        }
        let mut bytes = vec![0; needed as usize];
        self.reader.read_exact(&mut bytes).map_err(|error| wrong(error.to_string()))?;
        self.skip(size - needed, at + size).map_err(|error| wrong(error.to_string()))?;
        let mut data = Vec::with_capacity(width * height * 3);
        for row in 0..height {
            let from = if bottom_up { height - 1 - row } else { row } * stride;
            let pixels = bytes[from..from + width * bytes_per_pixel].chunks_exact(bytes_per_pixel);
            data.extend(pixels.flat_map(|p| [p[2], p[1], p[0]]));
        }
        Ok(Some(Rgb8Image { width, height, data }))
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
                return parse_format(head, body).map(|format| {
                    format.map(|header| Header {
                        stream: streams.saturating_sub(1),
                        seconds_per_frame,
                        frames,
                        ..header
                    })
                });
            }
            _ => {}
        }
        let padded = (size as usize).saturating_add(size as usize % 2);
        at = body.saturating_add(padded);
    }
    Err("it has no video stream")
}

/// A bitmap header (BITMAPINFOHEADER).
fn parse_format(head: &[u8], at: usize) -> Result<Result<Header, String>, &'static str> {
    let field = |offset: usize| word(head, at + offset).ok_or("its picture format is cut short");
    let (width, height, depth, coding) = (field(4)? as i32, field(8)? as i32, field(12)? >> 16, field(16)?);
    let name = coding.to_le_bytes();
    if coding != 0 && &name != b"DIB " || !matches!(depth, 24 | 32) {
        let name = if coding == 0 { format!("raw {depth}-bit") } else { String::from_utf8_lossy(&name).into_owned() };
        return Ok(Err(format!("AVI video coded as `{name}`")));
    }
    let side = |value: i32| usize::try_from(value.unsigned_abs()).ok().filter(|side| (1..=16384).contains(side));
    let (Some(pixels), Some(rows), true) = (side(width), side(height), width > 0) else {
        return Err("its picture size is absurd");
    };
    Ok(Ok(Header {
        stream: 0,
        width: pixels,
        height: rows,
        bottom_up: height > 0,
        bytes_per_pixel: depth as usize / 8,
        seconds_per_frame: 0.0,
        frames: 0,
    }))
}

impl FrameSource for Avi {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let chunk = self.next_chunk().map_err(|error| VideoError::File { path: self.path.clone(), error })?;
        let Some(size) = chunk else {
            return if self.frame < self.header.frames && self.header.frames != u32::MAX as usize {
                let reason = format!("{} frames announced", self.header.frames);
                Err(VideoError::Truncated { path: self.path.clone(), frame: self.frame, reason })
            } else {
                Ok(None)
            };
        };
        let Some(image) = self.picture(size)? else {
            self.frame += 1;
            return self.next_frame();
        };
        let seconds = self.frame as f64 * self.header.seconds_per_frame;
        self.frame += 1;
        self.last = Some(image.clone());
        Ok(Some(TimedFrame { seconds, image }))
    }

    fn frame_count(&self) -> Option<usize> {
        Some(self.header.frames)
    }
}
