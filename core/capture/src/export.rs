//! Clips as public data sets lay them out, so that other programs (rPPG-Toolbox above all) read them as their own.
//!
//! UBFC-rPPG: `subjectN/vid.avi` (raw BGR24) and `subjectN/ground_truth.txt`: three lines of numbers, the PPG at the frame
//! times, the heart rate in bpm, the frame times in seconds. PURE: `SS-TT/SS-TT/Image….png` and `SS-TT/SS-TT.json`, the PPG
//! at 60 Hz from the first frame to the last; its readers resample by sample number, not by time.

mod avi;

pub use avi::{AviForm, AviWriter, write_clip};

use heartian_space::{Rgb8Image, Series, SpaceError};

/// Sampling rate of PURE's contact PPG, hertz.
const PURE_HERTZ: f64 = 60.0;
/// How far a PPG may end before the first or after the last frame and still cover the clip, seconds.
const SLACK_SECONDS: f64 = 0.1;

/// A data set's layout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Layout {
    /// UBFC-rPPG, second data set.
    #[default]
    Ubfc,
    /// PURE.
    Pure,
}

/// Where one recording lies below a data set's folder, `/` between parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// The layout.
    pub layout: Layout,
    /// Number of the subject, from 1.
    pub subject: u32,
    /// Number of the subject's recording, from 1; UBFC has one a subject.
    pub recording: u32,
}

impl Place {
    /// The folder of the frames: `subject3`, `03-01/03-01`.
    pub fn folder(&self) -> String {
        match self.layout {
            Layout::Ubfc => format!("subject{}", self.subject),
            Layout::Pure => format!("{0}/{0}", self.pure_name()),
        }
    }

    /// The file of the labels.
    pub fn labels(&self) -> String {
        match self.layout {
            Layout::Ubfc => format!("{}/ground_truth.txt", self.folder()),
            Layout::Pure => format!("{0}/{0}.json", self.pure_name()),
        }
    }

    /// A frame's picture, or the one file of all frames.
    pub fn frames(&self, seconds: f64) -> String {
        match self.layout {
            Layout::Ubfc => format!("{}/vid.avi", self.folder()),
            Layout::Pure => format!("{}/Image{:019}.png", self.folder(), nanoseconds(seconds)),
        }
    }

    fn pure_name(&self) -> String {
        format!("{:02}-{:02}", self.subject, self.recording)
    }
}

/// The text of the labels.
///
/// # Errors
/// When the PPG does not reach over the frames.
pub fn labels(layout: Layout, times_seconds: &[f64], ppg: &Series, heart_rate_bpm: f64) -> Result<String, SpaceError> {
    match layout {
        Layout::Ubfc => {
            let at_frames = ppg.resampled(times_seconds, SLACK_SECONDS)?.values;
            let rates = vec![heart_rate_bpm; times_seconds.len()];
            Ok([at_frames, rates, times_seconds.to_vec()].map(|numbers| line(&numbers)).concat())
        }
        Layout::Pure => pure_labels(times_seconds, ppg, heart_rate_bpm),
    }
}

/// Numbers with nine digits, separated by blanks, as a line.
fn line(numbers: &[f64]) -> String {
    let words: Vec<String> = numbers.iter().map(|number| format!("{number:.8e}")).collect();
    format!("   {}\n", words.join("   "))
}

fn pure_labels(times_seconds: &[f64], ppg: &Series, heart_rate_bpm: f64) -> Result<String, SpaceError> {
    let (Some(first), Some(last)) = (times_seconds.first(), times_seconds.last()) else {
        return Err(SpaceError::Empty("the clip"));
    };
    let count = ((last - first) * PURE_HERTZ).round().max(1.0) as usize + 1;
    let step = (last - first) / (count - 1) as f64;
    let times: Vec<f64> = (0..count).map(|k| first + step * k as f64).collect();
    let sampled = ppg.resampled(&times, SLACK_SECONDS)?;
    let rate = heart_rate_bpm.is_finite().then_some(heart_rate_bpm);
    let package = sampled.times_seconds.iter().zip(&sampled.values).map(|(time, value)| {
        let value = serde_json::json!({ "waveform": value, "pulseRate": rate, "signalStrength": 0, "o2saturation": 0 });
        serde_json::json!({ "Timestamp": nanoseconds(*time), "Value": value })
    });
    let images = times_seconds.iter().map(|time| serde_json::json!({ "Timestamp": nanoseconds(*time) }));
    let document = serde_json::json!({
        "/FullPackage": package.collect::<Vec<_>>(),
        "/Image": images.collect::<Vec<_>>(),
    });
    Ok(document.to_string())
}

/// Clocks of data sets count nanoseconds; times before the start count as the start.
fn nanoseconds(seconds: f64) -> u64 {
    (seconds.max(0.0) * 1e9).round() as u64
}

