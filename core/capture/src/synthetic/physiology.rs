//! Blood-volume pulse of a resting person: beats with variability and respiration, and the wave each beat sends out.
//!
//! Positive is more blood, so skin darkens where the pulse is positive. The pulse has zero mean over a regular beat and
//! a height of 1 from trough to systolic peak. Times are seconds from the first frame.

use std::f64::consts::TAU;

use heartian_space::{Series, SpaceError};

use super::random::{Random, Stream};

/// Sampling rate of the contact sensor, hertz; deliberately not a multiple of common frame rates.
pub(crate) const CONTACT_HERTZ: f64 = 125.0;
/// The wave reaches the fingertip this much later than the face.
pub(crate) const FINGER_DELAY_SECONDS: f64 = 0.085;
/// Beats start this long before the first frame and go on this long after the last, so that delays have a past.
const MARGIN_SECONDS: f64 = 4.0;
/// Half of the stretch whose mean is taken off a supplied PPG, seconds.
const SLOW_SECONDS: f64 = 0.75;
/// Noise of the contact sensor as a fraction of the pulse's height.
const CONTACT_NOISE: f64 = 0.012;
/// How much of the wave's height breathing takes away at its peak.
const RESPIRATORY_AMPLITUDE: f64 = 0.08;
/// Respiratory wander of the baseline, in pulse heights, at the face and at the finger.
const RESPIRATORY_WANDER: [f64; 2] = [0.06, 0.12];

/// What is asked of a heart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Heart {
    /// Mean rate over the recording.
    pub(crate) rate_bpm: f64,
    /// Standard deviation of the beat-to-beat intervals (SDNN), milliseconds.
    pub(crate) sdnn_ms: f64,
    pub(crate) seed: u64,
}

/// A person's beats and breath over one recording.
#[derive(Clone, Debug)]
pub(crate) struct Physiology {
    /// Times of the beats' onsets, increasing; the first lies before the recording.
    beats_seconds: Vec<f64>,
    respiration_hertz: f64,
    respiration_phase: f64,
    contact: Random,
    mean_of_wave: [f64; 2],
    /// Instead of beats: a contact PPG, and the same as a pulse in the face.
    supplied: Option<(Series, Series)>,
}

/// The shape of one beat over its phase in [0, 1): a systolic wave that rises faster than it falls, and a diastolic one.
#[derive(Clone, Copy, Debug)]
struct Wave {
    systole: f64,
    rise: f64,
    fall: f64,
    diastole: f64,
    diastolic_width: f64,
    diastolic_height: f64,
}

const FACE: Wave =
    Wave { systole: 0.27, rise: 0.090, fall: 0.110, diastole: 0.60, diastolic_width: 0.10, diastolic_height: 0.28 };
const FINGER: Wave =
    Wave { systole: 0.24, rise: 0.075, fall: 0.110, diastole: 0.57, diastolic_width: 0.11, diastolic_height: 0.40 };

impl Wave {
    /// Height at a phase; continuous and periodic, because neighbouring beats' waves are summed.
    fn at(&self, phase: f64) -> f64 {
        let bell = |distance: f64, width: f64| (-0.5 * (distance / width).powi(2)).exp();
        (-1..=1)
            .map(|beat| {
                let from_systole = phase - self.systole + f64::from(beat);
                let width = if from_systole < 0.0 { self.rise } else { self.fall };
                bell(from_systole, width)
                    + self.diastolic_height * bell(phase - self.diastole + f64::from(beat), self.diastolic_width)
            })
            .sum()
    }

    fn mean(&self) -> f64 {
        (0..1000).map(|i| self.at((f64::from(i) + 0.5) / 1000.0)).sum::<f64>() / 1000.0
    }
}

impl Physiology {
    /// The beats of a recording of `seconds`.
    pub(crate) fn new(heart: Heart, seconds: f64) -> Self {
        let respiration = Random::new(heart.seed, Stream::Respiration);
        let mut physiology = Self {
            beats_seconds: Vec::new(),
            respiration_hertz: respiration.between(0, 0.20, 0.30),
            respiration_phase: respiration.between(1, 0.0, TAU),
            contact: Random::new(heart.seed, Stream::Contact),
            mean_of_wave: [FACE.mean(), FINGER.mean()],
            supplied: None,
        };
        physiology.beats_seconds = physiology.place_beats(heart, seconds);
        physiology
    }

