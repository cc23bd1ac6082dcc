//! A prescribed pulse: heart rate, heart-rate variability and two-Gaussian beats, no recording needed.

use crate::error::PulseError;
use crate::numeric::{Random, wrap};
use crate::waveform::Waveform;

use super::{Reference, check_clip, mean_bpm};

/// Frames a beat below which a frame rate cannot carry the pulse's first harmonic with room to spare.
const LEAST_FRAMES_PER_BEAT: f64 = 3.0;
/// Frequencies of the slow (Mayer) and the respiratory component of heart-rate variability, hertz.
const SLOW_HERTZ: f64 = 0.1;
const RESPIRATION_HERTZ: f64 = 0.25;
/// Variation of RR intervals is limited to this share of the interval: beats stay in order.
const MOST_VARIATION: f64 = 0.4;

/// What to prescribe.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Prescription {
    /// Mean heart rate over the clip, bpm, in [20, 300].
    pub heart_rate_bpm: f64,
    /// Standard deviation of beat intervals, seconds, in [0, 0.3]; half slow, half respiratory. 0.03–0.05 at rest.
    pub sdnn_seconds: f64,
    /// Seed of the variation's phases.
    pub seed: u64,
    /// The shape of a beat.
    pub waveform: Waveform,
}

impl Default for Prescription {
    fn default() -> Self {
        Self { heart_rate_bpm: 72.0, sdnn_seconds: 0.0, seed: 0, waveform: Waveform::default() }
    }
}

impl Prescription {
    /// The reference at frame times. Its phase is exact: nothing is detected.
    ///
    /// # Errors
    /// When the clip is too short, a parameter is out of range, or the frame rate cannot carry the heart rate.
    pub fn reference(&self, times_seconds: &[f64]) -> Result<Reference, PulseError> {
        let frame_rate = check_clip(times_seconds)?;
        let bpm = self.heart_rate_bpm;
        if !(20.0..=300.0).contains(&bpm) {
            return Err(PulseError::Parameter { name: "heart_rate_bpm", value: bpm, range: "20 to 300" });
        }
        if !(0.0..=0.3).contains(&self.sdnn_seconds) {
            let (name, value) = ("sdnn_seconds", self.sdnn_seconds);
            return Err(PulseError::Parameter { name, value, range: "0 to 0.3" });
        }
        let needed = LEAST_FRAMES_PER_BEAT * bpm / 60.0;
        if frame_rate < needed {
            return Err(PulseError::Undersampled { bpm, needed, found: frame_rate });
        }
        let phase = self.phase(times_seconds);
        let waveform = phase.iter().map(|&phase| self.waveform.at(wrap(phase))).collect();
        let beat = phase.iter().map(|phase| (phase / std::f64::consts::TAU).floor().max(0.0) as u32).collect();
        Ok(Reference {
            times_seconds: times_seconds.to_vec(),
            waveform,
            mean_bpm: mean_bpm(times_seconds, &phase),
            confidence: vec![1.0; phase.len()],
            beat,
            phase,
            inverted: false,
        })
    }

    /// ∫ of the instantaneous rate: mean rate plus two sinusoids whose interval deviation is `sdnn_seconds`, corrected
    /// by a constant rate so that the turns over the clip are those of the prescribed mean.
    fn phase(&self, times_seconds: &[f64]) -> Vec<f64> {
        use std::f64::consts::{SQRT_2, TAU};
        let mut random = Random::new(self.seed);
        let hertz = self.heart_rate_bpm / 60.0;
        // dRR/RR = −df/f; two equal sinusoids of amplitude a have together the deviation a.
        let depth = (self.sdnn_seconds * hertz).min(MOST_VARIATION / SQRT_2);
        let parts = [SLOW_HERTZ, RESPIRATION_HERTZ].map(|frequency| (frequency, TAU * random.unit()));
        let start = times_seconds[0];
        let wander = |time: f64| -> f64 {
            let integral = |(frequency, shift): &(f64, f64)| {
                let angle = TAU * frequency * (time - start) + shift;
                (shift.cos() - angle.cos()) / (TAU * frequency)
            };
            hertz * depth * parts.iter().map(integral).sum::<f64>()
        };
        let last = times_seconds[times_seconds.len() - 1];
        let correction = wander(last) / (last - start);
        let turns = |time: f64| hertz * (time - start) + wander(time) - correction * (time - start);
        let shift = random.unit();
        times_seconds.iter().map(|&time| TAU * (turns(time) + shift)).collect()
    }
}
