//! Everything else, through the user's `ffmpeg`: pictures come as PPM over one pipe, their true times over another.
//!
//! ffmpeg turns pictures upright by the file's own flags, and converts 10-bit, full-range, BT.709 and BT.2020 video by what
//! the stream says of itself. Frames are passed on as they are coded: none is dropped or repeated to fill a rate.

use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use heartian_space::Rgb8Image;

use super::bitmap::is_sane;
use super::{FrameSource, TimedFrame, VideoError};

/// Longest line of ffmpeg's talk that is kept, bytes.
const LONGEST_LINE: u64 = 1 << 12;

/// A running ffmpeg.
pub(super) struct Ffmpeg {
    path: PathBuf,
    child: Child,
    pipe: BufReader<ChildStdout>,
    /// One time a frame, in the order of the pictures; nothing where ffmpeg does not know.
    times: Receiver<Option<f64>>,
    talk: Option<JoinHandle<Option<String>>>,
    /// The first picture, read on opening so that what is no video is known at once.
    first: Option<Rgb8Image>,
    frame: usize,
    start_seconds: f64,
    /// Time of the last frame and the step to it, seconds from the first.
    last: (f64, f64),
    notes: Vec<String>,
}

impl Ffmpeg {
    /// Starts ffmpeg on a file; `what` names the format in the error that there is no ffmpeg.
    pub fn open(path: &Path, what: &str) -> Result<Self, VideoError> {
        let needs = || VideoError::NeedsFfmpeg { path: path.to_owned(), what: what.to_owned() };
        let failed = |error: std::io::Error| match error.kind() {
            ErrorKind::NotFound => needs(),
            _ => VideoError::File { path: path.to_owned(), error },
        };
        let mut child = command(path).map_err(failed)?.spawn().map_err(failed)?;
        let (Some(pipe), Some(talk)) = (child.stdout.take(), child.stderr.take()) else { return Err(needs()) };
        let (sender, times) = channel();
        let talk = Some(std::thread::spawn(move || listen(talk, &sender)));
        let pipe = BufReader::with_capacity(1 << 18, pipe);
        let mut source = Self {
            path: path.to_owned(),
            child,
            pipe,
            times,
            talk,
            first: None,
            frame: 0,
            start_seconds: 0.0,
            last: (0.0, 0.0),
            notes: Vec::new(),
        };
        source.first = source.read_picture()?;
        if source.first.is_none() {
            let said = source.end().1.unwrap_or_default();
            let reason = format!("ffmpeg finds no video in it: {said}");
            return Err(VideoError::NotVideo { path: path.to_owned(), reason: reason.trim_end_matches(": ").into() });
        }
        Ok(source)
    }

    /// Seconds of the next frame from the first. A frame without a time follows at the last step.
    fn time(&mut self) -> Result<f64, VideoError> {
        let told = self.times.recv().ok().flatten();
        let (before, step) = self.last;
        let seconds = match (told, self.frame) {
            (Some(told), 0) => {
                self.start_seconds = told;
                0.0
            }
            (Some(told), _) => told - self.start_seconds,
            (None, 0) => 0.0,
            (None, _) if step > 0.0 => {
                self.note("its time is not known; the step before it was taken");
                before + step
            }
            (None, _) => {
                let reason = "ffmpeg does not know its frames' times; put it into a container that keeps them: \
                              `ffmpeg -r 30 -i IN -c copy OUT.mkv`";
                return Err(VideoError::Times { path: self.path.clone(), reason: reason.into() });
            }
        };
        self.last = (seconds, seconds - before);
        Ok(seconds)
    }

    fn note(&mut self, what: &str) {
        if self.notes.is_empty() {
            self.notes.push(format!("frame {}: {what}", self.frame));
        }
    }

    fn read_picture(&mut self) -> Result<Option<Rgb8Image>, VideoError> {
        let cut = |reason: &str| VideoError::Truncated {
            path: self.path.clone(),
            frame: self.frame,
            reason: reason.to_owned(),
        };
        let Some(tokens) = read_header(&mut self.pipe) else { return Ok(None) };
        let [width, height, 255] = tokens else { return Err(cut("ffmpeg's pictures are not 8-bit PPM")) };
        if !is_sane(width, height) {
            return Err(cut("the picture is absurdly large"));
        }
        let mut data = vec![0; width * height * 3];
        if self.pipe.read_exact(&mut data).is_err() {
            return Err(cut("ffmpeg stopped in the middle of a picture"));
        }
        Ok(Some(Rgb8Image { width, height, data }))
    }

    /// Waits for ffmpeg: whether all went well, and the first complaint.
    fn end(&mut self) -> (bool, Option<String>) {
        let fine = self.child.wait().is_ok_and(|status| status.success());
        (fine, self.talk.take().and_then(|talk| talk.join().ok()).flatten())
    }
}

