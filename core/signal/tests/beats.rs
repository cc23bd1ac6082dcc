//! The beat detector on made recordings with known beats: every frame rate, the whole range of heart rates, every fault,
//! three seconds to an hour. Each row states the least F1 score and the largest timing error it must reach.

mod beats {
    pub mod phantom;
}

use beats::phantom::{Fault, Made, Phantom};
use heartian_signal::SignalError;
use heartian_signal::beats::{BeatOptions, Beats, Polarity, beat_aligned_phase, detect_beats};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Agreement of found with true beats.
struct Agreement {
    f1: f64,
    /// Root mean square distance of matched beats, milliseconds.
    rms_ms: f64,
}

/// Farthest that a found beat may lie from a true one to match it, seconds.
const MATCH_SECONDS: f64 = 0.12;

fn compare(found: &Beats, made: &Made) -> Agreement {
    let observed: Vec<f64> = found.beats.iter().filter(|beat| beat.observed).map(|beat| beat.seconds).collect();
    // Beats cut by an end of the recording count neither way.
    let (from, to) = (made.peaks[0] - 0.05, made.peaks[made.peaks.len() - 1] + 0.05);
    let inside: Vec<f64> = observed.into_iter().filter(|time| (from..=to).contains(time)).collect();
    let mut squares = Vec::new();
    for &peak in &made.peaks {
        let at = inside.partition_point(|&time| time < peak);
        let near = [at.checked_sub(1), Some(at)].into_iter().flatten().filter_map(|k| inside.get(k));
        let distance = near.map(|time| (time - peak).abs()).fold(f64::INFINITY, f64::min);
        if distance < MATCH_SECONDS {
            squares.push(distance * distance);
        }
    }
    let matched = squares.len() as f64;
    Agreement {
        f1: 2.0 * matched / (made.peaks.len() + inside.len()) as f64,
        rms_ms: 1e3 * (squares.iter().sum::<f64>() / matched.max(1.0)).sqrt(),
    }
}

fn check(name: &str, phantom: Phantom, least_f1: f64, most_ms: f64) -> Outcome<()> {
    let made = phantom.make();
    let found = detect_beats(&made.values, phantom.rate_hertz, &BeatOptions::default())?;
    let Agreement { f1, rms_ms } = compare(&found, &made);
    println!("{name:44} F1 {f1:.4}  rms {rms_ms:5.1} ms  beats {:4}", found.beats.len());
    assert!(f1 >= least_f1 && rms_ms <= most_ms, "{name}: F1 {f1}, rms {rms_ms} ms");
    assert_eq!(found.inverted, phantom.fault == Fault::Inverted, "{name}");
    Ok(())
}

#[test]
fn every_rate_of_frames_and_of_hearts() -> Outcome<()> {
    for (rate_hertz, most_ms) in [(7.0, 70.0), (12.0, 45.0), (24.0, 15.0), (29.97, 15.0), (60.0, 15.0), (250.0, 15.0)] {
        for bpm in [42.0, 60.0, 95.0, 140.0, 180.0] {
            // At 7 Hz the second harmonic of 180 bpm aliases to 60 bpm: no detector can tell the two.
            if rate_hertz < 2.5 * bpm / 60.0 {
                continue;
            }
            let least_f1 = if rate_hertz < 10.0 { 0.85 } else { 0.99 };
            let name = format!("{rate_hertz} frames/s, {bpm} bpm");
            check(&name, Phantom { rate_hertz, bpm, ..Phantom::default() }, least_f1, most_ms)?;
        }
    }
    Ok(())
}

#[test]
fn every_fault() -> Outcome<()> {
    let rows = [
        (Fault::Clipped(0.1), 0.98, 20.0),
        (Fault::Clipped(0.25), 0.95, 30.0),
        (Fault::Spikes(1.0), 0.95, 25.0),
        (Fault::Spikes(10.0), 0.95, 25.0),
        (Fault::Inverted, 0.98, 15.0),
        (Fault::Ectopic(0.25), 0.97, 20.0),
        (Fault::Ectopic(0.4), 0.95, 20.0),
        (Fault::Dropped, 0.97, 15.0),
        (Fault::Weak(0.3), 0.97, 25.0),
        (Fault::Quantised(8.0), 0.98, 20.0),
    ];
    for (fault, least_f1, most_ms) in rows {
        for rate_hertz in [24.0, 30.0, 100.0] {
            let name = format!("{fault:?} at {rate_hertz} Hz");
            check(&name, Phantom { fault, rate_hertz, ..Phantom::default() }, least_f1, most_ms)?;
        }
    }
    Ok(())
}

