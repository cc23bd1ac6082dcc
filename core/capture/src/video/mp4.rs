//! H.264 in MP4: samples are decoded one by one and put into display order by the container's times.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use rusty_h264_decoder::{DecodeError, Decoder};

use super::boxes::{Sample, Track, read_track};
use super::yuv::{Encoding, Planes, rgb_from_yuv, turned};
use super::{FrameSource, TimedFrame, VideoError, bits};
use crate::guard::guarded;

/// No H.264 stream holds back more pictures than its largest reference buffer.
const MOST_WAITING: usize = 32;

/// A decoder and its place in the file.
pub(super) struct Mp4 {
    path: PathBuf,
    file: File,
    length: u64,
    track: Track,
    encoding: Encoding,
    /// Bytes of the length before each NAL unit.
    length_bytes: usize,
    decoder: Decoder,
    /// Next sample to decode.
    next: usize,
    /// Display times still to come, in order; a picture leaves when its time is first.
    schedule: std::vec::IntoIter<i64>,
    waiting: BTreeMap<i64, Option<Picture>>,
    notes: Vec<String>,
}

impl Mp4 {
    /// Opens a file at the last sync sample before `start_seconds`; the inner error names a format that needs ffmpeg.
    pub fn open(path: &Path, start_seconds: f64) -> Result<Result<Self, String>, VideoError> {
        let io = |error| VideoError::File { path: path.to_owned(), error };
        let mut file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let track = read_track(&mut file).map_err(|reason| VideoError::NotVideo { path: path.to_owned(), reason })?;
        if track.samples.is_empty() {
            return Err(VideoError::NoFrames { path: path.to_owned(), start_seconds: 0.0 });
        }
        if !matches!(&track.coding, b"avc1" | b"avc3") {
            let coding = String::from_utf8_lossy(&track.coding).into_owned();
            return Ok(Err(format!("video coded as `{coding}`")));
        }
        let Some(configuration) = Configuration::parse(&track.configuration) else {
            let reason = "its H.264 configuration is damaged".to_owned();
            return Err(VideoError::NotVideo { path: path.to_owned(), reason });
        };
        let format = configuration.parameter_sets.first().and_then(|sps| bits::format(sps));
        if let Some(format) = format
            && (format.chroma_format != 1 || format.bit_depth != 8)
        {
            return Ok(Err("H.264 with other than 8-bit 4:2:0 samples".into()));
        }
        let unspecified = Encoding { matrix: 2, full_range: format.is_some_and(|format| format.full_range) };
        let named = format.map(|format| Encoding { matrix: format.matrix, ..unspecified });
        let encoding = named.filter(|encoding| encoding.matrix != 2).or(track.encoding).unwrap_or(unspecified);
        let note = track.moved.map(|(sample, ticks)| {
            let seconds = ticks as f64 / f64::from(track.ticks_per_second);
            format!("frame {sample}: it is timed {seconds:.3} s like another; such frames were moved on by a tick")
        });
        let mut mp4 = Self {
            path: path.to_owned(),
            file,
            length,
            encoding,
            length_bytes: configuration.length_bytes,
            decoder: Decoder::new(),
            next: 0,
            schedule: Vec::new().into_iter(),
            waiting: BTreeMap::new(),
            notes: note.into_iter().collect(),
            track,
        };
        mp4.seek(start_seconds);
        mp4.prime(&configuration)
    }

    /// Starts at the last sync sample shown no later than a time.
    fn seek(&mut self, start_seconds: f64) {
        let ticks = (start_seconds * f64::from(self.track.ticks_per_second)) as i64;
        let syncs = self.track.samples.iter().enumerate().filter(|(_, sample)| sample.is_sync && sample.shown <= ticks);
        self.next = syncs.map(|(index, _)| index).next_back().unwrap_or(0);
        // Pictures shown before the sync sample but coded after it lean on pictures we did not decode.
        let first = self.track.samples.get(self.next).map_or(0, |sample| sample.shown).max(0);
        let first = if self.next == 0 { 0 } else { first };
        let mut schedule: Vec<i64> =
            self.track.samples[self.next..].iter().map(|s| s.shown).filter(|shown| *shown >= first).collect();
        schedule.sort_unstable();
        self.schedule = schedule.into_iter();
    }

    /// Decodes the first picture, so that a stream we cannot decode is known when opening.
    fn prime(mut self, configuration: &Configuration) -> Result<Result<Self, String>, VideoError> {
        let mut head = Vec::new();
        for set in &configuration.parameter_sets {
            head.extend_from_slice(&[0, 0, 0, 1]);
            head.extend_from_slice(set);
        }
        let first = self.next;
        let sets = decode(&mut self.decoder, &head).err();
        let unsupported = |problem: &Problem| match problem {
            Problem::Unsupported(what) => Some(format!("H.264 with {what}")),
            Problem::Damaged(_) => None,
        };
        if let Some(what) = sets.as_ref().and_then(unsupported) {
            return Ok(Err(what));
        }
        match self.step() {
            Ok(_) => Ok(Ok(self)),
            Err(Stop::Decode(problem)) => match unsupported(&problem) {
                Some(what) => Ok(Err(what)),
                None => Err(self.damaged(first, problem)),
            },
            Err(Stop::Video(error)) => Err(error),
        }
    }

    fn damaged(&self, frame: usize, problem: Problem) -> VideoError {
        let (Problem::Damaged(reason) | Problem::Unsupported(reason)) = problem;
        VideoError::Decode { path: self.path.clone(), frame, reason }
    }

