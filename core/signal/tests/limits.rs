//! Measured limits of the heart-rate protocols: length of the recording, edges of the band, frame rate. Each row prints the
//! mean and the largest error over the band and must stay below its bound.

use heartian_signal::{Preset, estimate};

/// A pulse with a second harmonic and breathing, sampled evenly.
fn pulse(bpm: f64, rate: f64, seconds: f64) -> Vec<f64> {
    let sample = |index: usize| {
        let time = index as f64 / rate;
        let phase = std::f64::consts::TAU * bpm / 60.0 * time + 0.8;
        100.0 + phase.cos() + 0.35 * (2.0 * phase + 1.0).cos() + 0.8 * (std::f64::consts::TAU * 0.25 * time).sin()
    };
    (0..(seconds * rate) as usize).map(sample).collect()
}

/// Mean and largest absolute error over rates from 48 to 176 bpm.
fn errors(preset: Preset, rate: f64, seconds: f64) -> Result<(f64, f64), heartian_signal::SignalError> {
    let (mut sum, mut most, mut count) = (0.0, 0.0_f64, 0.0);
    for step in 0..33 {
        let bpm = 48.0 + 4.0 * f64::from(step);
        let error = (estimate(&pulse(bpm, rate, seconds), rate, preset)?.bpm - bpm).abs();
        (sum, most, count) = (sum + error, most.max(error), count + 1.0);
    }
    Ok((sum / count, most))
}

#[test]
fn the_paper_protocol_over_length_and_frame_rate() -> Result<(), heartian_signal::SignalError> {
    for rate in [7.0, 24.0, 29.97, 60.0] {
        for (seconds, most_allowed) in [(3.0, 4.0), (5.0, 2.0), (10.0, 0.5), (20.0, 0.15), (60.0, 0.06), (3600.0, 0.01)]
        {
            let (mean, most) = errors(Preset::Paper, rate, seconds)?;
            println!("{rate:5} Hz {seconds:6} s: mean {mean:.3} bpm, largest {most:.3} bpm");
            assert!(most < most_allowed, "{rate} Hz, {seconds} s: {most} bpm");
        }
    }
    Ok(())
}

#[test]
fn the_toolbox_protocol_is_limited_by_its_bins() -> Result<(), heartian_signal::SignalError> {
    for (seconds, bin) in [(6.0, 7.04), (20.0, 1.76), (60.0, 0.88)] {
        let (mean, most) = errors(Preset::Toolbox, 30.0, seconds)?;
        println!("toolbox {seconds} s: mean {mean:.3} bpm, largest {most:.3} bpm, bin {bin}");
        assert!(most < bin && most > 0.3 * bin);
    }
    Ok(())
}
