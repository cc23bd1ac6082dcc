//! Drift per minute of the three parameterisations of phase: over half an hour that was fitted, and over frames after it
//! that were not. `cargo test -p heartian-pulse drift -- --nocapture` prints the table.
#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::numeric::{mean, wrap};
use crate::{Parameterization, Prescription};

/// Half an hour at 30 frames a second, and how much of it is fitted.
const SECONDS: f64 = 1800.0;
const FITTED: usize = 45_900;

/// The phase error unwrapped over time, and its rms modulo a turn.
fn errors(found: &[f64], truth: &[f64]) -> (Vec<f64>, f64) {
    let wrapped: Vec<f64> = found.iter().zip(truth).map(|(a, b)| wrap(a - b)).collect();
    let mut reached = wrapped[0];
    let unwrap = |error: &f64| {
        reached += wrap(error - reached);
        reached
    };
    let rms = mean(&wrapped.iter().map(|e| e * e).collect::<Vec<_>>()).sqrt();
    (wrapped.iter().map(unwrap).collect(), rms)
}

/// Radians a minute: the farthest the error goes, over the time it has.
fn drift(unwrapped: &[f64]) -> f64 {
    let most = unwrapped.iter().map(|error| (error - unwrapped[0]).abs()).fold(0.0, f64::max);
    most / (unwrapped.len() as f64 / 1800.0)
}

#[test]
fn anchors_stay_in_phase_where_the_others_drift() {
    let all = times(SECONDS, 30.0);
    let prescription = Prescription { sdnn_seconds: 0.045, seed: 4, ..Prescription::default() };
    let truth = prescription.reference(&all).unwrap();
    let part = prescription_part(&truth, FITTED);
    let later = &all[FITTED..];
    println!("phase | fitted 25.5 min: drift rad/min, rms rad | 4.5 min after: drift rad/min, rms rad");
    let mut rows = Vec::new();
    for parameterization in [Parameterization::Cumulative, Parameterization::Direct, Parameterization::Anchored] {
        let options = PhaseOptions { parameterization, steps: 100, ..PhaseOptions::default() };
        let (mut pulse, _) = fit(&part, &options).unwrap();
        let (fitted, fitted_rms) = errors(&pulse.theta, &part.phase);
        let beyond = pulse.phase.continued(&all[..FITTED], later);
        let (after, after_rms) = errors(&beyond, &truth.phase[FITTED..]);
        let row = [drift(&fitted), fitted_rms, drift(&after), after_rms];
        println!("{parameterization:?} | {:.4} {:.4} | {:.3} {:.3}", row[0], row[1], row[2], row[3]);
        rows.push(row);
        if parameterization == Parameterization::Anchored {
            // The video's own pulse, with a jitter of 0.35 rad and a fifth of it not believed.
            let mut random = Random::new(6);
            let weak: Vec<f64> = truth.phase[FITTED..].iter().map(|p| wrap(p + 0.35 * random.normal())).collect();
            let smooth: Vec<f64> =
                weak.windows(5).map(|w| w[2] + mean(&w.iter().map(|v| wrap(v - w[2])).collect::<Vec<_>>())).collect();
            let confidence: Vec<f64> = (0..smooth.len()).map(|k| f64::from(k / 300 % 5 != 2)).collect();
            let found = pulse.phase.anchors.extend(&mut pulse.phase.raw, &later[2..], &smooth, &confidence);
            let held = pulse.phase.continued(&all[..FITTED], later);
            let (after, after_rms) = errors(&held, &truth.phase[FITTED..]);
            println!("Anchored, with the video's pulse | | {:.3} {after_rms:.3} ({found} anchors)", drift(&after));
            rows.push([0.0, 0.0, drift(&after), after_rms]);
        }
    }
    let [cumulative, direct, anchored, with_video] = rows[..] else { panic!("four rows") };
    assert!(anchored[0] < 0.01 && anchored[1] < 0.05, "{anchored:?}");
    assert!(anchored[1] <= cumulative[1] + 1e-3);
    assert!(with_video[2] < 0.6 && with_video[3] < 0.45, "{with_video:?}");
    assert!(with_video[3] < 0.5 * cumulative[3] && with_video[3] < 0.5 * direct[3], "{rows:?}");
}

/// The first frames of a reference.
fn prescription_part(truth: &Reference, frames: usize) -> Reference {
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

#[test]
fn a_prescribed_rate_is_exact_after_an_hour() {
    let all = times(3600.0, 30.0);
    let truth = Prescription { heart_rate_bpm: 71.3, ..Prescription::default() }.reference(&all).unwrap();
    let turn = std::f64::consts::TAU * 71.3 / 60.0;
    let worst = all.iter().zip(&truth.phase).map(|(t, p)| (p - truth.phase[0] - turn * t).abs()).fold(0.0, f64::max);
    println!("a prescribed rate after 60 min: {worst:.1e} rad");
    assert!(worst < 1e-6, "{worst}");
}