/// The command for a file: local files only, whatever a playlist in it may name.
fn command(path: &Path) -> std::io::Result<Command> {
    let mut name = std::ffi::OsString::from("file:");
    name.push(path);
    let mut command = Command::new("ffmpeg");
    command.args(["-nostdin", "-nostats", "-hide_banner", "-loglevel", "level+info"]);
    command.args(["-protocol_whitelist", "file", "-i"]).arg(name);
    // showinfo tells each frame's time; chroma is interpolated, as it is for the files we decode ourselves.
    let filters = "showinfo,scale=flags=bilinear+accurate_rnd+full_chroma_int";
    command.args(["-map", "0:v:0", "-vf", filters]).args(as_coded()?);
    // Fine enough that no two frames of an uneven video fall on one tick of the output.
    command.args(["-enc_time_base", "1:90000", "-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    Ok(command)
}

/// The option that passes frames on as they are coded: it was renamed in ffmpeg 5.1.
pub(super) fn as_coded() -> std::io::Result<[&'static str; 2]> {
    let output = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let version = text.strip_prefix("ffmpeg version ").unwrap_or_default();
    let mut numbers = version.split(|c: char| !c.is_ascii_digit()).map(|part| part.parse::<u32>().ok());
    let old = matches!((numbers.next().flatten(), numbers.next().flatten()), (Some(major), minor)
        if (major, minor.unwrap_or(0)) < (5, 1));
    Ok(if old { ["-vsync", "passthrough"] } else { ["-fps_mode", "passthrough"] })
}

/// Reads ffmpeg's talk to its end: frame times are passed on, the first complaint is kept.
fn listen(talk: ChildStderr, times: &Sender<Option<f64>>) -> Option<String> {
    let mut reader = BufReader::new(talk);
    let (mut complaint, mut line, mut tick) = (None, Vec::new(), None);
    loop {
        line.clear();
        match reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return complaint,
            Ok(_) => {}
        }
        let text = String::from_utf8_lossy(&line);
        let after = |name: &str| text.split_once(name).and_then(|(_, rest)| rest.split_whitespace().next());
        if text.contains("showinfo") {
            let base = after("config in time_base:").and_then(|base| base.trim_end_matches(',').split_once('/'));
            if let Some((over, under)) = base.and_then(|(a, b)| Some((a.parse::<f64>().ok()?, b.parse::<f64>().ok()?)))
            {
                tick = Some((over, under));
            }
            if let Some(seconds) = after("pts_time:") {
                // In ticks it is exact, in seconds it has six digits.
                let ticks = after("pts:").and_then(|ticks| ticks.parse::<i64>().ok());
                let exact = ticks.zip(tick).map(|(ticks, (over, under))| ticks as f64 * over / under);
                let told = exact.or_else(|| seconds.parse().ok()).filter(|seconds: &f64| seconds.is_finite());
                // Whoever no longer reads frames needs no times.
                let _ = times.send(told);
            }
        } else if complaint.is_none()
            && let Some((_, said)) = text.split_once("[error]").or_else(|| text.split_once("[fatal]"))
        {
            complaint = Some(said.trim().to_owned());
        }
    }
}

/// `P6`, width, height and the largest value, each followed by one white space; `None` at the end of the pipe.
fn read_header(pipe: &mut impl Read) -> Option<[usize; 3]> {
    let mut token = || -> Option<String> {
        let mut text = String::new();
        loop {
            let mut byte = [0];
            pipe.read_exact(&mut byte).ok()?;
            if byte[0].is_ascii_whitespace() {
                return Some(text);
            }
            text.push(char::from(byte[0]));
            if text.len() > 16 {
                return None;
            }
        }
    };
    if token()? != "P6" {
        return None;
    }
    Some([token()?.parse().ok()?, token()?.parse().ok()?, token()?.parse().ok()?])
}

impl FrameSource for Ffmpeg {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let image = match self.first.take() {
            Some(image) => Some(image),
            None => self.read_picture()?,
        };
        let Some(image) = image else {
            let (fine, complaint) = self.end();
            if let Some(complaint) = complaint {
                if !fine {
                    let (path, frame) = (self.path.clone(), self.frame);
                    return Err(VideoError::Truncated { path, frame, reason: format!("ffmpeg: {complaint}") });
                }
                self.notes.push(format!("ffmpeg read it to its end but says: {complaint}"));
            }
            return Ok(None);
        };
        let seconds = self.time()?;
        self.frame += 1;
        Ok(Some(TimedFrame { seconds, image }))
    }

    fn frame_count(&self) -> Option<usize> {
        None
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // The reader may stop early; the child must not outlive it. Failing means it has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
