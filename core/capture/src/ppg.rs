//! Contact PPG from a CSV file: a header `time_s,ppg`, one sample a line, any sampling rate (`heartian_space::read_csv`).

use std::path::{Path, PathBuf};

use heartian_space::{Clip, CsvError, CsvKind, Series, SpaceError, read_csv};

/// How far a trace may end before the clip's last frame and still count as covering it, in frame intervals.
const SLACK_FRAMES: f64 = 1.5;

/// What can be wrong with a PPG file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PpgError {
    /// It cannot be read, or a line does not hold two numbers.
    #[error(transparent)]
    Csv(#[from] CsvError),
    /// The samples contradict one another or do not reach over the clip.
    #[error("{}: {source}; {remedy}", path.display())]
    Series {
        /// The file.
        path: PathBuf,
        /// Why.
        source: SpaceError,
        /// What to do.
        remedy: &'static str,
    },
}

/// A PPG trace as recorded, and on the clip's frame times.
pub struct ClipPpg {
    /// At its own rate, from one second before to one second after the clip as far as it goes.
    pub contact: Series,
    /// At the clip's frame times, by linear interpolation.
    pub at_frames: Series,
}

/// Lays a whole trace, read from `path`, over the clip; its times are on the clip's clock.
///
/// # Errors
/// When the trace is shorter than the clip.
pub fn cover_clip(path: &Path, whole: &Series, clip: &Clip) -> Result<ClipPpg, PpgError> {
    let series = |source| PpgError::Series {
        path: path.to_owned(),
        source,
        remedy: "give a PPG that covers the clip, or read a shorter part of it with `seconds`",
    };
    let slack_seconds = SLACK_FRAMES / clip.frame_rate_hertz().max(1.0);
    let at_frames = whole.resampled(&clip.times_seconds, slack_seconds).map_err(series)?;
    let (first, last) = (clip.times_seconds[0] - 1.0, clip.times_seconds[clip.len() - 1] + 1.0);
    let inside = |time: f64| (first..=last).contains(&time);
    let kept = whole.times_seconds.iter().copied().zip(whole.values.iter().copied()).filter(|(time, _)| inside(*time));
    let (times, values) = kept.unzip();
    Ok(ClipPpg { contact: Series::new(times, values).map_err(series)?, at_frames })
}

/// Reads a whole trace.
///
/// # Errors
/// When the file cannot be read, or a line does not hold two finite numbers in order of time.
pub fn read_ppg(path: &Path) -> Result<Series, PpgError> {
    let kind = CsvKind { header: &["time_s", "ppg"], values: &["the time", "the PPG value"] };
    let (_, mut columns) = read_csv(path, &[kind])?;
    let values = columns.pop().unwrap_or_default();
    let remedy = "times must increase from line to line";
    let series = |source| PpgError::Series { path: path.to_owned(), source, remedy };
    Series::new(columns.pop().unwrap_or_default(), values).map_err(series)
}

#[cfg(test)]
mod tests {
    use heartian_space::Sequence;

    use super::*;

    fn read(text: &str) -> Result<Series, PpgError> {
        let name =
            format!("heartian-ppg-{}-{:x}.csv", std::process::id(), text.len() * 31 + usize::from(text.as_bytes()[0]));
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).expect("a writable temporary folder");
        let series = read_ppg(&path);
        std::fs::remove_file(&path).expect("it was just written");
        series
    }

    #[test]
    fn spreadsheets_are_forgiven() -> Result<(), PpgError> {
        let series = read("\u{feff}Time_s; PPG ;note\r\n0; 512;a\r\n\r\n0.01;5.2e2\r\n")?;
        assert_eq!(series.values, [512.0, 520.0]);
        Ok(())
    }

    #[test]
    fn what_has_no_right_answer_is_named_by_its_line() {
        for (text, part) in [
            ("0,1\n", "header `time_s,ppg`"),
            ("time_s,ppg\n0,1\n0.1,NaN\n", ":3: the PPG value is `NaN`"),
            ("time_s,ppg\n0,1\nx,2\n", ":3: the time is `x`"),
            ("time_s,ppg\n0\n", "the PPG value is ``"),
            ("time_s,ppg\n0,1\n0,2\n", "must increase"),
            ("time_s,ppg\n", "is empty"),
        ] {
            let message = read(text).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(message.contains(part), "{text:?}: {message}");
        }
    }

    #[test]
    fn a_trace_shorter_than_its_clip_is_refused() -> Result<(), Box<dyn std::error::Error>> {
        let times_seconds: Vec<f64> = (0..90).map(|k| f64::from(k) / 30.0).collect();
        let sequence = Sequence { frames: vec![0; 90 * 3], alpha: vec![0; 90], times_seconds };
        let clip = Clip::new("input", 1, 1, sequence)?;
        let path = std::env::temp_dir().join(format!("heartian-short-{}.csv", std::process::id()));
        let lines = |seconds: f64| {
            (0..=(seconds * 10.0) as u32).map(|k| format!("{},{k}\n", f64::from(k) / 10.0)).collect::<String>()
        };
        std::fs::write(&path, format!("time_s,ppg\n{}", lines(4.0)))?;
        let ppg = cover_clip(&path, &read_ppg(&path)?, &clip)?;
        assert!((ppg.at_frames.values[15] - 5.0).abs() < 1e-9 && ppg.contact.len() == 40);
        std::fs::write(&path, format!("time_s,ppg\n{}", lines(2.0)))?;
        let message =
            cover_clip(&path, &read_ppg(&path)?, &clip).err().map(|error| error.to_string()).unwrap_or_default();
        std::fs::remove_file(&path)?;
        assert!(message.contains("0.000–2.000 s but 0.000–2.967 s is needed"), "{message}");
        Ok(())
    }
}