    /// The same person with the blood of a contact PPG: the trace without what is slower than a beat, scaled to a height
    /// of about 1, and as much earlier as the face is nearer to the heart than the finger.
    pub(crate) fn following(self, ppg: &Series) -> Self {
        let times = &ppg.times_seconds;
        let mut sums = vec![0.0];
        for value in &ppg.values {
            sums.push(sums[sums.len() - 1] + value);
        }
        let pulse: Vec<f64> = times
            .iter()
            .zip(&ppg.values)
            .map(|(time, value)| {
                let from = times.partition_point(|t| *t < time - SLOW_SECONDS);
                let to = times.partition_point(|t| *t <= time + SLOW_SECONDS);
                value - (sums[to] - sums[from]) / (to - from) as f64
            })
            .collect();
        let mut sorted = pulse.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[(share * (sorted.len() - 1) as f64) as usize];
        let height = at(0.95) - at(0.05);
        let scale = if height > 0.0 { 1.0 / height } else { 0.0 };
        // A spike of the sensor is no blood.
        let values = pulse.into_iter().map(|value| (scale * value).clamp(-1.5, 1.5)).collect();
        let times_seconds = times.iter().map(|time| time - FINGER_DELAY_SECONDS).collect();
        Self { supplied: Some((ppg.clone(), Series { times_seconds, values })), ..self }
    }

    /// Onsets of beats: a steady rhythm plus respiratory arrhythmia, a slow 0.1 Hz wave and noise, scaled so that the
    /// intervals have exactly the mean and standard deviation asked for.
    fn place_beats(&self, heart: Heart, seconds: f64) -> Vec<f64> {
        let mean = 60.0 / heart.rate_bpm;
        let count = ((seconds + 2.0 * MARGIN_SECONDS) / mean).ceil() as usize + 2;
        let random = Random::new(heart.seed, Stream::Beats);
        let slow_phase = random.between(0, 0.0, TAU);
        let raw: Vec<f64> = (0..count)
            .map(|beat| {
                let time = beat as f64 * mean - MARGIN_SECONDS;
                // Variances 0.5 : 0.3 : 0.2, a common split of a resting spectrum into its HF and LF bands.
                self.breath(time) + 0.77 * (TAU * 0.1 * time + slow_phase).sin() + 0.45 * random.normal(beat as u64 + 1)
            })
            .collect();
        let average = raw.iter().sum::<f64>() / count as f64;
        let spread = (raw.iter().map(|value| (value - average).powi(2)).sum::<f64>() / count as f64).sqrt();
        let scale = if spread > 0.0 { heart.sdnn_ms * 1e-3 / spread } else { 0.0 };
        let mut time = -MARGIN_SECONDS - mean * random.uniform(0);
        let mut beats = Vec::with_capacity(count + 1);
        for value in raw {
            beats.push(time);
            time += (mean + scale * (value - average)).clamp(0.4 * mean, 1.6 * mean);
        }
        beats.push(time);
        beats
    }

    /// Breathing movement, in [−1, 1].
    pub(crate) fn breath(&self, seconds: f64) -> f64 {
        (TAU * self.respiration_hertz * seconds + self.respiration_phase).sin()
    }

    /// Blood-volume pulse in the face.
    pub(crate) fn pulse(&self, seconds: f64) -> f64 {
        if let Some((_, face)) = &self.supplied {
            return face.at(seconds);
        }
        self.wave(&FACE, 0, seconds)
    }

    /// Times of systolic peaks in the face within `[0, seconds]`; none are known of a supplied PPG.
    pub(crate) fn systolic_peaks_seconds(&self, seconds: f64) -> Vec<f64> {
        if self.supplied.is_some() {
            return Vec::new();
        }
        let peak = |pair: &[f64]| pair[0] + FACE.systole * (pair[1] - pair[0]);
        self.beats_seconds.windows(2).map(peak).filter(|time| (0.0..=seconds).contains(time)).collect()
    }

    /// What a finger sensor records from 0 to `seconds`: delayed, of another shape, with wander and noise, in arbitrary
    /// units about 1.
    pub(crate) fn contact_trace(&self, seconds: f64) -> Result<Series, SpaceError> {
        if let Some((contact, _)) = &self.supplied {
            return Ok(contact.clone());
        }
        let count = (seconds * CONTACT_HERTZ).ceil() as usize + 1;
        let times: Vec<f64> = (0..count).map(|sample| sample as f64 / CONTACT_HERTZ).collect();
        let values = times
            .iter()
            .enumerate()
            .map(|(sample, time)| {
                let pulse = self.wave(&FINGER, 1, time - FINGER_DELAY_SECONDS);
                1.0 + 0.2 * (pulse + CONTACT_NOISE * self.contact.normal(sample as u64))
            })
            .collect();
        Series::new(times, values)
    }

