//! Contact PPG: from a CSV file (a header `time_s,ppg`, one sample a line, any sampling rate) or from a data set.
//!
//! A trace may have holes. Its samples stay where they are, the holes are named, and only laying it over frames draws
//! straight lines across them.

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

/// A longer pause between samples is a hole when it also lasts this many sampling intervals, seconds.
const HOLE_SECONDS: f64 = 0.1;
const HOLE_INTERVALS: f64 = 3.0;
/// Most holes that are named one by one.
const HOLES_NAMED: usize = 3;

/// A whole trace, and what is doubtful about it, a line each.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// The samples that are there.
    pub series: Series,
    /// Holes and samples left out.
    pub notes: Vec<String>,
}

impl Trace {
    /// From samples of `path` as they come: those that are no number, or not after the one before, are left out and named.
    ///
    /// # Errors
    /// When lengths differ or fewer than two samples are left.
    pub fn new(path: &Path, times_seconds: Vec<f64>, values: Vec<f64>) -> Result<Self, PpgError> {
        let (samples, mut unordered, mut last) = (values.len(), None, f64::NEG_INFINITY);
        let mut kept = (Vec::with_capacity(samples), Vec::with_capacity(samples));
        for (index, (time, value)) in times_seconds.into_iter().zip(values).enumerate() {
            if !(time > last && time.is_finite()) {
                unordered.get_or_insert((index, time));
            } else if value.is_finite() {
                kept.0.push(time);
                kept.1.push(value);
                last = time;
            }
        }
        let remedy = "give a PPG of your own with `ppg`";
        let wrong = |source| PpgError::Series { path: path.to_owned(), source, remedy };
        let left_out = samples - kept.0.len();
        let mut trace = Self::of(Series::new(kept.0, kept.1).map_err(wrong)?);
        if trace.series.len() < 2 {
            return Err(wrong(SpaceError::Empty("the trace, but for one sample,")));
        }
        if left_out > 0 {
            let first =
                unordered.map(|(index, time)| format!("; sample {index} at {time:.3} s is not after the one before"));
            trace.notes.insert(0, format!("{left_out} of {samples} samples are left out{}", first.unwrap_or_default()));
        }
        Ok(trace)
    }

    /// Names the holes of a series.
    pub fn of(series: Series) -> Self {
        let steps: Vec<f64> = series.times_seconds.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let hole = HOLE_SECONDS.max(HOLE_INTERVALS * usual);
        let holes: Vec<usize> = (0..steps.len()).filter(|k| steps[*k] > hole).collect();
        let named = |k: &usize| {
            format!(
                "the pulse has no sample from {:.2} s to {:.2} s",
                series.times_seconds[*k],
                series.times_seconds[k + 1]
            )
        };
        let mut notes: Vec<String> = holes.iter().take(HOLES_NAMED).map(named).collect();
        if holes.len() > HOLES_NAMED {
            notes.push(format!("the pulse has {} more holes", holes.len() - HOLES_NAMED));
        }
        Self { series, notes }
    }
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
    fn holes_are_named_and_never_filled() -> Result<(), PpgError> {
        let time = |k: usize| k as f64 / 50.0;
        let mut values: Vec<f64> = (0..200).map(|k| (k as f64 / 8.0).sin()).collect();
        values[60..90].fill(f64::NAN);
        let trace = Trace::new(Path::new("x"), (0..200).map(time).collect(), values.clone())?;
        assert_eq!(trace.series.len(), 170);
        assert!(trace.notes[0].contains("30 of 200"), "{:?}", trace.notes);
        assert!(trace.notes[1].contains("1.18 s to 1.80 s"), "{:?}", trace.notes);
        let mut times: Vec<f64> = (0..200).map(time).collect();
        times[7] = 0.01;
        let trace = Trace::new(Path::new("x"), times, vec![1.0; 200])?;
        assert!(trace.series.len() == 199 && trace.notes[0].contains("sample 7"), "{:?}", trace.notes);
        assert!(Trace::new(Path::new("x"), vec![0.0, 1.0], vec![f64::NAN; 2]).is_err());
        assert!(Trace::new(Path::new("x"), vec![], vec![]).is_err());
        assert!(Trace::new(Path::new("x"), vec![f64::NAN, 1.0, f64::INFINITY], vec![1.0; 3]).is_err());
        Ok(())
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
