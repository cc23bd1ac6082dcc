//! A prescribed pulse: heart rate, variability, breath, ectopic beats and two-Gaussian beats, no recording needed; or the
//! beats of a list.
//!
//! The phase is exact: nothing is detected, and after hours it is where it should be.

use std::f64::consts::TAU;

use heartian_signal::beats::beat_aligned_phase;

use crate::error::{PulseError, check_finite};
use crate::numeric::wrap;
use crate::waveform::Waveform;

use super::heartbeat::{Heartbeat, Rhythm};
use super::{Reference, check_clip, mean_bpm};

/// Frames a beat below which a frame rate cannot carry the pulse's first harmonic with room to spare.
const LEAST_FRAMES_PER_BEAT: f64 = 3.0;
/// The same of the shortest single interval.
const LEAST_FRAMES_PER_INTERVAL: f64 = 2.0;
/// How far a list of beats may end from the clip's ends, in its own intervals.
const SLACK_INTERVALS: f64 = 2.0;

/// What to prescribe.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Prescription {
    /// Mean heart rate over the clip, bpm, in [20, 300].
    pub heart_rate_bpm: f64,
    /// Standard deviation of beat intervals, seconds, in [0, 0.3] and at most a quarter of the interval. 0.03–0.05 at rest.
    pub sdnn_seconds: f64,
    /// Power of the slow variation of intervals over that of the respiratory one, in [0.05, 20].
    pub lf_hf: f64,
    /// How intervals vary.
    pub rhythm: Rhythm,
    /// Breaths a minute, in [9, 24]: within the respiratory band of variability.
    pub breaths_per_minute: f64,
    /// Swing of the baseline with the breath, as a share of a beat's height, in [0, 1].
    pub breath_baseline: f64,
    /// Swing of the beats' height with the breath, as a share of it, in [0, 0.9].
    pub breath_amplitude: f64,
    /// Ectopic beats a minute, in [0, 30].
    pub ectopic_per_minute: f64,
    /// Seed of all that varies.
    pub seed: u64,
    /// The shape of a beat.
    pub waveform: Waveform,
}

impl Default for Prescription {
    fn default() -> Self {
        Self {
            heart_rate_bpm: 72.0,
            sdnn_seconds: 0.0,
            lf_hf: 1.0,
            rhythm: Rhythm::Sinus,
            breaths_per_minute: 15.0,
            breath_baseline: 0.0,
            breath_amplitude: 0.0,
            ectopic_per_minute: 0.0,
            seed: 0,
            waveform: Waveform::default(),
        }
    }
}

impl Prescription {
    /// The reference at frame times.
    ///
    /// # Errors
    /// When the clip is too short, a parameter is out of range, or the frame rate cannot carry the heart rate.
    pub fn reference(&self, times_seconds: &[f64]) -> Result<Reference, PulseError> {
        let frame_rate = check_clip(times_seconds)?;
        self.check()?;
        let needed = LEAST_FRAMES_PER_BEAT * self.heart_rate_bpm / 60.0;
        if frame_rate < needed {
            return Err(PulseError::Undersampled { bpm: self.heart_rate_bpm, needed, found: frame_rate });
        }
        let last = times_seconds[times_seconds.len() - 1];
        let beats = Heartbeat::prescribed(self, times_seconds[0], last)?;
        Reference::from_heartbeat(&beats, times_seconds, self)
    }

    fn check(&self) -> Result<(), PulseError> {
        for (name, value, low, high, range) in [
            ("heart_rate_bpm", self.heart_rate_bpm, 20.0, 300.0, "20 to 300"),
            ("sdnn_seconds", self.sdnn_seconds, 0.0, 0.3, "0 to 0.3"),
            ("lf_hf", self.lf_hf, 0.05, 20.0, "0.05 to 20"),
            ("breaths_per_minute", self.breaths_per_minute, 9.0, 24.0, "9 to 24"),
            ("breath_baseline", self.breath_baseline, 0.0, 1.0, "0 to 1"),
            ("breath_amplitude", self.breath_amplitude, 0.0, 0.9, "0 to 0.9"),
            ("ectopic_per_minute", self.ectopic_per_minute, 0.0, 30.0, "0 to 30"),
        ] {
            if !(low..=high).contains(&value) {
                return Err(PulseError::Parameter { name, value, range });
            }
        }
        Ok(())
    }
}

