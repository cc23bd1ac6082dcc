//! Systolic peaks of a contact PPG of any rate, and the beat-aligned phase they define (the paper's θ_gt).
//!
//! Detection is a beat tracker rather than a threshold: every local maximum is a candidate with a score (its rise against
//! the typical rise around it, an adaptive threshold), the local rate is tracked through the whole recording, and dynamic
//! programming picks the sequence that trades scores against odd intervals. Dicrotic waves, spikes and motion make
//! intervals too short for the tracked rate and are left out; ectopic beats cost a little and stay; missing beats cost a
//! little and are filled in evenly, marked as not observed. Times are seconds from the first sample.

mod candidates;
mod condition;
mod phase;
mod rate_track;
mod sequence;

pub use phase::{BeatPhase, beat_aligned_phase};

use crate::error::{Result, SignalError, check_finite, check_length, check_rate};

/// Which way up a PPG is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Polarity {
    /// Decided from the signal: the systolic rise is faster than the fall.
    #[default]
    Auto,
    /// Systolic peaks are maxima.
    Upright,
    /// Systolic peaks are minima.
    Inverted,
}

/// What the detector may find.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeatOptions {
    /// Slowest sustained rate, bpm.
    pub slowest_bpm: f64,
    /// Fastest sustained rate, bpm; also limited by the sampling rate.
    pub fastest_bpm: f64,
    /// Which way up the signal is.
    pub polarity: Polarity,
}

impl Default for BeatOptions {
    /// 35–220 bpm, polarity from the signal.
    fn default() -> Self {
        Self { slowest_bpm: 35.0, fastest_bpm: 220.0, polarity: Polarity::Auto }
    }
}

/// One beat.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beat {
    /// Time of the systolic peak, seconds from the first sample, between samples by a parabola.
    pub seconds: f64,
    /// False where the signal does not plainly show it: filled into a gap, or in a stretch without a clear rhythm.
    pub observed: bool,
}

/// The beats of a recording, in time order, at least two.
#[derive(Clone, Debug, PartialEq)]
pub struct Beats {
    /// In time order.
    pub beats: Vec<Beat>,
    /// Whether the signal was turned over before the search.
    pub inverted: bool,
}

impl Beats {
    /// Times of all systolic peaks, filled ones included, seconds from the first sample.
    pub fn seconds(&self) -> Vec<f64> {
        self.beats.iter().map(|beat| beat.seconds).collect()
    }

    /// Mean beat rate over the intervals between observed beats, bpm; over all intervals when none is observed.
    pub fn mean_rate_bpm(&self) -> f64 {
        let total = |only_observed: bool| {
            let pairs = self.beats.windows(2).filter(|pair| !only_observed || pair.iter().all(|beat| beat.observed));
            pairs.fold((0.0, 0.0), |(count, sum), pair| (count + 1.0, sum + pair[1].seconds - pair[0].seconds))
        };
        let (count, seconds) = [total(true), total(false)].into_iter().find(|t| t.0 > 0.0).unwrap_or((f64::NAN, 1.0));
        60.0 * count / seconds
    }

    /// Share of beats that the signal shows, in [0, 1].
    pub fn observed_share(&self) -> f64 {
        self.beats.iter().filter(|beat| beat.observed).count() as f64 / self.beats.len() as f64
    }
}

/// Finds the systolic peaks of a PPG sampled evenly at `rate_hertz`: 5 Hz or more, and at least four samples a beat, lest
/// the second harmonic alias onto slower rates (7 Hz is enough for 105 bpm and often for 140).
///
/// # Errors
/// When the signal is empty, not finite, flat, shorter than two seconds or than the filters need, the rate or an option
/// is unusable, or fewer than two beats are found.
pub fn detect_beats(signal: &[f64], rate_hertz: f64, options: &BeatOptions) -> Result<Beats> {
    check_finite("the PPG", signal)?;
    check_rate(rate_hertz)?;
    let range = rate_range(rate_hertz, options)?;
    check_length("beat detection", ((2.0 * rate_hertz).ceil() as usize).max(16), signal.len())?;
    let mut pulse = condition::condition(signal, rate_hertz)?;
    let inverted = match options.polarity {
        Polarity::Auto => condition::is_inverted(&pulse),
        Polarity::Upright => false,
        Polarity::Inverted => true,
    };
    if inverted {
        pulse.values.iter_mut().for_each(|value| *value = -*value);
    }
    let periods = rate_track::track(&pulse, range);
    let candidates = candidates::find(&pulse, &periods);
    let chosen = sequence::choose(&candidates, &periods);
    let beats = sequence::fill(&chosen, &periods);
    if beats.len() < 2 {
        return Err(SignalError::FewBeats { found: beats.len(), needed: 2 });
    }
    Ok(Beats { beats, inverted })
}

/// The range of rates to look for, hertz.
fn rate_range(rate_hertz: f64, options: &BeatOptions) -> Result<[f64; 2]> {
    let BeatOptions { slowest_bpm, fastest_bpm, .. } = *options;
    if !(slowest_bpm >= 10.0 && slowest_bpm < fastest_bpm && fastest_bpm <= 400.0) {
        let (name, range) =
            ("the slowest rate of beats", "at least 10 bpm and below the fastest, itself at most 400 bpm");
        return Err(SignalError::Setting { name, value: slowest_bpm, range });
    }
    let fastest_hertz = (fastest_bpm / 60.0).min(0.45 * rate_hertz);
    if rate_hertz < 5.0 || fastest_hertz <= slowest_bpm / 60.0 {
        return Err(SignalError::Setting {
            name: "the PPG's sampling rate",
            value: rate_hertz,
            range: "at least 5 Hz",
        });
    }
    Ok([slowest_bpm / 60.0, fastest_hertz])
}
