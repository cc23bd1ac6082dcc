//! Everything else, through the user's `ffmpeg`: it decodes to a pipe of PPM pictures, `ffprobe` tells their times.

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use heartian_space::Rgb8Image;

use super::{FrameSource, TimedFrame, VideoError};

/// A running ffmpeg.
pub(super) struct Ffmpeg {
    path: PathBuf,
    child: Child,
    pipe: BufReader<ChildStdout>,
    /// Sorted presentation times; beyond them frames follow at the last spacing.
    times_seconds: Vec<f64>,
    frame: usize,
}

impl Ffmpeg {
    /// Starts ffmpeg on a file; `what` names the format in the error that there is no ffmpeg.
    pub fn open(path: &Path, what: &str) -> Result<Self, VideoError> {
        let times_seconds = probe(path, what)?;
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-nostdin", "-i"]).arg(path);
        command.args(["-map", "0:v:0", "-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let needs = || VideoError::NeedsFfmpeg { path: path.to_owned(), what: what.to_owned() };
        let mut child = command.spawn().map_err(|_| needs())?;
        let pipe = child.stdout.take().ok_or_else(needs)?;
        let pipe = BufReader::with_capacity(1 << 18, pipe);
        Ok(Self { path: path.to_owned(), child, pipe, times_seconds, frame: 0 })
    }

    /// Seconds of a frame by its place in display order.
    fn time(&self, frame: usize) -> f64 {
        let times = &self.times_seconds;
        let first = times.first().copied().unwrap_or(0.0);
        let time = times.get(frame).copied().unwrap_or_else(|| {
            let spacing =
                if times.len() > 1 { (times[times.len() - 1] - first) / (times.len() - 1) as f64 } else { 1.0 / 30.0 };
            times.last().copied().unwrap_or(0.0) + spacing * (frame + 1 - times.len().max(1)) as f64
        });
        time - first
    }

    fn read_picture(&mut self) -> Result<Option<Rgb8Image>, VideoError> {
        let frame = self.frame;
        let path = self.path.clone();
        let cut = |reason: &str| VideoError::Truncated { path: path.clone(), frame, reason: reason.to_owned() };
        let Some(tokens) = read_header(&mut self.pipe) else { return Ok(None) };
        let [width, height, 255] = tokens else { return Err(cut("ffmpeg's pictures are not 8-bit PPM")) };
        let size = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(3)).filter(|size| *size <= 1 << 30);
        let mut data = vec![0; size.ok_or_else(|| cut("the picture is absurdly large"))?];
        if self.pipe.read_exact(&mut data).is_err() {
            return Err(cut("ffmpeg stopped in the middle of a picture"));
        }
        Ok(Some(Rgb8Image { width, height, data }))
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

/// Presentation times of the first video stream's packets, sorted, seconds.
fn probe(path: &Path, what: &str) -> Result<Vec<f64>, VideoError> {
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-select_streams", "v:0", "-show_entries", "packet=pts_time", "-of", "csv=p=0"])
        .arg(path)
        .stdin(Stdio::null())
        .output()
        .map_err(|_| VideoError::NeedsFfmpeg { path: path.to_owned(), what: what.to_owned() })?;
    let text = String::from_utf8_lossy(&output.stdout);
    let mut times: Vec<f64> = text
        .lines()
        .filter_map(|line| line.trim().trim_end_matches(',').parse().ok())
        .filter(|t: &f64| t.is_finite())
        .collect();
    if !output.status.success() || (times.is_empty() && text.trim().is_empty()) {
        let reason = "ffmpeg finds no video stream in it".to_owned();
        return Err(VideoError::NotVideo { path: path.to_owned(), reason });
    }
    times.sort_by(f64::total_cmp);
    Ok(times)
}

impl FrameSource for Ffmpeg {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let Some(image) = self.read_picture()? else { return Ok(None) };
        let seconds = self.time(self.frame);
        self.frame += 1;
        Ok(Some(TimedFrame { seconds, image }))
    }

    fn frame_count(&self) -> Option<usize> {
        (!self.times_seconds.is_empty()).then_some(self.times_seconds.len())
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // The reader may stop early; the child must not outlive it. Failing means it has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
