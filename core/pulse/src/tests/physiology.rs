//! Prescribed physiology, measured back by the reading side: variability, breath, ectopic beats, files of beats.
#![expect(clippy::unwrap_used, reason = "tests")]

use heartian_signal::pulse_variability;

use super::*;
use crate::{Parameterization, Prescription, PulseFile, Rhythm};

/// A prescription over three minutes, fitted briefly; what the attribute signal's beats vary by.
fn measured(prescription: &Prescription) -> (heartian_signal::hrv::Variability, Pulse) {
    let reference = prescription.reference(&times(180.0, 30.0)).unwrap();
    let options = PhaseOptions { parameterization: Parameterization::Anchored, steps: 60, ..PhaseOptions::default() };
    let (pulse, _) = fit(&reference, &options).unwrap();
    (pulse_variability(&pulse.fundamental, 30.0).unwrap(), pulse)
}

#[test]
fn prescribed_variability_is_measured_back() {
    for (bpm, sdnn_ms, lf_hf) in
        [(62.0, 20.0, 1.0), (72.0, 50.0, 0.5), (72.0, 50.0, 3.0), (95.0, 35.0, 1.0), (60.0, 90.0, 1.5)]
    {
        let prescription = Prescription {
            heart_rate_bpm: bpm,
            sdnn_seconds: sdnn_ms / 1000.0,
            lf_hf,
            seed: bpm as u64,
            ..Prescription::default()
        };
        let (found, _) = measured(&prescription);
        let ratio = found.bands.unwrap().ratio();
        println!(
            "{bpm} bpm, SDNN {sdnn_ms} ms, LF/HF {lf_hf}: {:.1} ms, {ratio:.2}, {:.1} bpm",
            found.sdnn_ms,
            6e4 / found.mean_ms
        );
        // Beats are read from frames a thirtieth of a second apart.
        assert!((found.sdnn_ms - sdnn_ms).abs() < (0.1 * sdnn_ms).max(4.0), "{found:?}");
        assert!((ratio / lf_hf).ln().abs() < 0.35, "{ratio} of {lf_hf}");
        assert!((6e4 / found.mean_ms - bpm).abs() < 0.5);
    }
}

#[test]
fn breath_moves_the_beats_height_and_ectopic_beats_are_early_and_weak() {
    let prescription = Prescription { breath_amplitude: 0.4, breaths_per_minute: 12.0, ..Prescription::default() };
    let (_, pulse) = measured(&prescription);
    let shape = pulse.shape();
    // Heights of the beats against the breath that was asked for.
    let heights: Vec<f64> = shape.chunks_exact(25).map(|part| part.iter().copied().fold(0.0, f64::max)).collect();
    let (low, high) = heights.iter().fold((f64::MAX, 0.0f64), |(l, h), &v| (l.min(v), h.max(v)));
    println!("beats between {low:.3} and {high:.3} of a plain one of {:.3}", pulse.waveform.peak_to_peak());
    assert!((high / low / (1.4 / 0.6) - 1.0).abs() < 0.15, "{low} {high}");

    let prescription = Prescription { ectopic_per_minute: 4.0, sdnn_seconds: 0.02, ..Prescription::default() };
    let (found, pulse) = measured(&prescription);
    println!("12 ectopic beats: {} intervals left out, SDNN {:.1} ms of 20", found.left_out, found.sdnn_ms);
    // Each makes two odd intervals, which take their neighbours with them.
    assert!((40..=52).contains(&found.left_out), "{found:?}");
    assert!((found.sdnn_ms - 20.0).abs() < 6.0, "{found:?}");
    assert!((read_bpm(&pulse.fundamental, 30.0) - 72.0).abs() < 1.0);
}

#[test]
fn an_irregular_rhythm_is_irregular_from_beat_to_beat() {
    let of = |rhythm| {
        let prescription = Prescription { rhythm, sdnn_seconds: 0.1, ..Prescription::default() };
        let (found, _) = measured(&prescription);
        found.rmssd_ms / found.sdnn_ms
    };
    let (sinus, irregular) = (of(Rhythm::Sinus), of(Rhythm::Irregular));
    println!("RMSSD over SDNN: sinus {sinus:.2}, irregular {irregular:.2} (free intervals: 1.41)");
    assert!(irregular > 1.25 && sinus < 1.2);
}