    /// Decodes one sample into `waiting`; false at the end of the file.
    fn step(&mut self) -> Result<bool, Stop> {
        let Some(&sample) = self.track.samples.get(self.next) else { return Ok(false) };
        let number = self.next;
        self.next += 1;
        let unit = self.access_unit(&sample, number).map_err(Stop::Video)?;
        let picture = decode(&mut self.decoder, &unit).map_err(Stop::Decode)?;
        self.waiting.insert(sample.shown, picture);
        Ok(true)
    }

    /// A sample's NAL units, with start codes in place of lengths.
    fn access_unit(&mut self, sample: &Sample, number: usize) -> Result<Vec<u8>, VideoError> {
        let truncated =
            |reason: &str| VideoError::Truncated { path: self.path.clone(), frame: number, reason: reason.into() };
        if sample.offset.saturating_add(u64::from(sample.size)) > self.length {
            return Err(truncated("its data lie beyond the end of the file"));
        }
        let mut bytes = vec![0; sample.size as usize];
        self.file
            .seek(SeekFrom::Start(sample.offset))
            .and_then(|_| self.file.read_exact(&mut bytes))
            .map_err(|error| VideoError::File { path: self.path.clone(), error })?;
        let mut unit = Vec::with_capacity(bytes.len() + 16);
        let mut rest = bytes.as_slice();
        while let Some((prefix, tail)) = rest.split_at_checked(self.length_bytes) {
            let size = prefix.iter().fold(0usize, |size, byte| size << 8 | usize::from(*byte));
            let Some((nal, tail)) = tail.split_at_checked(size) else {
                return Err(truncated("a unit is longer than its sample"));
            };
            unit.extend_from_slice(&[0, 0, 0, 1]);
            unit.extend_from_slice(nal);
            rest = tail;
        }
        Ok(unit)
    }
}

/// Why a sample gave no picture.
enum Problem {
    Unsupported(String),
    Damaged(String),
}

enum Stop {
    Decode(Problem),
    Video(VideoError),
}

/// Runs the decoder; a panic in it (arithmetic on a damaged stream) counts as damage.
fn decode(decoder: &mut Decoder, unit: &[u8]) -> Result<Option<Picture>, Problem> {
    match guarded(|| decoder.decode(unit)) {
        Some(Ok(Some(picture))) => {
            Ok(Some(Picture { width: picture.width, height: picture.height, y: picture.y, u: picture.u, v: picture.v }))
        }
        Some(Ok(None)) => Ok(None),
        Some(Err(DecodeError::Unsupported(what))) => Err(Problem::Unsupported(what.to_owned())),
        Some(Err(error)) => Err(Problem::Damaged(error.to_string())),
        None => Err(Problem::Damaged("the decoder gave up".into())),
    }
}

/// A decoded picture's planes, 4:2:0.
pub(super) struct Picture {
    pub width: usize,
    pub height: usize,
    pub y: Vec<u8>,
    pub u: Vec<u8>,
    pub v: Vec<u8>,
}

/// The H.264 configuration record (ISO/IEC 14496-15, 5.3.3.1).
struct Configuration {
    length_bytes: usize,
    /// Sequence parameter sets, then picture parameter sets.
    parameter_sets: Vec<Vec<u8>>,
}

impl Configuration {
    fn parse(record: &[u8]) -> Option<Self> {
        let length_bytes = usize::from(record.get(4)? & 3) + 1;
        let (mut at, mut parameter_sets) = (5, Vec::new());
        for mask in [0x1f, 0xff] {
            let count = record.get(at)? & mask;
            at += 1;
            for _ in 0..count {
                let length = usize::from(u16::from_be_bytes([*record.get(at)?, *record.get(at + 1)?]));
                parameter_sets.push(record.get(at + 2..at + 2 + length)?.to_vec());
                at += 2 + length;
            }
        }
        Some(Self { length_bytes, parameter_sets })
    }
}

impl Mp4 {
    /// The next picture in display order and its time in ticks.
    pub(super) fn next_picture(&mut self) -> Result<Option<(i64, Picture)>, VideoError> {
        while let Some(&shown) = self.schedule.as_slice().first() {
            while !self.waiting.contains_key(&shown) {
                let number = self.next;
                match self.step() {
                    Ok(true) => {}
                    Ok(false) => return Ok(None),
                    Err(Stop::Video(error)) => return Err(error),
                    Err(Stop::Decode(problem)) => return Err(self.damaged(number, problem)),
                }
                if self.waiting.len() > MOST_WAITING {
                    return Err(self.damaged(number, Problem::Damaged("its pictures are out of order".into())));
                }
            }
            self.schedule.next();
            let picture = self.waiting.remove(&shown).flatten();
            // Pictures before the one due were shown before the start.
            self.waiting = self.waiting.split_off(&shown);
            if let Some(picture) = picture
                && shown >= 0
            {
                return Ok(Some((shown, picture)));
            }
        }
        Ok(None)
    }
}

impl FrameSource for Mp4 {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let Some((shown, picture)) = self.next_picture()? else { return Ok(None) };
        let Picture { width, height, y, u, v } = &picture;
        let planes = Planes { width: *width, height: *height, y, u, v };
        let Some(image) = rgb_from_yuv(&planes, self.encoding) else {
            return Err(self.damaged(self.next, Problem::Damaged("the picture is too small".into())));
        };
        let seconds = shown as f64 / f64::from(self.track.ticks_per_second);
        Ok(Some(TimedFrame { seconds, image: turned(image, self.track.quarter_turns) }))
    }

    fn frame_count(&self) -> Option<usize> {
        Some(self.track.samples.len())
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}