    fn wave(&self, wave: &Wave, site: usize, seconds: f64) -> f64 {
        let after = self.beats_seconds.partition_point(|beat| *beat <= seconds).clamp(1, self.beats_seconds.len() - 1);
        let (from, to) = (self.beats_seconds[after - 1], self.beats_seconds[after]);
        let phase = ((seconds - from) / (to - from)).clamp(0.0, 1.0);
        let breath = self.breath(seconds);
        let height = 1.0 - RESPIRATORY_AMPLITUDE * (0.5 + 0.5 * breath);
        height * (wave.at(phase) - self.mean_of_wave[site]) + RESPIRATORY_WANDER[site] * breath
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const HEART: Heart = Heart { rate_bpm: 66.0, sdnn_ms: 45.0, seed: 11 };

    #[test]
    fn beats_have_the_rate_and_the_variability_asked_for() {
        let physiology = Physiology::new(HEART, 60.0);
        let intervals: Vec<f64> = physiology.beats_seconds.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mean = intervals.iter().sum::<f64>() / intervals.len() as f64;
        let variance = intervals.iter().map(|i| (i - mean).powi(2)).sum::<f64>() / intervals.len() as f64;
        assert!((60.0 / mean - 66.0).abs() < 1e-6, "{}", 60.0 / mean);
        assert!((variance.sqrt() - 0.045).abs() < 1e-6, "{}", variance.sqrt());
        let steady = Physiology::new(Heart { sdnn_ms: 0.0, ..HEART }, 60.0);
        assert!(steady.beats_seconds.windows(2).all(|pair| (pair[1] - pair[0] - 60.0 / 66.0).abs() < 1e-9));
    }

    #[test]
    fn a_wave_has_a_systolic_and_a_diastolic_peak_and_closes_on_itself() {
        for wave in [FACE, FINGER] {
            let heights: Vec<f64> = (0..=400).map(|i| wave.at(f64::from(i) / 400.0)).collect();
            assert!((heights[0] - heights[400]).abs() < 1e-9, "{} {}", heights[0], heights[400]);
            let highest = heights.iter().copied().fold(f64::MIN, f64::max);
            let lowest = heights.iter().copied().fold(f64::MAX, f64::min);
            assert!((highest - lowest - 1.0).abs() < 0.06, "height {}", highest - lowest);
            let turns = heights.windows(3).filter(|h| h[1] > h[0] && h[1] >= h[2]).count();
            assert_eq!(turns, 2, "a dicrotic notch parts two waves");
        }
    }

    #[test]
    fn a_supplied_trace_is_the_blood_whatever_its_unit_and_drift() {
        let own = Physiology::new(HEART, 20.0);
        let contact = own.contact_trace(20.0).unwrap();
        let drifting = contact.times_seconds.iter().zip(&contact.values).map(|(t, v)| 40.0 * v + 3.0 * t).collect();
        let drifting = Series::new(contact.times_seconds, drifting).unwrap();
        let follower = Physiology::new(Heart { rate_bpm: 120.0, seed: 3, ..HEART }, 20.0).following(&drifting);
        let times: Vec<f64> = (60..540).map(|t| f64::from(t) / 30.0).collect();
        let (mut together, mut a, mut b) = (0.0, 0.0, 0.0);
        for time in &times {
            let (x, y) = (own.pulse(*time), follower.pulse(*time));
            together += x * y;
            a += x * x;
            b += y * y;
        }
        let correlation = together / (a * b).sqrt();
        assert!(correlation > 0.9 && (b / a).sqrt() > 0.7 && (b / a).sqrt() < 1.4, "{correlation} {}", (b / a).sqrt());
        assert_eq!(follower.contact_trace(20.0).unwrap(), drifting);
    }

    #[test]
    fn the_finger_lags_the_face() {
        let physiology = Physiology::new(HEART, 30.0);
        let contact = physiology.contact_trace(30.0).unwrap();
        assert!((contact.rate_hertz() - CONTACT_HERTZ).abs() < 1e-6);
        let score = |lag: f64| -> f64 {
            contact.times_seconds.iter().zip(&contact.values).map(|(t, v)| (v - 1.0) * physiology.pulse(t - lag)).sum()
        };
        let best = (0..40).map(|i| f64::from(i) * 0.01).max_by(|a, b| score(*a).total_cmp(&score(*b))).unwrap();
        assert!((0.03..0.12).contains(&best), "{best}");
    }
}