impl Reference {
    /// From the times of systolic peaks on the clip's clock, all of the same height.
    ///
    /// # Errors
    /// When there are fewer than two beats, they are out of order, do not reach over the clip (to two intervals at
    /// either end), or follow one another faster than the frame rate can carry.
    pub fn from_beats(peaks_seconds: &[f64], times_seconds: &[f64]) -> Result<Self, PulseError> {
        check_clip(times_seconds)?;
        check_finite("the beat times", peaks_seconds)?;
        let count = peaks_seconds.len();
        if count < 2 {
            return Err(PulseError::NoBeats(format!("it lists {count} beats where two or more are needed")));
        }
        let (from, to) = (peaks_seconds[0], peaks_seconds[count - 1]);
        let slack = SLACK_INTERVALS * (to - from) / (count - 1) as f64;
        let (wanted_from, wanted_to) = (times_seconds[0], times_seconds[times_seconds.len() - 1]);
        if from > wanted_from + slack || to < wanted_to - slack {
            let what = "the list of beats";
            return Err(heartian_space::SpaceError::Span { what, from, to, wanted_from, wanted_to }.into());
        }
        let beats = Heartbeat { seconds: peaks_seconds.to_vec(), strength: vec![1.0; count] };
        Self::from_heartbeat(&beats, times_seconds, &Prescription::default())
    }

    /// Phase, waveform and envelope at frame times; shape and breath are the prescription's.
    fn from_heartbeat(beats: &Heartbeat, times_seconds: &[f64], p: &Prescription) -> Result<Self, PulseError> {
        let frame_rate = check_clip(times_seconds)?;
        let phase = beat_aligned_phase(times_seconds, &beats.seconds)?;
        let shortest = beats.shortest_seconds();
        let needed = LEAST_FRAMES_PER_INTERVAL / shortest;
        if frame_rate < needed {
            return Err(PulseError::Undersampled { bpm: 60.0 / shortest, needed, found: frame_rate });
        }
        let breath = |time: f64| (TAU * p.breaths_per_minute / 60.0 * (time - times_seconds[0])).sin();
        let gain: Vec<f64> = times_seconds
            .iter()
            .map(|&time| beats.strength_at(time) * (1.0 + p.breath_amplitude * breath(time)))
            .collect();
        let height = p.waveform.peak_to_peak();
        let baseline: Vec<f64> =
            times_seconds.iter().map(|&time| 0.5 * p.breath_baseline * height * breath(time)).collect();
        let value = |((phase, gain), base): ((&f64, &f64), &f64)| gain * p.waveform.at(wrap(*phase)) + base;
        let waveform = phase.phase_radians.iter().zip(&gain).zip(&baseline).map(value).collect();
        Ok(Self {
            times_seconds: times_seconds.to_vec(),
            waveform,
            mean_bpm: mean_bpm(times_seconds, &phase.phase_radians),
            confidence: vec![1.0; times_seconds.len()],
            beat: phase.beat_index.iter().map(|&beat| beat as u32).collect(),
            phase: phase.phase_radians,
            inverted: false,
            envelope: Envelope { gain, baseline },
        })
    }
}

/// How the fundamental of each frame departs from the plain waveform: `gain·u(θ) + baseline`. What a prescription knows of
/// breath and weak beats; a plain recording leaves it to the residual.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Envelope {
    /// One factor a frame, or none for 1 throughout.
    pub gain: Vec<f64>,
    /// One summand a frame in the waveform's unit, or none for 0 throughout.
    pub baseline: Vec<f64>,
}

impl Envelope {
    /// `gain·u + baseline`, in place.
    pub fn apply(&self, shape: &mut [f64]) {
        self.scale(shape);
        shape.iter_mut().zip(&self.baseline).for_each(|(value, base)| *value += base);
    }

    /// `gain·u`, in place: also the transpose of [`Self::apply`]'s slope.
    pub fn scale(&self, shape: &mut [f64]) {
        shape.iter_mut().zip(&self.gain).for_each(|(value, gain)| *value *= gain);
    }
}