#[test]
fn limits_are_told_with_their_remedy() {
    let refusal = |p: Prescription, seconds: f64, rate: f64| {
        p.reference(&times(seconds, rate)).err().map(|error| error.to_string()).unwrap_or_default()
    };
    let plain = Prescription::default();
    for (prescription, seconds, rate, part) in [
        (Prescription { heart_rate_bpm: 150.0, ..plain }, 20.0, 7.0, "lower the rate or use more frames"),
        (Prescription { sdnn_seconds: 0.29, ..plain }, 20.0, 30.0, "a quarter of the mean beat interval"),
        (Prescription { sdnn_seconds: 0.02, ..plain }, 1.6, 30.0, "too few"),
        (Prescription { lf_hf: 0.0, ..plain }, 20.0, 30.0, "lf_hf"),
        (Prescription { breaths_per_minute: 40.0, ..plain }, 20.0, 30.0, "breaths_per_minute"),
        (
            Prescription { heart_rate_bpm: 40.0, sdnn_seconds: 0.05, breaths_per_minute: 22.0, ..plain },
            20.0,
            30.0,
            "below half the heart rate",
        ),
        (Prescription { breath_amplitude: f64::NAN, ..plain }, 20.0, 30.0, "breath_amplitude"),
        (Prescription { ectopic_per_minute: 99.0, ..plain }, 20.0, 30.0, "ectopic_per_minute"),
        (
            Prescription { heart_rate_bpm: 140.0, ectopic_per_minute: 8.0, ..plain },
            30.0,
            7.0,
            "lower the rate or use more frames",
        ),
    ] {
        let said = refusal(prescription, seconds, rate);
        assert!(said.contains(part), "{prescription:?}: {said}");
    }
}

#[test]
fn files_of_beats_intervals_and_waveforms_are_written_on_their_own_clock() {
    let folder = std::env::temp_dir().join(format!("heartian-pulse-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let later: Vec<f64> = times(20.0, 30.0).iter().map(|time| time + 300.0).collect();
    let beats: String = (0..30).map(|k| format!("{}\n", 0.75 * f64::from(k))).collect();
    let intervals = "750\n".repeat(30);
    let wave: String = (0..2500)
        .map(|k| {
            format!("{},{}\n", 50.0 + f64::from(k) / 100.0, (std::f64::consts::TAU * 0.8 / 60.0 * f64::from(k)).sin())
        })
        .collect();
    for (name, text, bpm) in [
        ("beats.csv", format!("beat_s\n{beats}"), 80.0),
        ("intervals.csv", format!("rr_ms\n{intervals}"), 80.0),
        ("wave.csv", format!("time_s,ppg\n{wave}"), 80.0),
    ] {
        let reference = PulseFile::read(&write(name, &text)).unwrap().reference(&later).unwrap();
        let found = read_bpm(&reference.waveform, 30.0);
        assert!((found - bpm).abs() < 0.5 && (reference.mean_bpm - bpm).abs() < 1.0, "{name}: {found}");
    }
    for (text, part) in [
        ("beat_s\n0\n0.8\n0.7\n", "is not after the one before"),
        ("rr_ms\n800\n-5\n", "above 0"),
        ("rr_ms\n800\nx\n", ":3: the interval is `x`"),
        ("hr\n60\n", "`time_s,ppg` or `beat_s` or `rr_ms`"),
        ("beat_s\n", "where two or more are needed"),
        ("beat_s\n0\n0.8\n1.6\n", "the list of beats spans"),
        ("beat_s\n0\n0.01\n0.02\n", "spans"),
    ] {
        let path = write("bad.csv", text);
        let error = PulseFile::read(&path).and_then(|file| file.reference(&later)).unwrap_err();
        assert!(error.to_string().contains(part), "{text:?}: {error}");
    }
    assert!(PulseFile::read(&folder.join("none.csv")).is_err());
    std::fs::remove_dir_all(&folder).unwrap();
}
