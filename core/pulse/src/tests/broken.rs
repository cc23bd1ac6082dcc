//! Broken and extreme input has a defined answer: the rate is still right, or one clear error says what to do.
#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::numeric::wrap;
use crate::{Parameterization, Prescription, ResidualOptions, fit_residual, modulation_from_fundamental};

const RATE: f64 = 30.0;

/// The rate that the attribute signal carries after the phase fit.
fn embedded_bpm(ppg: &Series, seconds: f64) -> f64 {
    let reference = Reference::from_ppg(ppg, &times(seconds, RATE)).unwrap();
    let (pulse, _) = fit(&reference, &PhaseOptions { steps: 300, ..PhaseOptions::default() }).unwrap();
    read_bpm(&pulse.fundamental, RATE)
}

fn changed(change: impl Fn(usize, f64) -> f64) -> Series {
    let mut ppg = made_up_ppg(24.0, 100.0, |_| 78.0, 0.01);
    let values = ppg.values.iter().enumerate().map(|(k, &v)| change(k, v)).collect();
    ppg.values = values;
    ppg
}

#[test]
fn damaged_recordings_keep_their_rate() {
    let cases: [(&str, Series); 6] = [
        ("clipped", changed(|_, v| v.min(540.0))),
        ("spiky", changed(|k, v| if k % 397 == 5 { v + 5000.0 } else { v })),
        ("first second wild", changed(|k, v| if k < 100 { v + 900.0 * ((k * k) as f64).sin() } else { v })),
        ("upside down", changed(|_, v| 1000.0 - v)),
        ("drifting", changed(|k, v| v + 0.5 * k as f64 + 300.0 * (k as f64 / 400.0).sin())),
        ("three beats lost", changed(|k, v| if (900..1130).contains(&k) { 500.0 } else { v })),
    ];
    for (name, ppg) in cases {
        let read = embedded_bpm(&ppg, 20.0);
        println!("{name}: {read:.2} bpm of 78");
        assert!((read - 78.0).abs() < 0.5, "{name}: {read}");
    }
}