#[test]
fn noise_up_to_the_pulse_itself() -> Outcome<()> {
    for (noise, least_f1, most_ms) in [(0.0, 0.999, 10.0), (0.1, 0.99, 20.0), (0.2, 0.98, 30.0), (0.4, 0.9, 45.0)] {
        let phantom = Phantom { noise, seconds: 120.0, ..Phantom::default() };
        check(&format!("noise {noise}"), phantom, least_f1, most_ms)?;
    }
    for (diastolic, least_f1) in [(0.0, 0.99), (0.7, 0.99), (0.9, 0.98)] {
        let phantom = Phantom { diastolic, ..Phantom::default() };
        check(&format!("diastolic wave of {diastolic}"), phantom, least_f1, 15.0)?;
    }
    Ok(())
}

#[test]
fn three_seconds_and_an_hour() -> Outcome<()> {
    for (seconds, bpm) in [(3.0, 60.0), (3.0, 110.0), (5.0, 48.0), (3600.0, 72.0)] {
        let phantom = Phantom { seconds, bpm, noise: 0.02, ..Phantom::default() };
        check(&format!("{seconds} s at {bpm} bpm"), phantom, 0.98, 20.0)?;
    }
    Ok(())
}

#[test]
fn dropped_beats_are_filled_in_and_phase_follows_the_true_beats() -> Outcome<()> {
    let whole = Phantom::default();
    let made = Phantom { fault: Fault::Dropped, ..whole }.make();
    let found = detect_beats(&made.values, 30.0, &BeatOptions::default())?;
    assert!(found.observed_share() < 0.95 && found.observed_share() > 0.85, "{}", found.observed_share());
    let times: Vec<f64> = (60..1740).map(|frame| f64::from(frame) / 30.0).collect();
    let truth = beat_aligned_phase(&times, &whole.make().peaks)?;
    let ours = beat_aligned_phase(&times, &found.seconds())?;
    let distance = |(a, b): (&f64, &f64)| heartian_signal::hilbert::wrap(a - b).abs();
    let mean = truth.phase_radians.iter().zip(&ours.phase_radians).map(distance).sum::<f64>() / times.len() as f64;
    println!("mean phase error over frames: {mean:.3} rad");
    assert!(mean < 0.12, "{mean}");
    assert_eq!(truth.beat_count(), ours.beat_count());
    Ok(())
}

#[test]
fn polarity_can_be_told() -> Outcome<()> {
    let made = Phantom { fault: Fault::Inverted, ..Phantom::default() }.make();
    let told = |polarity| detect_beats(&made.values, 30.0, &BeatOptions { polarity, ..BeatOptions::default() });
    assert_eq!(told(Polarity::Inverted)?, told(Polarity::Auto)?);
    assert!(!told(Polarity::Upright)?.inverted);
    Ok(())
}

#[test]
fn what_holds_no_beats_is_refused() {
    let detect = |values: &[f64], rate: f64| detect_beats(values, rate, &BeatOptions::default()).err();
    assert!(matches!(detect(&[], 30.0), Some(SignalError::Empty(_))));
    assert!(matches!(detect(&[1.0], 30.0), Some(SignalError::TooShort { .. })));
    assert!(matches!(detect(&[1.0; 59], 30.0), Some(SignalError::TooShort { needed: 60, .. })));
    assert!(matches!(detect(&[1.0; 300], 30.0), Some(SignalError::Flat(_))));
    assert!(matches!(detect(&[f64::NAN; 300], 30.0), Some(SignalError::NotFinite { .. })));
    assert!(matches!(detect(&[1.0; 300], 0.0), Some(SignalError::Rate { .. })));
    assert!(matches!(detect(&[1.0; 300], 4.0), Some(SignalError::Setting { .. })));
    let odd = BeatOptions { slowest_bpm: 90.0, fastest_bpm: 60.0, ..BeatOptions::default() };
    assert!(matches!(detect_beats(&[1.0; 300], 30.0, &odd), Err(SignalError::Setting { .. })));
}
