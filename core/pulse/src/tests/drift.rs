//! Drift of the three parameterisations of phase, over seeds: on frames that were fitted, over half an hour, and on the
//! five minutes after them that were not, by what is known there. `cargo test -p heartian-pulse drift -- --nocapture`
//! prints the table.
#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::numeric::{mean, wrap};
use crate::{Known, Parameterization, Prescription, Rhythm};

const ALL: [Parameterization; 3] = [Parameterization::Cumulative, Parameterization::Direct, Parameterization::Anchored];
/// Of the recordings that are fitted in part: ten minutes at 30 frames a second, and the five minutes after them.
const FITTED: usize = 18_000;
const FRAMES: usize = 27_000;
const SEEDS: std::ops::Range<u64> = 1..9;
/// Student's t for a 95 % interval of a mean over eight.
const T_OF_8: f64 = 2.365;

/// The phase error unwrapped over time, from the first frame's.
fn errors(found: &[f64], truth: &[f64]) -> Vec<f64> {
    let mut reached = wrap(found[0] - truth[0]);
    let unwrap = |(a, b): (&f64, &f64)| {
        reached += wrap(a - b - reached);
        reached
    };
    found.iter().zip(truth).map(unwrap).collect()
}

/// Radians a minute: slope of the line through the error, without its sign.
fn drift(errors: &[f64]) -> f64 {
    let middle = 0.5 * (errors.len() - 1) as f64;
    let (mut product, mut square) = (0.0, 0.0);
    for (k, error) in errors.iter().enumerate() {
        let minutes = (k as f64 - middle) / 1800.0;
        product += minutes * error;
        square += minutes * minutes;
    }
    (product / square).abs()
}

fn rms(errors: &[f64]) -> f64 {
    mean(&errors.iter().map(|error| wrap(*error).powi(2)).collect::<Vec<_>>()).sqrt()
}

/// The first frames of a reference.
fn part(truth: &Reference, frames: usize) -> Reference {
    let cut = |values: &[f64]| values[..frames].to_vec();
    Reference {
        times_seconds: cut(&truth.times_seconds),
        waveform: cut(&truth.waveform),
        phase: cut(&truth.phase),
        confidence: cut(&truth.confidence),
        beat: truth.beat[..frames].to_vec(),
        envelope: crate::reference::Envelope::default(),
        ..truth.clone()
    }
}

/// Systolic peaks after the first frames, as a prescription or a PPG gives them.
fn beats_after(truth: &Reference, frames: usize) -> Vec<f64> {
    let turn = |phase: f64| phase / std::f64::consts::TAU;
    (frames..truth.len())
        .filter_map(|t| {
            let (from, to) = (turn(truth.phase[t - 1]), turn(truth.phase[t]));
            let share = (to.floor() - from) / (to - from);
            let step = truth.times_seconds[t] - truth.times_seconds[t - 1];
            (to.floor() > from).then_some(truth.times_seconds[t - 1] + share * step)
        })
        .collect()
}

/// The video's own pulse: a jitter of 0.35 rad a frame, smoothed over five, a fifth of it not believed and wrong.
fn seen(truth: &[f64], seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut random = Random::new(seed);
    let confidence: Vec<f64> = (0..truth.len()).map(|k| f64::from(k / 300 % 5 != 2)).collect();
    let jittered: Vec<f64> =
        truth.iter().zip(&confidence).map(|(p, c)| p + 0.35 * random.normal() + 2.0 * (1.0 - c)).collect();
    let around = |k: usize| mean(&jittered[k.saturating_sub(2)..(k + 3).min(jittered.len())]);
    ((0..truth.len()).map(|k| wrap(around(k))).collect(), confidence)
}

/// One row: the drift (radians a minute) and rms error (radians) of each seed.
#[derive(Default)]
struct Row(Vec<[f64; 2]>);

impl Row {
    fn add(&mut self, found: &[f64], truth: &[f64]) {
        let errors = errors(found, truth);
        self.0.push([drift(&errors), rms(&errors)]);
    }

    /// Mean over seeds and half of its 95 % interval.
    fn of(&self, which: usize) -> [f64; 2] {
        let values: Vec<f64> = self.0.iter().map(|row| row[which]).collect();
        let middle = mean(&values);
        let variance = values.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
        [middle, T_OF_8 * (variance / values.len() as f64).sqrt()]
    }

    fn show(&self) -> String {
        let ([drift, d], [rms, r]) = (self.of(0), self.of(1));
        format!("{drift:.4} ± {d:.4} | {rms:.3} ± {r:.3}")
    }
}

/// Drift on the five minutes after the fitted ten, by parameterisation and by what is known; and how far the expected
/// error, told beforehand, is from what came, at the end.
struct Beyond {
    plain: [Row; 3],
    beats: Row,
    video: Row,
    /// Mean squares of the error at the end: expected and found.
    told: [f64; 2],
}

