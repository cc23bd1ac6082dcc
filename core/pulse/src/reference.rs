//! What the fit aims at: the pulse at frame times, its beat-aligned phase θ_gt and beat index (paper, L_phase), from a
//! supplied PPG or a prescribed heart rate; and the weak phase θ_POS of the video (`reference/weak_phase.rs`).
//!
//! All arrays have one entry a frame. Phase is unwrapped, radians, a multiple of 2π at each systolic peak.

mod file;
mod heartbeat;
mod prescription;
mod weak_phase;

pub use file::PulseFile;
pub use heartbeat::{Heartbeat, Rhythm};
pub use prescription::{Envelope, Prescription};
pub use weak_phase::{WeakPhase, weak_phase};

use heartian_signal::Detrender;
use heartian_signal::beats::{BeatOptions, Beats, beat_aligned_phase, detect_beats};
use heartian_space::Series;

use crate::error::{PulseError, check_finite};
use crate::losses::DETREND;
use crate::numeric::{mean, quantile};

/// Fewest frames and seconds that can carry a pulse: about two beats at 60 bpm.
pub const LEAST_FRAMES: usize = 16;
/// As [`LEAST_FRAMES`].
pub const LEAST_SECONDS: f64 = 1.5;
/// PPG used on either side of the clip, seconds: beat detection and filters settle outside of what is used.
const MARGIN_SECONDS: f64 = 4.0;
/// Range of rates at which a PPG is worked on, hertz; others are interpolated.
const WORK_HERTZ: [f64; 2] = [25.0, 250.0];
/// Confidence of frames beside a beat that the PPG does not show.
const GUESSED: f64 = 0.3;

/// The pulse to embed.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Frame times, seconds.
    pub times_seconds: Vec<f64>,
    /// The pulse at frame times: upright, without drift, spikes limited; arbitrary unit.
    pub waveform: Vec<f64>,
    /// Unwrapped beat-aligned phase, radians, increasing.
    pub phase: Vec<f64>,
    /// Beat of each frame, from 0.
    pub beat: Vec<u32>,
    /// How far the phase is to be trusted, in [0, 1].
    pub confidence: Vec<f64>,
    /// Mean beat rate over the clip, bpm.
    pub mean_bpm: f64,
    /// Whether the supplied PPG was upside down.
    pub inverted: bool,
    /// What is known beforehand of each frame's strength and baseline.
    pub envelope: Envelope,
}

/// Frame times that a pulse can live on, and their mean rate in hertz.
pub(crate) fn check_clip(times_seconds: &[f64]) -> Result<f64, PulseError> {
    check_finite("the frame times", times_seconds)?;
    let frames = times_seconds.len();
    let seconds = if frames > 1 { times_seconds[frames - 1] - times_seconds[0] } else { 0.0 };
    if frames < LEAST_FRAMES || seconds < LEAST_SECONDS {
        return Err(PulseError::Short { frames, seconds, needed: LEAST_FRAMES, needed_seconds: LEAST_SECONDS });
    }
    Ok((frames - 1) as f64 / seconds)
}

impl Reference {
    /// From a supplied PPG of any rate that covers the frame times.
    ///
    /// # Errors
    /// When the clip is too short, the PPG does not reach over it (both spans are named), or carries no beats.
    pub fn from_ppg(ppg: &Series, times_seconds: &[f64]) -> Result<Self, PulseError> {
        let frame_rate = check_clip(times_seconds)?;
        let slack = 2.0 / frame_rate.min(ppg.rate_hertz().max(1.0));
        ppg.resampled(times_seconds, slack)?;
        let even = EvenPpg::around(ppg, times_seconds)?;
        let found = detect_beats(&even.values, even.rate_hertz, &BeatOptions::default())
            .map_err(|error| PulseError::NoBeats(error.to_string()))?;
        let peaks: Vec<f64> = found.seconds().iter().map(|seconds| even.start_seconds + seconds).collect();
        let phase = beat_aligned_phase(times_seconds, &peaks)?;
        let sign = if found.inverted { -1.0 } else { 1.0 };
        let clean = even.clean()?;
        let waveform = times_seconds.iter().map(|&time| sign * clean.average(time, 1.0 / frame_rate)).collect();
        Ok(Self {
            times_seconds: times_seconds.to_vec(),
            waveform,
            mean_bpm: mean_bpm(times_seconds, &phase.phase_radians),
            beat: phase.beat_index.iter().map(|&beat| beat as u32).collect(),
            confidence: times_seconds.iter().map(|&time| confidence(time, &peaks, &found)).collect(),
            phase: phase.phase_radians,
            inverted: found.inverted,
            envelope: Envelope::default(),
        })
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.times_seconds.len()
    }

    /// Never true of a reference that was built.
    pub fn is_empty(&self) -> bool {
        self.times_seconds.is_empty()
    }

    /// Share of the frames between beats that the PPG plainly shows, in [0, 1]; 1 for a prescribed pulse.
    pub fn shown_share(&self) -> f64 {
        self.confidence.iter().filter(|&&confidence| confidence >= 1.0).count() as f64 / self.len().max(1) as f64
    }

    /// The longest stretch whose beats the PPG does not show, seconds of the clip.
    pub fn longest_guess(&self) -> Option<[f64; 2]> {
        let mut longest: Option<[f64; 2]> = None;
        let mut from = None;
        for (&time, &confidence) in self.times_seconds.iter().zip(&self.confidence) {
            if confidence >= 1.0 {
                from = None;
                continue;
            }
            let start = *from.get_or_insert(time);
            if longest.is_none_or(|[first, last]| time - start > last - first) {
                longest = Some([start, time]);
            }
        }
        longest
    }

