//! A made PPG whose beats are known: two Gaussians a beat in phase, breathing in rate and height, a wandering baseline,
//! noise, and the faults that real sensors have.

use std::f64::consts::{PI, TAU};

/// What is wrong with a made PPG.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    None,
    /// Tops and bottoms cut off at this share of the height.
    Clipped(f64),
    /// Spikes of this many heights, about one in two seconds.
    Spikes(f64),
    /// Turned over.
    Inverted,
    /// Every tenth beat comes early by this share of a period, with a pause after it.
    Ectopic(f64),
    /// Every tenth beat is missing.
    Dropped,
    /// The height falls to this share in the middle third.
    Weak(f64),
    /// 8-bit steps: the height is this many codes.
    Quantised(f64),
}

/// A recording to make.
#[derive(Clone, Copy, Debug)]
pub struct Phantom {
    pub rate_hertz: f64,
    pub seconds: f64,
    pub bpm: f64,
    /// Standard deviation of white noise in a band of 15 Hz, in pulse heights.
    pub noise: f64,
    /// Height of the diastolic wave, in systolic heights.
    pub diastolic: f64,
    pub fault: Fault,
}

impl Default for Phantom {
    fn default() -> Self {
        Self { rate_hertz: 30.0, seconds: 60.0, bpm: 72.0, noise: 0.05, diastolic: 0.45, fault: Fault::None }
    }
}

/// A made recording: samples and the times of its visible systolic peaks.
pub struct Made {
    pub values: Vec<f64>,
    pub peaks: Vec<f64>,
}

/// Uniform in [0, 1) by index.
fn random(index: usize) -> f64 {
    let mixed = (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

fn normal(index: usize) -> f64 {
    (-2.0 * (1.0 - random(2 * index)).ln()).sqrt() * (TAU * random(2 * index + 1)).cos()
}

impl Phantom {
    /// Times of all systolic peaks, one before the start to one after the end.
    fn schedule(&self) -> Vec<f64> {
        let period = 60.0 / self.bpm;
        let mut times = vec![-0.7 * period];
        while times[times.len() - 1] < self.seconds + period {
            let last = times[times.len() - 1];
            // Respiratory sinus arrhythmia of ±4 % and 1 % of jitter.
            let step = period * (1.0 + 0.04 * (TAU * 0.22 * last).sin() + 0.01 * normal(times.len() + 77));
            times.push(last + step);
        }
        if let Fault::Ectopic(early) = self.fault {
            times.iter_mut().skip(5).step_by(10).for_each(|time| *time -= early * period);
        }
        times
    }

    /// Makes it.
    pub fn make(&self) -> Made {
        let schedule = self.schedule();
        let dropped = |beat: usize| self.fault == Fault::Dropped && beat % 10 == 5;
        let count = (self.seconds * self.rate_hertz) as usize;
        // White noise of one density whatever the rate: its deviation goes with the root of the bandwidth.
        let deviation = self.noise * (self.rate_hertz / 30.0).sqrt();
        let values = (0..count).map(|sample| {
            let time = sample as f64 / self.rate_hertz;
            let after = schedule.partition_point(|&peak| peak <= time);
            let (from, to) = (schedule[after - 1], schedule[after]);
            let phase = TAU * (time - from) / (to - from);
            let bump = |centre: f64, width: f64| {
                let distance = phase - centre;
                let distance = if distance > PI { distance - TAU } else { distance };
                (-distance * distance / (2.0 * width * width)).exp()
            };
            // The beat that a moment belongs to is that of its nearest systolic peak.
            let beat = if phase > 0.75 * TAU { after } else { after - 1 };
            let present = if dropped(beat) { 0.0 } else { 1.0 };
            let wave = present * (bump(0.0, 0.45) + self.diastolic * bump(1.9, 0.7));
            let breath = (TAU * 0.22 * time).sin();
            let height = (1.0 + 0.15 * breath) * self.weakness(time);
            height * wave + 0.5 * breath + 0.8 * (TAU * 0.05 * time).cos() + deviation * normal(sample)
        });
        let values = self.spoilt(values.collect());
        let visible =
            |(beat, &time): (usize, &f64)| (time > 0.1 && time < self.seconds - 0.1 && !dropped(beat)).then_some(time);
        Made { values, peaks: schedule.iter().enumerate().filter_map(visible).collect() }
    }

    fn weakness(&self, time: f64) -> f64 {
        let middle = time > self.seconds / 3.0 && time < 2.0 * self.seconds / 3.0;
        if let (Fault::Weak(share), true) = (self.fault, middle) { share } else { 1.0 }
    }

    fn spoilt(&self, mut values: Vec<f64>) -> Vec<f64> {
        match self.fault {
            Fault::Clipped(share) => {
                let high = values.iter().copied().fold(f64::MIN, f64::max);
                let low = values.iter().copied().fold(f64::MAX, f64::min);
                let cut = share * (high - low);
                values.iter_mut().for_each(|value| *value = value.clamp(low + cut, high - cut));
            }
            Fault::Spikes(height) => {
                let odds = 0.5 / self.rate_hertz;
                for (index, value) in values.iter_mut().enumerate() {
                    if random(index + 1_000_003) < odds {
                        *value += height * if random(index + 2_000_003) < 0.5 { -1.0 } else { 1.0 };
                    }
                }
            }
            Fault::Inverted => values.iter_mut().for_each(|value| *value = -*value),
            Fault::Quantised(codes) => values.iter_mut().for_each(|value| *value = (*value * codes).round()),
            _ => {}
        }
        values
    }
}
