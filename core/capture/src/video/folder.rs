//! A folder of pictures in natural order (`2.png` before `10.png`): PNG, JPEG, OpenEXR or BMP, one kind a folder.
//!
//! Times come from `times.csv` or `times.txt` in the folder (one number of seconds a line, a header line allowed), else
//! from a constant rate.

use std::cmp::Ordering;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::picture::{self, ENDINGS};
use super::{FrameSource, TimedFrame, VideoError};

/// A day of frame times is below.
const LARGEST_TEXT: u64 = 1 << 28;

/// The frames still to be read.
pub(super) struct Folder {
    files: Vec<PathBuf>,
    times_seconds: Vec<f64>,
    next: usize,
}

impl Folder {
    pub fn open(folder: &Path, hertz: f64) -> Result<Self, VideoError> {
        let files = pictures(folder)?;
        let listed = ["times.csv", "times.txt"].map(|name| folder.join(name)).into_iter().find(|path| path.is_file());
        let times_seconds = match listed {
            Some(path) => read_times(&path, files.len())?,
            None if hertz.is_finite() && hertz > 0.0 => (0..files.len()).map(|i| i as f64 / hertz).collect(),
            None => {
                let told = if hertz.is_nan() { "is not given".to_owned() } else { format!("is {hertz}") };
                let reason = format!(
                    "the folder holds no times.csv or times.txt, and the frame rate {told}; give a positive frame rate \
                     (`--fps 30`), or put a file with one number of seconds a frame there"
                );
                return Err(VideoError::Times { path: folder.to_owned(), reason });
            }
        };
        Ok(Self { files, times_seconds, next: 0 })
    }
}

/// The pictures of a folder in natural order.
pub(crate) fn pictures(folder: &Path) -> Result<Vec<PathBuf>, VideoError> {
    let io = |error| VideoError::File { path: folder.to_owned(), error };
    let mut kinds: [Vec<PathBuf>; ENDINGS.len()] = Default::default();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        // Such as macOS leaves behind: `._frame1.png` is no picture.
        let hidden = name(&path).starts_with('.');
        if let Some(kind) = ENDINGS.iter().position(|endings| endings.contains(&ending.as_str()) && !hidden) {
            kinds[kind].push(path);
        }
    }
    // A single picture of another kind is a cover or a thumbnail.
    let frames = kinds.iter().any(|files| files.len() > 1);
    let counts = |files: &Vec<PathBuf>| files.len() > usize::from(frames);
    let mut found = kinds.into_iter().zip(ENDINGS).filter(|(files, _)| counts(files));
    let wrong = |reason: String| VideoError::NotVideo { path: folder.to_owned(), reason };
    let Some((mut files, endings)) = found.next() else {
        return Err(wrong("the folder holds no PNG, JPEG, EXR or BMP file".to_owned()));
    };
    if let Some((_, others)) = found.next() {
        return Err(wrong(format!(
            "the folder holds both {} and {} files, and which are the frames cannot be told; leave one kind there",
            endings[0].to_uppercase(),
            others[0].to_uppercase()
        )));
    }
    files.sort_by(|a, b| natural(&name(a), &name(b)));
    Ok(files)
}

/// A file name for people.
pub(crate) fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Compares runs of digits as numbers and everything else as text; equal numbers fall back to the text.
pub(crate) fn natural(a: &str, b: &str) -> Ordering {
    let (mut x, mut y) = (a, b);
    loop {
        let digits = |text: &str| text.len() - text.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let (dx, dy) = (digits(x), digits(y));
        if dx > 0 && dy > 0 {
            let (nx, ny) = (x[..dx].trim_start_matches('0'), y[..dy].trim_start_matches('0'));
            let order = nx.len().cmp(&ny.len()).then_with(|| nx.cmp(ny));
            if order.is_ne() {
                return order;
            }
            (x, y) = (&x[dx..], &y[dy..]);
            continue;
        }
        match (x.chars().next(), y.chars().next()) {
            (Some(cx), Some(cy)) if cx == cy => (x, y) = (&x[cx.len_utf8()..], &y[cy.len_utf8()..]),
            (cx, cy) => return cx.cmp(&cy).then_with(|| a.cmp(b)),
        }
    }
}

/// A small text file.
fn read_text(path: &Path) -> Result<String, VideoError> {
    let io = |error| VideoError::File { path: path.to_owned(), error };
    let mut bytes = Vec::new();
    File::open(path).map_err(io)?.take(LARGEST_TEXT).read_to_end(&mut bytes).map_err(io)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn read_times(path: &Path, frames: usize) -> Result<Vec<f64>, VideoError> {
    let text = read_text(path)?;
    let wrong = |reason: String| VideoError::Times { path: path.to_owned(), reason };
    let mut times = Vec::new();
    for (line, text) in text.lines().enumerate() {
        let field = text.split(',').next().unwrap_or("").trim();
        match field.parse::<f64>() {
            Ok(time) if time.is_finite() && times.last().is_none_or(|before| time > *before) => times.push(time),
            Ok(time) => return Err(wrong(format!("line {}: time {time} is not after the one before it", line + 1))),
            Err(_) if field.is_empty() || line == 0 => {}
            Err(_) => return Err(wrong(format!("line {}: `{field}` is not a number of seconds", line + 1))),
        }
    }
    if times.len() != frames {
        return Err(wrong(format!("{} times for {frames} frames; give one a frame", times.len())));
    }
    Ok(times)
}

impl FrameSource for Folder {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let Some(path) = self.files.get(self.next) else { return Ok(None) };
        let seconds = self.times_seconds[self.next];
        self.next += 1;
        Ok(Some(TimedFrame { seconds, image: picture::read(path)? }))
    }

    fn frame_count(&self) -> Option<usize> {
        Some(self.files.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_order_as_numbers() {
        let mut names = ["f10.png", "f2.png", "f010.png", "f1.png", "f1b.png", "e9.png"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["e9.png", "f1.png", "f1b.png", "f2.png", "f010.png", "f10.png"]);
    }
}
