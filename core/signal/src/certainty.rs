//! How sure a heart rate is: the chance, between 0 and 1, that it lies within 5 bpm of the truth.
//!
//! Signs are read from the recording itself: the SNR at the rate found, by how much its peak tops the next one, and how many
//! other methods find the same rate. A logistic function of them, fitted to simulated recordings (pulse, light, motion,
//! speculars and noise of widely varied strength; `tests/certainty.rs` fits it again and checks it on recordings it has not
//! seen), turns them into one number. How many windows of the recording give the same rate by themselves is told beside it
//! but not weighed: in the fit it adds nothing, since a steady disturbance makes windows agree as well as a heart does.
//! The number speaks of recordings like those; a method that is wrong in the same way all along, as under flicker at a
//! heart's rate, is believed.

use crate::error::Result;
use crate::protocol::{HeartRate, Protocol};
use crate::reading::WindowRate;

/// Windows that are read by themselves, seconds; of a shorter recording two thirds.
const WINDOW_SECONDS: f64 = 10.0;
/// Least length of a window, seconds: five beats at 60 bpm.
const LEAST_SECONDS: f64 = 5.0;
/// A window that agrees differs by at most this, bpm: hearts wander, and ten seconds resolve 6 bpm.
const WINDOW_AGREES_BPM: f64 = 6.0;
/// A method that agrees differs by at most this over the whole recording, bpm.
const METHOD_AGREES_BPM: f64 = 3.0;
/// A peak further away than this from the rate and its harmonic is another rate, hertz.
const OTHER_PEAK_HERTZ: f64 = 0.2;
/// Signs of strength are cut off here, dB: stronger says nothing more.
const MOST_DB: f64 = 15.0;

/// What speaks for a heart rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// SNR at the rate found, dB (flattered by having been found).
    pub snr_db: f64,
    /// Power of the peak over the strongest other peak of the band that is no harmonic of it, dB.
    pub prominence_db: f64,
    /// Share of windows that give the same rate, in [0, 1].
    pub windows: f64,
    /// Share of the other methods that give the same rate, in [0, 1]; ½ when there is none.
    pub methods: f64,
}

impl Evidence {
    /// The signs as the logistic function takes them: a constant, both strengths in tens of dB, the share of methods.
    pub fn signs(&self) -> [f64; 4] {
        let strength = |db: f64| if db.is_nan() { -MOST_DB } else { db.clamp(-MOST_DB, MOST_DB) } / 10.0;
        [1.0, strength(self.snr_db), strength(self.prominence_db), self.methods]
    }

    /// The chance that the rate is right to 5 bpm, in (0, 1).
    pub fn confidence(&self) -> f64 {
        let sum: f64 = self.signs().iter().zip(FITTED).map(|(sign, weight)| sign * weight).sum();
        1.0 / (1.0 + (-sum).exp())
    }
}

/// Weights of [`Evidence::signs`], as the fit of `tests/certainty.rs` gives them, rounded to what another set of recordings
/// changes in them (1,500 others: −1.66, 1.02, 3.33, 1.61).
const FITTED: [f64; 4] = [-1.6, 1.1, 3.3, 1.8];

/// Windows of a trace that is sampled evenly, half overlapping, each read by itself. Windows that carry no rate are left
/// out; none when the trace is too short.
pub fn window_rates(trace: &[f64], rate_hertz: f64, protocol: &Protocol) -> Vec<WindowRate> {
    let seconds = trace.len() as f64 / rate_hertz;
    let length = (WINDOW_SECONDS.min(seconds * 2.0 / 3.0).max(LEAST_SECONDS) * rate_hertz) as usize;
    let hop = (length / 2).max(1);
    if length == 0 || length > trace.len() {
        return Vec::new();
    }
    let count = (trace.len() - length) / hop + 1;
    let read = |window: usize| {
        // Spread so that the last window ends with the trace.
        let spare = trace.len() - length;
        let from = if count > 1 { window * spare / (count - 1) } else { 0 };
        let found = protocol.estimate(&trace[from..from + length], rate_hertz).ok()?;
        let middle_seconds = (from as f64 + length as f64 / 2.0) / rate_hertz;
        Some(WindowRate { middle_seconds, bpm: found.bpm, confidence: found.confidence() })
    };
    (0..count.max(2)).filter_map(read).collect()
}