#[test]
fn an_inverted_recording_is_turned_over() {
    let reference = Reference::from_ppg(&changed(|_, v| 1000.0 - v), &times(20.0, RATE)).unwrap();
    let upright = Reference::from_ppg(&changed(|_, v| v), &times(20.0, RATE)).unwrap();
    assert!(reference.inverted && !upright.inverted);
    let apart = reference.phase.iter().zip(&upright.phase).map(|(a, b)| wrap(a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 0.3, "{apart}");
}

#[test]
fn recordings_without_a_heartbeat_are_refused() {
    let clip = times(20.0, RATE);
    let flat = Reference::from_ppg(&changed(|_, _| 512.0), &clip);
    assert!(matches!(flat, Err(PulseError::NoBeats(_))), "{flat:?}");
    let short = Reference::from_ppg(&made_up_ppg(10.0, 100.0, |_| 70.0, 0.0), &clip);
    assert!(matches!(short, Err(PulseError::Space(_))), "{short:?}");
    let ppg = made_up_ppg(30.0, 100.0, |_| 70.0, 0.0);
    assert!(matches!(Reference::from_ppg(&ppg, &times(0.3, RATE)), Err(PulseError::Short { .. })));
    assert!(Reference::from_ppg(&ppg, &[f64::NAN; 100]).is_err());
}

#[test]
fn prescriptions_out_of_range_are_refused() {
    let prescribe = |bpm, sdnn_seconds, rate| {
        let prescription = Prescription { heart_rate_bpm: bpm, sdnn_seconds, ..Prescription::default() };
        prescription.reference(&times(20.0, rate))
    };
    assert!(matches!(prescribe(0.0, 0.0, RATE), Err(PulseError::Parameter { name: "heart_rate_bpm", .. })));
    assert!(matches!(prescribe(f64::NAN, 0.0, RATE), Err(PulseError::Parameter { .. })));
    assert!(matches!(prescribe(70.0, 2.0, RATE), Err(PulseError::Parameter { name: "sdnn_seconds", .. })));
    assert!(matches!(prescribe(180.0, 0.0, 7.0), Err(PulseError::Undersampled { .. })));
}

#[test]
fn every_length_frame_rate_and_starting_phase_works() {
    for (seconds, rate) in [(3.0, 30.0), (20.0, 7.0), (20.0, 24.0), (20.0, 29.97), (20.0, 60.0)] {
        let reference = Prescription::default().reference(&times(seconds, rate)).unwrap();
        let (pulse, report) = fit(&reference, &PhaseOptions { steps: 300, ..PhaseOptions::default() }).unwrap();
        let read = read_bpm(&pulse.fundamental, rate);
        println!("{seconds} s at {rate}/s: {read:.2} bpm of 72, pearson {:.4}", report.fundamental_pearson);
        let allowed = if seconds < 5.0 { 3.0 } else { 0.3 };
        assert!((read - 72.0).abs() < allowed && report.fundamental_pearson > 0.98, "{seconds} s at {rate}: {read}");
    }
    for shift in [-0.02, 0.0, 0.02] {
        // The first frame at, or just either side of, the cut at ±π.
        let mut reference = Prescription::default().reference(&times(10.0, RATE)).unwrap();
        let first = reference.phase[0];
        reference.phase.iter_mut().for_each(|phase| *phase += std::f64::consts::PI + shift - first);
        reference.waveform = reference.phase.iter().map(|&phase| crate::Waveform::default().at(wrap(phase))).collect();
        for parameterization in [Parameterization::Cumulative, Parameterization::Direct] {
            let options = PhaseOptions { parameterization, steps: 300, ..PhaseOptions::default() };
            let (_, report) = fit(&reference, &options).unwrap();
            assert!(report.phase_loss.sqrt() < 0.05 && report.fundamental_pearson > 0.99, "{report:?}");
        }
    }
}

#[test]
fn ten_minutes_stay_in_phase() {
    let ppg = made_up_ppg(605.0, 100.0, |t| 70.0 + 15.0 * (0.05 * t).sin(), 0.02);
    let reference = Reference::from_ppg(&ppg, &times(600.0, RATE)).unwrap();
    let (pulse, report) = fit(&reference, &PhaseOptions { steps: 300, ..PhaseOptions::default() }).unwrap();
    let end = pulse.theta.len() - 900;
    let late = (end..pulse.theta.len()).map(|t| wrap(pulse.theta[t] - reference.phase[t]).abs()).fold(0.0, f64::max);
    assert!(late < 0.5 && report.fundamental_pearson > 0.99, "{late} {report:?}");
}

#[test]
fn one_skin_gaussian_works_and_none_is_a_clear_error() {
    let reference = Prescription::default().reference(&times(5.0, RATE)).unwrap();
    let (pulse, _) = fit(&reference, &PhaseOptions { steps: 100, ..PhaseOptions::default() }).unwrap();
    let options = ResidualOptions { steps: 30, ..ResidualOptions::default() };
    let (_, one) = fit_residual(&pulse, &skin(1), None, &options, &mut onwards).unwrap();
    assert_eq!(one.offsets.len(), 150);
    assert_eq!(modulation_from_fundamental(&pulse, &skin(1)).unwrap().0.offsets.len(), 150);
    let none = fit_residual(&pulse, &skin(0), None, &options, &mut onwards);
    assert!(matches!(none, Err(PulseError::NoSkin)));
    assert!(matches!(modulation_from_fundamental(&pulse, &skin(0)), Err(PulseError::NoSkin)));
}

#[test]
fn irregular_rhythms_are_followed() {
    // Beats as in atrial fibrillation: intervals anywhere in 0.45–1.05 s.
    let mut random = Random::new(12);
    let (mut beats, mut at) = (vec![0.0], 0.0);
    while at < 26.0 {
        at += 0.45 + 0.6 * random.unit();
        beats.push(at);
    }
    let shape = crate::Waveform::default();
    let value = |time: f64| {
        let after = beats.partition_point(|&beat| beat <= time).clamp(1, beats.len() - 1);
        let phase = (time - beats[after - 1]) / (beats[after] - beats[after - 1]);
        500.0 + 80.0 * shape.at(std::f64::consts::TAU * phase)
    };
    let at: Vec<f64> = (0..2500).map(|k| f64::from(k) / 100.0).collect();
    let ppg = Series { values: at.iter().map(|&t| value(t)).collect(), times_seconds: at };
    let reference = Reference::from_ppg(&ppg, &times(20.0, RATE)).unwrap();
    let (pulse, report) = fit(&reference, &PhaseOptions::default()).unwrap();
    let options = ResidualOptions { width: 64, ..ResidualOptions::default() };
    let (fitted, _) = fit_residual(&pulse, &skin(50), None, &options, &mut onwards).unwrap();
    println!("irregular: fundamental {:.4}, full {:?}", report.fundamental_pearson, fitted.report.full_pearson);
    assert!(report.fundamental_pearson > 0.9 && fitted.report.full_pearson.unwrap() > 0.98);
}

#[test]
fn a_break_cancels() {
    let reference = Prescription::default().reference(&times(5.0, RATE)).unwrap();
    let scene = Scene { mean_green_albedo: 0.3, ..Scene::default() };
    let mut stop = |_: Progress| ControlFlow::Break(());
    let cancelled = fit_phase(&reference, &scene, &PhaseOptions::default(), &mut stop);
    assert!(matches!(cancelled, Err(PulseError::Cancelled)));
    let (pulse, _) = fit(&reference, &PhaseOptions { steps: 10, ..PhaseOptions::default() }).unwrap();
    let cancelled = fit_residual(&pulse, &skin(5), None, &ResidualOptions::default(), &mut stop);
    assert!(matches!(cancelled, Err(PulseError::Cancelled)));
}
