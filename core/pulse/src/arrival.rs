//! The fundamental as it reaches each Gaussian: scaled by the skin's strength map and late by its delay map.
//!
//! `F_i(t) = strength_i · F(t − delay_i)`. Delays are small against a beat and alike for many Gaussians, so F is evaluated
//! at a few dozen delays (a millisecond apart or finer) from the phase itself, and taken linearly between them.

use heartian_space::{Perfusion, Skin};

use crate::numeric::wrap;
use crate::pulse::Pulse;

/// Distance of the delays at which the fundamental is evaluated, seconds, and most of them.
const STEP_SECONDS: f64 = 1e-3;
const MOST_STEPS: usize = 64;

/// The fundamental at a few delays.
pub(crate) struct Arrival<'a> {
    perfusion: &'a Perfusion,
    /// Frames × delays, linear albedo.
    table: Vec<f32>,
    delays: usize,
    least_seconds: f64,
    step_seconds: f64,
}

impl<'a> Arrival<'a> {
    /// Evaluates what the skin's map asks for.
    pub fn new(pulse: &Pulse, skin: &'a Skin) -> Self {
        let perfusion = &skin.perfusion;
        let values = || perfusion.delay_seconds.iter().map(|&delay| f64::from(delay));
        let (low, high) = values().fold((0.0f64, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
        let delays =
            if high > low { (((high - low) / STEP_SECONDS).ceil() as usize + 1).clamp(2, MOST_STEPS) } else { 1 };
        let step_seconds = (high - low) / (delays.max(2) - 1) as f64;
        let columns: Vec<Vec<f64>> = if delays == 1 {
            vec![pulse.fundamental.clone()]
        } else {
            let source = Source::new(pulse);
            (0..delays).map(|k| source.late(low + step_seconds * k as f64)).collect()
        };
        let table = (0..pulse.len()).flat_map(|t| columns.iter().map(move |column| column[t] as f32)).collect();
        Self { perfusion, table, delays, least_seconds: low, step_seconds }
    }

    /// The fundamental at one frame and Gaussian.
    #[inline]
    pub fn at(&self, frame: usize, gaussian: usize) -> f32 {
        let row = &self.table[frame * self.delays..(frame + 1) * self.delays];
        if self.perfusion.is_even() {
            return row[0];
        }
        let strength = self.perfusion.strength[gaussian];
        if self.delays == 1 {
            return strength * row[0];
        }
        let late = (f64::from(self.perfusion.delay_seconds[gaussian]) - self.least_seconds) / self.step_seconds;
        let below = (late as usize).min(self.delays - 2);
        strength * (row[below] + (late as f32 - below as f32) * (row[below + 1] - row[below]))
    }

    /// The skin's strength at a Gaussian.
    #[inline]
    pub fn strength(&self, gaussian: usize) -> f32 {
        self.perfusion.strength.get(gaussian).copied().unwrap_or(1.0)
    }
}

/// The fundamental between frames: u at the phase there, which is exact at any moment, plus what the envelope adds.
struct Source<'a> {
    pulse: &'a Pulse,
    unwrapped: Vec<f64>,
    /// shape − u(θ) at the frames.
    added: Vec<f64>,
}

impl<'a> Source<'a> {
    fn new(pulse: &'a Pulse) -> Self {
        let mut reached = pulse.theta.first().copied().unwrap_or(0.0);
        let unwrap = |theta: &f64| {
            reached += wrap(theta - reached);
            reached
        };
        let plain = pulse.waveform.evaluate(&pulse.theta);
        let added = pulse.shape().iter().zip(&plain).map(|(shape, u)| shape - u).collect();
        Self { pulse, unwrapped: pulse.theta.iter().map(unwrap).collect(), added }
    }

    /// F(t − delay) at every frame; beyond the clip's ends the rate of the first or last frames goes on.
    fn late(&self, delay_seconds: f64) -> Vec<f64> {
        let (times, strength) = (&self.pulse.times_seconds, &self.pulse.strength);
        let mut after = 1;
        let last = times.len() - 1;
        (0..times.len())
            .map(|t| {
                let at = times[t] - delay_seconds;
                if last == 0 {
                    return self.pulse.fundamental[t];
                }
                while after < last && times[after] < at {
                    after += 1;
                }
                let share = (at - times[after - 1]) / (times[after] - times[after - 1]);
                let theta = self.unwrapped[after - 1] + share * (self.unwrapped[after] - self.unwrapped[after - 1]);
                let inside = share.clamp(0.0, 1.0);
                let added = self.added[after - 1] + inside * (self.added[after] - self.added[after - 1]);
                strength.scale * (self.pulse.waveform.at(theta) + added - strength.level)
            })
            .collect()
    }
}
