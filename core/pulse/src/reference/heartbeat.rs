//! When beats fall and how strong each is: a prescribed rhythm, with exact mean and deviation of its intervals.
//!
//! A sinus rhythm's intervals vary slowly (0.05–0.14 Hz, the Mayer band) and with the breath (respiratory sinus
//! arrhythmia), in a prescribed ratio of powers; an irregular one's vary freely from beat to beat, as in atrial
//! fibrillation. Ectopic beats come early and weak and are followed by a pause that makes up for it. Over the intervals
//! that touch the clip, mean and standard deviation (n − 1, before ectopic beats are put in) are those prescribed.

use std::f64::consts::TAU;

use crate::error::PulseError;
use crate::numeric::{Random, mean};

use super::Prescription;

/// How intervals vary.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Rhythm {
    /// Slowly and with the breath.
    #[default]
    Sinus,
    /// Freely from beat to beat, as in atrial fibrillation.
    Irregular,
}

/// Beats around a clip, in time order, at least four.
#[derive(Clone, Debug, PartialEq)]
pub struct Heartbeat {
    /// Systolic peaks, seconds.
    pub seconds: Vec<f64>,
    /// Strength of each beat, 1 as usual.
    pub strength: Vec<f64>,
}

/// Slow components and where they lie, hertz.
const SLOW_HERTZ: [f64; 5] = [0.053, 0.075, 0.094, 0.113, 0.137];
/// Respiratory components relative to the breath.
const BREATHS: [f64; 3] = [0.93, 1.0, 1.07];
/// Largest deviation of intervals as a share of their mean: beats stay in order.
const MOST_DEVIATION: f64 = 0.25;
/// Farthest an interval of an irregular rhythm departs, in deviations.
const MOST_SIGMA: f64 = 2.0;
/// An ectopic beat: its interval as a share of the usual one, its strength, and the strength of the beat after the pause.
const ECTOPIC: (f64, f64, f64) = (0.62, 0.55, 1.15);
/// Ordinary beats between ectopic ones, at least.
const BETWEEN_ECTOPIC: usize = 3;
/// Beats beyond either end of the clip.
const MARGIN_BEATS: usize = 3;

impl Heartbeat {
    /// The beats of a prescription over a clip.
    ///
    /// # Errors
    /// When the variation is too large for the rate, cannot be told at that rate, or the clip holds too few beats for it.
    pub(super) fn prescribed(p: &Prescription, first_seconds: f64, last_seconds: f64) -> Result<Self, PulseError> {
        let interval = 60.0 / p.heart_rate_bpm;
        let inside = ((last_seconds - first_seconds) / interval).ceil() as usize + 1;
        let deviations = p.deviations(interval, inside)?;
        let mut random = Random::new(p.seed.wrapping_add(2));
        let start = first_seconds - random.unit() * interval;
        let mut beats = Self { seconds: Vec::new(), strength: Vec::new() };
        let mut sum = 0.0;
        for k in 0..inside + 2 * MARGIN_BEATS + 1 {
            let turn = k as f64 - MARGIN_BEATS as f64;
            // Multiplied, not added up, so that a steady rate is exact after hours.
            beats.seconds.push(start + turn * interval + sum);
            beats.strength.push(1.0);
            sum += k.checked_sub(MARGIN_BEATS).and_then(|k| deviations.get(k)).unwrap_or(&0.0);
        }
        beats.put_ectopic(p, inside, &mut random);
        Ok(beats)
    }

    /// Moves some beats forward: the pause after them makes up for it.
    fn put_ectopic(&mut self, p: &Prescription, inside: usize, random: &mut Random) {
        let minutes = inside as f64 / p.heart_rate_bpm;
        let wanted = (p.ectopic_per_minute * minutes).round() as usize;
        let spacing = BETWEEN_ECTOPIC + 1;
        let count = wanted.min(inside.saturating_sub(spacing) / spacing);
        for k in 0..count {
            // One in each equal share of the clip, somewhere that keeps clear of the next.
            let share = (inside as f64 - spacing as f64) / count as f64;
            let free = (share - spacing as f64).max(0.0);
            let beat = MARGIN_BEATS + 2 + (k as f64 * share + free * random.unit()) as usize;
            let before = self.seconds[beat - 1];
            self.seconds[beat] = before + ECTOPIC.0 * (self.seconds[beat] - before);
            (self.strength[beat], self.strength[beat + 1]) = (ECTOPIC.1, ECTOPIC.2);
        }
    }

