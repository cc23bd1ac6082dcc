//! Real contact PPG. The recordings lie beside the repository and are not part of it; without them the tests say so.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use super::*;
use crate::{ResidualOptions, fit_residual, mean_offsets};

/// A recording, if it is there: CSV with the header `time_s,ppg`.
pub(super) fn recording(file: &str) -> Option<Series> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(file);
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("skipped: {file} is not beside the repository");
        return None;
    };
    let rows = text.lines().skip(1).filter_map(|line| line.split_once(','));
    let (times_seconds, values) = rows.map(|(t, v)| (t.parse::<f64>().unwrap(), v.parse::<f64>().unwrap())).unzip();
    Some(Series::new(times_seconds, values).unwrap())
}

#[test]
fn real_recordings_are_embedded_at_their_own_rate() {
    for (file, seconds, rate) in
        [("ppg_clean_100hz.csv", 24.0, 24.0), ("ppg_wrist_100hz.csv", 20.0, 30.0), ("ppg_noisy_117hz.csv", 30.0, 24.0)]
    {
        let Some(ppg) = recording(file) else { continue };
        let reference = Reference::from_ppg(&ppg, &times(seconds, rate)).unwrap();
        let (pulse, before) = fit(&reference, &PhaseOptions::default()).unwrap();
        let options = ResidualOptions { width: 64, ..ResidualOptions::default() };
        let (fitted, modulation) = fit_residual(&pulse, &skin(200), None, &options, &mut onwards).unwrap();
        let (found, wanted) = (read_bpm(&mean_offsets(&modulation), rate), read_bpm(&reference.waveform, rate));
        let full = fitted.report.full_pearson.unwrap();
        let shape = before.fundamental_pearson;
        println!(
            "{file}: {found:.2} bpm of {wanted:.2} (beats {:.2}), pearson {shape:.4} → {full:.4}",
            reference.mean_bpm
        );
        assert!((found - wanted).abs() < 0.3 && full > 0.97 && full >= shape, "{file}");
    }
}

#[test]
fn the_clean_recording_has_its_rate_and_every_beat_is_seen() {
    let Some(ppg) = recording("ppg_clean_100hz.csv") else { return };
    let reference = Reference::from_ppg(&ppg, &times(24.0, 24.0)).unwrap();
    // Its FFT rate is 58.6 bpm; 24 beats lie in 23.4 s.
    assert!((reference.mean_bpm - 58.6).abs() < 1.0 && !reference.inverted, "{}", reference.mean_bpm);
    let sure = reference.confidence.iter().filter(|&&confidence| confidence == 1.0).count();
    assert!(sure > 500, "{sure}");
}

/// A pulse that is the same function of time at whatever times it is sampled.
fn sampled(times_seconds: Vec<f64>) -> Series {
    let turns = |t: f64| (74.0 * t + 5.0 / 0.6 * (1.0 - (0.6 * t).cos())) / 60.0;
    let wave =
        |t: &f64| 500.0 + 80.0 * crate::Waveform::default().at(std::f64::consts::TAU * turns(*t)) + 0.5 * t.sin();
    Series { values: times_seconds.iter().map(wave).collect(), times_seconds }
}

#[test]
fn a_ppg_of_any_rate_and_length_gives_the_same_pulse() {
    let clip = times(10.0, 30.0);
    let judge = Reference::from_ppg(&sampled(times(12.0, 100.0)), &clip).unwrap();
    let target = crate::losses::WaveformTarget::new(&judge.waveform, 30.0).unwrap();
    let check = |name: &str, times_seconds: Vec<f64>| {
        let found = Reference::from_ppg(&sampled(times_seconds), &clip).unwrap();
        let correlation = target.correlation(&found.waveform).unwrap();
        let apart = judge.phase.iter().zip(&found.phase).map(|(a, b)| crate::numeric::wrap(a - b).abs());
        let apart = apart.fold(0.0, f64::max);
        println!("{name}: correlation {correlation:.4}, phase within {apart:.3} rad");
        assert!(correlation > 0.97 && apart < 0.5, "{name}: {correlation} {apart}");
        assert!((found.mean_bpm - judge.mean_bpm).abs() < 0.5, "{name}");
    };
    // From a smartwatch's rate to a laboratory's; barely longer than the clip, and an hour.
    for (rate, seconds) in [(20.0, 12.0), (25.0, 10.0), (30.0, 10.0), (64.0, 11.0), (117.3, 60.0), (2000.0, 12.0)] {
        check(&format!("{rate} Hz, {seconds} s"), times(seconds, rate));
    }
    check("an hour at 50 Hz", times(3600.0, 50.0));
    // Uneven samples, as a phone writes them.
    let uneven = |(k, t): (usize, f64)| t + 0.004 * (1.7 * k as f64).sin();
    check("uneven", times(12.0, 90.0).into_iter().enumerate().map(uneven).collect());
}