/// A picture as a PNG file.
///
/// # Errors
/// When the encoder refuses.
pub fn png(image: &Rgb8Image) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Fast);
    encoder.write_header()?.write_image_data(&image.data)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use heartian_space::{Clip, Sequence};

    use super::*;
    use crate::video::{FrameSource, VideoOptions, open};

    fn clip() -> (Clip, Series) {
        let (width, height, count) = (10, 6, 12);
        let sequence = Sequence {
            frames: (0..width * height * 3 * count).map(|value| (value * 37 % 251) as u8).collect(),
            alpha: vec![255; width * height * count],
            times_seconds: (0..count).map(|k| k as f64 / 25.0).collect(),
        };
        let times: Vec<f64> = (0..60).map(|k| f64::from(k) / 100.0).collect();
        let ppg = Series::new(times.clone(), times.iter().map(|t| (7.0 * t).sin()).collect()).unwrap();
        (Clip::new("x", width, height, sequence).unwrap(), ppg)
    }

    /// Every frame of a written file, by our own reader and, where there is one, by ffmpeg.
    #[test]
    fn a_ubfc_folder_is_read_back_to_the_last_pixel() {
        let (clip, ppg) = clip();
        let folder = tempfile::tempdir().unwrap();
        let place = Place { layout: Layout::Ubfc, subject: 7, recording: 1 };
        let path = folder.path().join(place.frames(0.0));
        std::fs::create_dir_all(folder.path().join(place.folder())).unwrap();
        write_clip(&clip, &mut std::fs::File::create(&path).unwrap()).unwrap();
        assert!(path.ends_with("subject7/vid.avi"));
        let mut video = open(&path, &VideoOptions::default()).unwrap();
        for index in 0..clip.len() {
            let frame = video.next_frame().unwrap().unwrap();
            assert_eq!(frame.image.data, clip.frame(index));
            assert!((frame.seconds - clip.times_seconds[index]).abs() < 1e-6);
        }
        assert_eq!(video.next_frame().unwrap(), None);
        let mut ffmpeg = std::process::Command::new("ffmpeg");
        ffmpeg.args(["-loglevel", "error", "-i"]).arg(&path).args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]);
        match ffmpeg.output() {
            Ok(output) => assert_eq!(output.stdout, clip.frames, "{}", String::from_utf8_lossy(&output.stderr)),
            Err(_) => println!("skipped: ffmpeg is not on PATH"),
        }

        let text = labels(Layout::Ubfc, &clip.times_seconds, &ppg, 66.0).unwrap();
        let lines: Vec<Vec<f64>> =
            text.lines().map(|line| line.split_whitespace().map(|word| word.parse().unwrap()).collect()).collect();
        assert_eq!((lines.len(), lines[0].len(), lines[1][3]), (3, clip.len(), 66.0));
        assert!((0..clip.len()).all(|k| (lines[0][k] - ppg.at(clip.times_seconds[k])).abs() < 1e-8));
        assert!((0..clip.len()).all(|k| (lines[2][k] - clip.times_seconds[k]).abs() < 1e-8));
    }

    #[test]
    fn a_pure_folder_is_read_back_by_name_and_by_key() {
        let (clip, ppg) = clip();
        let folder = tempfile::tempdir().unwrap();
        let place = Place { layout: Layout::Pure, subject: 3, recording: 2 };
        std::fs::create_dir_all(folder.path().join(place.folder())).unwrap();
        for index in 0..clip.len() {
            let name = place.frames(clip.times_seconds[index]);
            std::fs::write(folder.path().join(name), png(&clip.image_over_black(index)).unwrap()).unwrap();
        }
        let frames = folder.path().join("03-02/03-02");
        let mut video = open(&frames, &VideoOptions { folder_hertz: 25.0, ..VideoOptions::default() }).unwrap();
        for index in 0..clip.len() {
            assert_eq!(video.next_frame().unwrap().unwrap().image.data, clip.frame(index));
        }
        let text = labels(Layout::Pure, &clip.times_seconds, &ppg, f64::NAN).unwrap();
        let document: serde_json::Value = serde_json::from_str(&text).unwrap();
        let package = document["/FullPackage"].as_array().unwrap();
        assert_eq!((package.len(), place.labels().as_str()), (27, "03-02/03-02.json"));
        assert_eq!(document["/Image"].as_array().unwrap().len(), clip.len());
        // The toolbox resamples by sample number: that must land on the PPG at the frame's time.
        let wave: Vec<f64> = package.iter().map(|one| one["Value"]["waveform"].as_f64().unwrap()).collect();
        for (frame, time) in clip.times_seconds.iter().enumerate() {
            let at = frame as f64 * (wave.len() - 1) as f64 / (clip.len() - 1) as f64;
            let (k, part) = ((at as usize).min(wave.len() - 2), at - (at as usize).min(wave.len() - 2) as f64);
            assert!((wave[k] + part * (wave[k + 1] - wave[k]) - ppg.at(*time)).abs() < 0.01, "{frame}");
        }
    }

    #[test]
    fn a_ppg_shorter_than_the_clip_is_refused() {
        let (clip, _) = clip();
        let short = Series::new(vec![0.0, 0.1], vec![0.0, 1.0]).unwrap();
        for layout in [Layout::Ubfc, Layout::Pure] {
            assert!(matches!(labels(layout, &clip.times_seconds, &short, 60.0), Err(SpaceError::Span { .. })));
        }
    }
}
