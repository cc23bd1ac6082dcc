//! A folder of PNG frames in natural order (`2.png` before `10.png`).
//!
//! Times come from `times.csv` or `times.txt` in the folder (one number of seconds a line, a header line allowed), else
//! from a constant rate.

use std::cmp::Ordering;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use heartian_space::Rgb8Image;

use super::{FrameSource, TimedFrame, VideoError};

/// The frames still to be read.
pub(super) struct PngFolder {
    files: Vec<PathBuf>,
    times_seconds: Vec<f64>,
    next: usize,
}

impl PngFolder {
    pub fn open(folder: &Path, hertz: f64) -> Result<Self, VideoError> {
        let io = |error| VideoError::File { path: folder.to_owned(), error };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(io)? {
            let path = entry.map_err(io)?.path();
            if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
                files.push(path);
            }
        }
        if files.is_empty() {
            let reason = "the folder holds no PNG file".to_owned();
            return Err(VideoError::NotVideo { path: folder.to_owned(), reason });
        }
        files.sort_by(|a, b| natural(&name(a), &name(b)));
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

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Compares runs of digits as numbers and everything else as text; equal numbers fall back to the text.
fn natural(a: &str, b: &str) -> Ordering {
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

fn read_times(path: &Path, frames: usize) -> Result<Vec<f64>, VideoError> {
    let text = std::fs::read_to_string(path).map_err(|error| VideoError::File { path: path.to_owned(), error })?;
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

/// Reads one PNG as 8-bit RGB; grey is repeated, transparency dropped, 16 bits cut to 8.
fn read_png(path: &Path) -> Result<Rgb8Image, VideoError> {
    let wrong = |reason: String| VideoError::NotVideo { path: path.to_owned(), reason };
    let file = File::open(path).map_err(|error| VideoError::File { path: path.to_owned(), error })?;
    let mut decoder = png::Decoder::new(BufReader::new(file));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(|error| wrong(error.to_string()))?;
    let size = reader.output_buffer_size().ok_or_else(|| wrong("the picture is absurdly large".into()))?;
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(|error| wrong(error.to_string()))?;
    let channels = info.color_type.samples();
    let pixels = buffer[..info.buffer_size()].chunks_exact(channels);
    let data = pixels.flat_map(|p| if channels < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] }).collect();
    Rgb8Image::from_data(info.width as usize, info.height as usize, data).map_err(|error| wrong(error.to_string()))
}

impl FrameSource for PngFolder {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let Some(path) = self.files.get(self.next) else { return Ok(None) };
        let seconds = self.times_seconds[self.next];
        self.next += 1;
        Ok(Some(TimedFrame { seconds, image: read_png(path)? }))
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