    /// Number of beats touched by the clip.
    pub fn beat_count(&self) -> usize {
        self.beat.last().map_or(1, |&last| last as usize + 1)
    }

    /// Mean frame rate, hertz.
    pub fn rate_hertz(&self) -> f64 {
        let span = self.times_seconds[self.len() - 1] - self.times_seconds[0];
        if span > 0.0 { (self.len() - 1) as f64 / span } else { 0.0 }
    }

    /// The pulse at frame times as a signal for readers and reports.
    ///
    /// # Errors
    /// Does not occur for a reference that was built.
    pub fn series(&self) -> Result<Series, PulseError> {
        Ok(Series::new(self.times_seconds.clone(), self.waveform.clone())?)
    }
}

/// Turns over time, from the ends of the clip.
pub(crate) fn mean_bpm(times_seconds: &[f64], phase: &[f64]) -> f64 {
    let (Some(t0), Some(t1)) = (times_seconds.first(), times_seconds.last()) else { return 0.0 };
    let turns = (phase[phase.len() - 1] - phase[0]) / std::f64::consts::TAU;
    60.0 * turns / (t1 - t0)
}

fn confidence(time: f64, peaks: &[f64], found: &Beats) -> f64 {
    let after = peaks.partition_point(|&peak| peak <= time);
    let seen = |k: usize| found.beats.get(k).is_some_and(|beat| beat.observed);
    if after > 0 && seen(after - 1) && seen(after) { 1.0 } else { GUESSED }
}

/// A stretch of PPG on an even grid.
struct EvenPpg {
    start_seconds: f64,
    rate_hertz: f64,
    values: Vec<f64>,
}

impl EvenPpg {
    fn around(ppg: &Series, times_seconds: &[f64]) -> Result<Self, PulseError> {
        let (first, last) = (ppg.times_seconds[0], ppg.times_seconds[ppg.len() - 1]);
        let start = (times_seconds[0] - MARGIN_SECONDS).max(first);
        let end = (times_seconds[times_seconds.len() - 1] + MARGIN_SECONDS).min(last);
        let rate_hertz = ppg.rate_hertz().clamp(WORK_HERTZ[0], WORK_HERTZ[1]);
        let count = ((end - start) * rate_hertz).floor() as usize + 1;
        let values: Vec<f64> = (0..count).map(|k| ppg.at(start + k as f64 / rate_hertz)).collect();
        let (low, high) = (quantile(&values, 0.0), quantile(&values, 1.0));
        if high - low <= 1e-9 * high.abs().max(low.abs()) {
            return Err(PulseError::NoBeats("it does not vary".to_owned()));
        }
        Ok(Self { start_seconds: start, rate_hertz, values })
    }

    /// Without drift, and with what leaves the 5–95 % range extended by itself on both sides bridged by a line between its
    /// neighbours: a spike would otherwise dominate the normalised target, shift its spectrum and flash on the face. A tall
    /// smooth peak only loses what stands above that range.
    fn clean(&self) -> Result<Self, PulseError> {
        let detrender = Detrender::new(self.values.len(), DETREND.lambda(self.rate_hertz))?;
        // Twice: a spike first bends the trend around itself, which the second pass undoes.
        let mut trend_free = self.values.clone();
        detrender.apply(&mut trend_free)?;
        let mut bridged = trend_free.clone();
        bridge_outliers(&mut bridged);
        let back = |((raw, free), bridged): ((&f64, &f64), &f64)| raw - free + bridged;
        let mut values: Vec<f64> = self.values.iter().zip(&trend_free).zip(&bridged).map(back).collect();
        detrender.apply(&mut values)?;
        bridge_outliers(&mut values);
        let centre = mean(&values);
        values.iter_mut().for_each(|value| *value -= centre);
        Ok(Self { values, ..*self })
    }

    /// Mean over a frame's exposure around `seconds`, from five points, so that what a frame cannot carry averages out.
    fn average(&self, seconds: f64, exposure_seconds: f64) -> f64 {
        let point = |k: i32| self.at(seconds + exposure_seconds * f64::from(k) / 5.0);
        (-2..=2).map(point).sum::<f64>() / 5.0
    }

    fn at(&self, seconds: f64) -> f64 {
        let last = self.values.len() - 1;
        let at = ((seconds - self.start_seconds) * self.rate_hertz).clamp(0.0, last as f64);
        let (below, rest) = (at.floor() as usize, at.fract());
        self.values[below] + rest * (self.values[(below + 1).min(last)] - self.values[below])
    }
}

/// Replaces runs beyond the extended 5–95 % range by a line from the sample before to the one after; at an end, by that
/// neighbour.
fn bridge_outliers(values: &mut [f64]) {
    let (low, high) = (quantile(values, 0.05), quantile(values, 0.95));
    let range = high - low;
    let inside: Vec<usize> = (0..values.len()).filter(|&k| (low - range..=high + range).contains(&values[k])).collect();
    let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else { return };
    let ends = [values[first], values[last]];
    values[..first].fill(ends[0]);
    values[last + 1..].fill(ends[1]);
    for pair in inside.windows(2).filter(|pair| pair[1] > pair[0] + 1) {
        let (from, to, gap) = (values[pair[0]], values[pair[1]], (pair[1] - pair[0]) as f64);
        let run = &mut values[pair[0] + 1..pair[1]];
        run.iter_mut().zip(1..).for_each(|(value, step)| *value = from + f64::from(step) / gap * (to - from));
    }
}