/// What speaks for `found`, which was read from `trace`; `others_bpm` are the rates other methods give.
///
/// # Errors
/// When the band holds no power.
pub fn evidence(found: &HeartRate, windows: &[WindowRate], others_bpm: &[f64]) -> Result<Evidence> {
    let share = |near: usize, all: usize| if all == 0 { 0.5 } else { near as f64 / all as f64 };
    let near = |bpm: f64, reach: f64| (bpm - found.bpm).abs() <= reach;
    Ok(Evidence {
        snr_db: found.snr_db(found.bpm),
        prominence_db: prominence_db(found)?,
        windows: share(windows.iter().filter(|w| near(w.bpm, WINDOW_AGREES_BPM)).count(), windows.len()),
        methods: share(others_bpm.iter().filter(|bpm| near(**bpm, METHOD_AGREES_BPM)).count(), others_bpm.len()),
    })
}

/// Power of the strongest bin over the strongest one that is neither near the rate found nor near its double.
fn prominence_db(found: &HeartRate) -> Result<f64> {
    let spectrum = &found.spectrum;
    let peak = spectrum.peak_bin(found.band)?;
    let first = found.bpm / 60.0;
    let other = |bin: &usize| {
        let hertz = spectrum.hertz(*bin);
        let away = |harmonic: f64| (hertz - harmonic).abs() > OTHER_PEAK_HERTZ;
        found.band.contains(hertz) && away(first) && away(2.0 * first)
    };
    let strongest = (0..spectrum.power.len()).filter(other).map(|bin| spectrum.power[bin]).fold(0.0, f64::max);
    Ok(if strongest > 0.0 { 10.0 * (spectrum.power[peak] / strongest).log10() } else { MOST_DB })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{Preset, estimate};

    fn trace(seconds: f64, noise: f64) -> Vec<f64> {
        let sample = |k: usize| {
            let mixed = (k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let random = ((mixed ^ (mixed >> 32)) % 10_000) as f64 / 5_000.0 - 1.0;
            (std::f64::consts::TAU * 1.2 * k as f64 / 30.0).sin() + noise * random
        };
        (0..(30.0 * seconds) as usize).map(sample).collect()
    }

    fn confidence(seconds: f64, noise: f64, others: &[f64]) -> Result<f64> {
        let (trace, preset) = (trace(seconds, noise), Preset::ToolboxFine);
        let windows = window_rates(&trace, 30.0, &preset.protocol());
        Ok(evidence(&estimate(&trace, 30.0, preset)?, &windows, others)?.confidence())
    }

    #[test]
    fn clean_traces_are_believed_and_noise_is_not() -> Result<()> {
        let (clean, drowned) = (confidence(30.0, 0.1, &[72.0, 72.4])?, confidence(30.0, 60.0, &[50.0, 110.0])?);
        assert!(clean > 0.9 && drowned < 0.4, "{clean} {drowned}");
        assert!(confidence(30.0, 0.1, &[140.0, 51.0])? < clean, "disagreement makes doubt");
        Ok(())
    }

    #[test]
    fn short_and_odd_traces_have_an_answer() {
        let protocol = Preset::ToolboxFine.protocol();
        assert!(window_rates(&[], 30.0, &protocol).is_empty());
        assert!(window_rates(&[1.0; 40], 30.0, &protocol).is_empty());
        assert!(window_rates(&[1.0; 400], 30.0, &protocol).is_empty(), "a flat trace has no rate");
        assert_eq!(window_rates(&trace(6.0, 0.0), 30.0, &protocol).len(), 2);
        let nothing = Evidence { snr_db: f64::NAN, prominence_db: f64::NEG_INFINITY, windows: 0.0, methods: 0.0 };
        assert!((0.0..0.5).contains(&nothing.confidence()));
    }
}