fn beyond(rhythm: Rhythm, sdnn_seconds: f64) -> Beyond {
    let all = times(FRAMES as f64 / 30.0, 30.0);
    let later = &all[FITTED..];
    let mut rows = Beyond { plain: Default::default(), beats: Row::default(), video: Row::default(), told: [0.0; 2] };
    for seed in SEEDS {
        let prescription = Prescription { rhythm, sdnn_seconds, seed, ..Prescription::default() };
        let truth = prescription.reference(&all).unwrap();
        let (after, fitted) = (&truth.phase[FITTED..], part(&truth, FITTED));
        for (row, parameterization) in rows.plain.iter_mut().zip(ALL) {
            let options = PhaseOptions { parameterization, steps: 10, ..PhaseOptions::default() };
            let (pulse, _) = fit(&fitted, &options).unwrap();
            let go_on = |known: &Known<'_>| pulse.phase.continued(&all[..FITTED], later, known);
            let alone = go_on(&Known::Nothing);
            row.add(&alone.theta, after);
            if parameterization == Parameterization::Anchored {
                rows.beats.add(&go_on(&Known::Beats(&beats_after(&truth, FITTED))).theta, after);
                let (theta, confidence) = seen(after, seed);
                rows.video.add(&go_on(&Known::Video { theta: &theta, confidence: &confidence }).theta, after);
                let end = errors(&alone.theta, after)[later.len() - 1];
                let expected = alone.spread_radians[later.len() - 1];
                rows.told[0] += expected * expected / SEEDS.count() as f64;
                rows.told[1] += end * end / SEEDS.count() as f64;
            }
        }
    }
    rows
}

#[test]
fn beyond_the_fitted_frames_anchors_hold_what_is_known_and_say_what_is_not() {
    println!("5 min after 10 fitted, 8 seeds | drift rad/min | rms error rad");
    for (name, rhythm, sdnn) in [("sinus", Rhythm::Sinus, 0.045), ("irregular", Rhythm::Irregular, 0.08)] {
        let Beyond { plain, beats, video, told } = beyond(rhythm, sdnn);
        for (row, parameterization) in plain.iter().zip(ALL) {
            println!("{name}, nothing known, {parameterization:?} | {}", row.show());
        }
        println!("{name}, the video's pulse, Anchored | {}", video.show());
        println!("{name}, beats prescribed, Anchored | {}", beats.show());
        println!("{name}, expected error at the end {:.2} rad, found {:.2}", told[0].sqrt(), told[1].sqrt());
        // A prescription leaves nothing to drift, whatever the rhythm and the seed.
        assert!(beats.0.iter().all(|[drift, rms]| *drift < 2e-3 && *rms < 0.05), "{:?}", beats.0);
        // The video's pulse holds a sinus rhythm; of an irregular one whole beats may be lost in ten seconds unseen,
        // after which it is in step again.
        let [video_drift, video_rms] = [video.of(0)[0], video.of(1)[0]];
        let most_drift = if rhythm == Rhythm::Sinus { 0.04 } else { 0.6 * plain[2].of(0)[0] };
        assert!(video_drift < most_drift && video_rms < 0.7, "{:?}", video.0);
        // With nothing known, no worse than the cumulative's mean rate, which has the mean of these rhythms for free.
        let [cumulative, direct, anchored] = plain.each_ref().map(|row| row.of(0)[0]);
        assert!(anchored < 1.2 * cumulative && anchored < 0.01 * direct, "{cumulative} {direct} {anchored}");
        assert!(told[1].sqrt() < 2.0 * told[0].sqrt(), "{told:?}");
    }
}

#[test]
fn half_an_hour_that_is_fitted_does_not_drift() {
    let all = times(1800.0, 30.0);
    println!("30 min, all fitted | drift rad/min | rms error rad | rms error of the last minute");
    for seed in [4, 5] {
        let prescription = Prescription { sdnn_seconds: 0.045, seed, ..Prescription::default() };
        let truth = prescription.reference(&all).unwrap();
        for parameterization in ALL {
            let options = PhaseOptions { parameterization, steps: 30, ..PhaseOptions::default() };
            let (pulse, _) = fit(&truth, &options).unwrap();
            let errors = errors(&pulse.theta, &truth.phase);
            let (slope, whole, end) = (drift(&errors), rms(&errors), rms(&errors[errors.len() - 1800..]));
            println!("{parameterization:?} {seed} | {slope:.5} | {whole:.4} | {end:.4}");
            // The others pass an error on from frame to frame and only their losses hold them.
            let held = parameterization == Parameterization::Anchored;
            let (most_slope, most) = if held { (5e-4, 0.05) } else { (0.02, 0.3) };
            assert!(slope < most_slope && whole < most && end < most, "{parameterization:?} {seed}");
        }
    }
}

#[test]
fn a_prescribed_rate_is_exact_after_an_hour() {
    let all = times(3600.0, 30.0);
    let truth = Prescription { heart_rate_bpm: 71.3, ..Prescription::default() }.reference(&all).unwrap();
    let turn = std::f64::consts::TAU * 71.3 / 60.0;
    let worst = all.iter().zip(&truth.phase).map(|(t, p)| (p - truth.phase[0] - turn * t).abs()).fold(0.0, f64::max);
    println!("a prescribed rate after 60 min: {worst:.1e} rad");
    assert!(worst < 1e-6, "{worst}");
}
