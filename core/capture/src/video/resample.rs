//! Frames at an even rate, from frames with their true times: once, and only when asked for.
//!
//! A frame between two true ones is their mix in the encoded values, weighted by time, so a colour that changes steadily
//! still does. Where the camera saw nothing for long there is no frame: a hole is left and named, nothing is made up.

use heartian_space::Rgb8Image;

use super::{TimedFrame, VideoError};

/// Frames further apart than this, in seconds and in steps of the new rate, are a hole.
const HOLE_SECONDS: f64 = 0.25;
const HOLE_STEPS: f64 = 3.0;

/// Where the resampling stands.
pub(super) struct Resampling {
    step_seconds: f64,
    /// Frames given so far, holes counted.
    next: u64,
    /// First frame's time, seconds.
    start_seconds: f64,
    before: Option<TimedFrame>,
    after: Option<TimedFrame>,
    pub notes: Vec<String>,
}

impl Resampling {
    pub fn new(hertz: f64) -> Self {
        Self { step_seconds: 1.0 / hertz, next: 0, start_seconds: 0.0, before: None, after: None, notes: Vec::new() }
    }

    /// The next even frame; `read` gives the true ones.
    pub fn next(
        &mut self,
        mut read: impl FnMut() -> Result<Option<TimedFrame>, VideoError>,
    ) -> Result<Option<TimedFrame>, VideoError> {
        if self.before.is_none() {
            let Some(first) = read()? else { return Ok(None) };
            self.start_seconds = first.seconds;
            self.before = Some(first);
            self.after = read()?;
        }
        loop {
            let seconds = self.start_seconds + self.next as f64 * self.step_seconds;
            while let Some(after) = self.after.take_if(|after| after.seconds <= seconds + 1e-6) {
                self.before = Some(after);
                self.after = read()?;
            }
            let Some(before) = &self.before else { return Ok(None) };
            let since = seconds - before.seconds;
            let Some(after) = &self.after else {
                self.next += 1;
                // Nothing lies beyond the last frame.
                let image = (since <= 1e-6).then(|| before.image.clone());
                return Ok(image.map(|image| TimedFrame { seconds, image }));
            };
            let apart = after.seconds - before.seconds;
            let hole = apart > HOLE_SECONDS.max(HOLE_STEPS * self.step_seconds);
            if hole && since > 0.5 * self.step_seconds {
                let span = format!("{:.3} s to {:.3} s", before.seconds, after.seconds);
                self.notes.push(format!("no frame from {span}: left out of the even frames too"));
                let steps = (after.seconds - self.start_seconds) / self.step_seconds;
                self.next = self.next.max((steps - 1e-6).ceil() as u64);
                self.before = self.after.take();
                self.after = read()?;
                continue;
            }
            self.next += 1;
            let weight = if hole { 0.0 } else { since / apart };
            return Ok(Some(TimedFrame { seconds, image: mixed(&before.image, &after.image, weight) }));
        }
    }
}

/// `(1 − weight)·a + weight·b`, rounded. Both have one size.
fn mixed(a: &Rgb8Image, b: &Rgb8Image, weight: f64) -> Rgb8Image {
    let part = (weight.clamp(0.0, 1.0) * 256.0).round() as u32;
    let mix = |(a, b): (&u8, &u8)| ((u32::from(*a) * (256 - part) + u32::from(*b) * part + 128) >> 8) as u8;
    Rgb8Image { width: a.width, height: a.height, data: a.data.iter().zip(&b.data).map(mix).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(times: &[f64], hertz: f64) -> (Vec<(f64, u8)>, Vec<String>) {
        let frame = |seconds: f64| {
            let value = (10.0 + 20.0 * seconds).round() as u8;
            TimedFrame { seconds, image: Rgb8Image::filled(2, 1, [value; 3]) }
        };
        let mut frames = times.iter().map(|t| frame(*t));
        let mut resampling = Resampling::new(hertz);
        let mut out = Vec::new();
        while let Ok(Some(frame)) = resampling.next(|| Ok(frames.next())) {
            out.push((frame.seconds, frame.image.data[0]));
        }
        (out, resampling.notes)
    }

    #[test]
    fn a_steady_change_stays_steady_and_holes_stay_holes() {
        let (frames, notes) = even(&[1.0, 1.1, 1.25, 1.3, 1.5, 1.6], 10.0);
        let seconds: Vec<f64> = frames.iter().map(|frame| (frame.0 * 1e3).round() / 1e3).collect();
        assert_eq!(seconds, [1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6]);
        assert!(frames.iter().all(|(t, value)| (f64::from(*value) - 10.0 - 20.0 * t).abs() <= 1.0), "{frames:?}");
        assert!(notes.is_empty());
        let (frames, notes) = even(&[0.0, 0.1, 0.9, 1.0], 10.0);
        let tenths: Vec<i32> = frames.iter().map(|frame| (frame.0 * 10.0).round() as i32).collect();
        assert_eq!(tenths, [0, 1, 9, 10]);
        assert!(notes.len() == 1 && notes[0].contains("0.100 s to 0.900 s"), "{notes:?}");
        assert_eq!(even(&[3.0], 30.0).0.len(), 1);
        assert!(even(&[], 30.0).0.is_empty());
        // Slower than the video: frames are skipped, not blurred over long spans.
        assert_eq!(even(&(0..60).map(|k| f64::from(k) / 60.0).collect::<Vec<_>>(), 20.0).0.len(), 20);
    }
}
