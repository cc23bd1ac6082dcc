//! Real contact PPG: heart rates and beats of three recordings, at the rates that clips are filmed at.
//!
//! The files are `ppg_*.csv` of `../shared/data` beside the repository (or `$HEARTIAN_DATA`); without them the tests say
//! "skipped" and pass. Beat rates are held against another program's: HeartPy 1.2.7 with its defaults, run on these files,
//! gives 58.90, 62.37 and 98.38 bpm (and rejects 26 of its 110 peaks of the noisy one).

use std::path::{Path, PathBuf};

use heartian_signal::beats::{BeatOptions, Beats, detect_beats};
use heartian_signal::{Preset, estimate};
use heartian_space::Series;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Frame rates, hertz: NTSC, film, high-speed and the sensors' own.
const RATES: [f64; 5] = [24.0, 29.97, 30.0, 60.0, 100.0];

fn recording(name: &str) -> Outcome<Option<Series>> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("HEARTIAN_DATA").map_or_else(beside, PathBuf::from);
    let Ok(text) = std::fs::read_to_string(folder.join(name)) else {
        println!("skipped: no {name}; set HEARTIAN_DATA to its folder");
        return Ok(None);
    };
    let (mut times, mut values) = (Vec::new(), Vec::new());
    for line in text.lines().skip(1) {
        let (time, value) = line.split_once(',').ok_or("not two columns")?;
        times.push(time.parse()?);
        values.push(value.parse()?);
    }
    Ok(Some(Series::new(times, values)?))
}

fn at_rate(series: &Series, rate: f64) -> Outcome<Vec<f64>> {
    let span = series.times_seconds[series.len() - 1];
    let times: Vec<f64> = (0..(span * rate) as usize).map(|frame| frame as f64 / rate).collect();
    Ok(series.resampled(&times, 0.0)?.values)
}

fn beats(values: &[f64], rate: f64) -> Outcome<Beats> {
    Ok(detect_beats(values, rate, &BeatOptions::default())?)
}

#[test]
fn heart_rate_is_the_same_at_every_frame_rate() -> Outcome<()> {
    for (name, bpm) in [("ppg_clean_100hz.csv", 58.6), ("ppg_noisy_117hz.csv", 61.4), ("ppg_wrist_100hz.csv", 98.05)] {
        let Some(series) = recording(name)? else { return Ok(()) };
        for rate in RATES {
            let found = estimate(&at_rate(&series, rate)?, rate, Preset::Paper)?.bpm;
            println!("{name} at {rate} Hz: {found:.2} bpm");
            assert!((found - bpm).abs() < 0.15, "{name} at {rate} Hz: {found}");
        }
    }
    Ok(())
}

#[test]
fn every_beat_of_the_clean_recording_is_found_whichever_way_up() -> Outcome<()> {
    let Some(series) = recording("ppg_clean_100hz.csv")? else { return Ok(()) };
    let full = beats(&at_rate(&series, 100.0)?, 100.0)?;
    assert_eq!(full.beats.len(), 24, "counted by eye");
    for rate in RATES.into_iter().chain([12.0, 7.0]) {
        let values = at_rate(&series, rate)?;
        let flipped: Vec<f64> = values.iter().map(|value| -value).collect();
        let (upright, inverted) = (beats(&values, rate)?, beats(&flipped, rate)?);
        assert!(!upright.inverted && inverted.inverted, "at {rate} Hz");
        assert_eq!(upright.beats, inverted.beats);
        assert_eq!(upright.beats.len(), 24, "at {rate} Hz");
        let pairs = upright.seconds().into_iter().zip(full.seconds());
        let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("clean at {rate} Hz: peaks move by at most {:.1} ms", 1e3 * worst);
        assert!(worst < if rate > 20.0 { 0.015 } else { 0.06 }, "at {rate} Hz a peak moved by {worst} s");
    }
    Ok(())
}

#[test]
fn artefacts_neither_add_beats_nor_lose_them() -> Outcome<()> {
    // Counting maxima gives 94 bpm for the noisy recording.
    let peer =
        [("ppg_clean_100hz.csv", 58.9, 0.1), ("ppg_noisy_117hz.csv", 62.4, 1.2), ("ppg_wrist_100hz.csv", 98.4, 0.2)];
    for (name, bpm, slack) in peer {
        let Some(series) = recording(name)? else { return Ok(()) };
        for rate in RATES {
            let found = beats(&at_rate(&series, rate)?, rate)?;
            let mean = found.mean_rate_bpm();
            println!("{name} at {rate} Hz: {mean:.2} bpm, {:.0} % observed", 100.0 * found.observed_share());
            assert!((mean - bpm).abs() < slack, "{name} at {rate} Hz: {mean}");
            assert!(!found.inverted);
        }
    }
    let Some(series) = recording("ppg_noisy_117hz.csv")? else { return Ok(()) };
    let found = beats(&at_rate(&series, 100.0)?, 100.0)?;
    // The sensor lies on no finger for the first 40 s; from there on, all beats but those of two artefacts are plain.
    let lost = found.beats.iter().filter(|beat| beat.seconds < 38.0 && beat.observed).count();
    let kept = found.beats.iter().filter(|beat| beat.seconds > 42.0 && beat.observed).count();
    let worn = found.beats.iter().filter(|beat| beat.seconds > 42.0).count();
    assert!(lost <= 6 && kept + 6 >= worn, "{lost} beats observed in the air, {kept} of {worn} on the finger");
    Ok(())
}