    /// Strength at a moment: that of the nearer systolic peak, passing over during the diastole between.
    pub fn strength_at(&self, seconds: f64) -> f64 {
        let last = self.seconds.len() - 1;
        let after = self.seconds.partition_point(|&beat| beat <= seconds).clamp(1, last);
        let (from, to) = (self.seconds[after - 1], self.seconds[after]);
        let s = (((seconds - from) / (to - from) - 0.45) / 0.35).clamp(0.0, 1.0);
        let eased = s * s * (3.0 - 2.0 * s);
        self.strength[after - 1] + eased * (self.strength[after] - self.strength[after - 1])
    }

    /// Shortest interval, seconds.
    pub fn shortest_seconds(&self) -> f64 {
        self.seconds.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min)
    }
}

impl Prescription {
    /// Deviations of the intervals that touch the clip, seconds: mean 0 and the prescribed standard deviation.
    fn deviations(&self, interval: f64, count: usize) -> Result<Vec<f64>, PulseError> {
        let sdnn = self.sdnn_seconds;
        if sdnn == 0.0 {
            return Ok(vec![0.0; count]);
        }
        if sdnn > MOST_DEVIATION * interval {
            let range = "at most a quarter of the mean beat interval; lower it or slow the heart";
            return Err(PulseError::Parameter { name: "sdnn_seconds", value: sdnn, range });
        }
        let needed = 4;
        if count < needed {
            let (seconds, needed_seconds) = (count as f64 * interval, needed as f64 * interval);
            return Err(PulseError::Short { frames: count, seconds, needed, needed_seconds });
        }
        let mut random = Random::new(self.seed);
        let mut values: Vec<f64> = match self.rhythm {
            Rhythm::Irregular => {
                let draw = |_| random.normal().clamp(-MOST_SIGMA, MOST_SIGMA);
                (0..count).map(draw).collect()
            }
            Rhythm::Sinus => {
                let breath = self.breaths_per_minute / 60.0;
                if breath * BREATHS[2] >= 0.5 / interval {
                    let range = "below half the heart rate, or its arrhythmia cannot be told from a slower one";
                    let (name, value) = ("breaths_per_minute", self.breaths_per_minute);
                    return Err(PulseError::Parameter { name, value, range });
                }
                let slow = mixture(&SLOW_HERTZ, interval, count, &mut random);
                let fast = mixture(&BREATHS.map(|share| share * breath), interval, count, &mut random);
                let share = self.lf_hf / (1.0 + self.lf_hf);
                let mix = |(s, f): (&f64, &f64)| share.sqrt() * s + (1.0 - share).sqrt() * f;
                slow.iter().zip(&fast).map(mix).collect()
            }
        };
        standardise(&mut values);
        values.iter_mut().for_each(|value| *value *= sdnn);
        Ok(values)
    }
}

/// Sum of sinusoids of random phase at the beats of a steady rate, of deviation 1.
fn mixture(hertz: &[f64], interval: f64, count: usize, random: &mut Random) -> Vec<f64> {
    let parts: Vec<(f64, f64)> = hertz.iter().map(|&hertz| (hertz, TAU * random.unit())).collect();
    let at = |k: usize| parts.iter().map(|(hertz, shift)| (TAU * hertz * k as f64 * interval + shift).sin()).sum();
    let mut values: Vec<f64> = (0..count).map(at).collect();
    standardise(&mut values);
    values
}

/// Mean 0 and sample deviation 1; zeros where nothing varies.
fn standardise(values: &mut [f64]) {
    let centre = mean(values);
    let square: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    let deviation = (square / (values.len().max(2) - 1) as f64).sqrt();
    let scale = if deviation > 1e-12 { 1.0 / deviation } else { 0.0 };
    values.iter_mut().for_each(|value| *value = scale * (*value - centre));
}
