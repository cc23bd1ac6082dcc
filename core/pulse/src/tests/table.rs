//! Seconds against error, printed: `cargo test --release -p heartian-pulse -- --ignored --nocapture seconds_against`.
#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::{Evaluation, Parameterization, ResidualOptions, Start, fit_residual, mean_offsets};

/// Processor time used so far by all threads, seconds, so that a busy machine does not blur the table; 0 where unknown.
fn cpu_seconds() -> f64 {
    let Ok(stat) = std::fs::read_to_string("/proc/self/stat") else { return 0.0 };
    let fields: Vec<f64> =
        stat.rsplit(')').next().unwrap().split_whitespace().map(|f| f.parse().unwrap_or(0.0)).collect();
    // User and system time, in ticks of 10 ms.
    (fields[11] + fields[12]) / 100.0
}

#[test]
#[ignore = "prints a table; takes minutes"]
fn seconds_against_error_of_the_phase_fit() {
    println!("clip | start, parameterization, steps, calm | processor s | phase rms rad, pearson, bpm error");
    let cases = [
        (Start::Beats, Parameterization::Cumulative, 0, 100.0),
        (Start::Beats, Parameterization::Cumulative, 1000, 100.0),
        (Start::Beats, Parameterization::Cumulative, 3000, 100.0),
        (Start::Beats, Parameterization::Cumulative, 3000, 600.0),
        (Start::Beats, Parameterization::Cumulative, 10000, 600.0),
        (Start::Beats, Parameterization::Direct, 3000, 100.0),
        (Start::MeanRate, Parameterization::Cumulative, 3000, 600.0),
    ];
    for (name, reference) in clips() {
        for (start, parameterization, steps, calm_frames) in cases {
            let options = PhaseOptions { start, parameterization, steps, calm_frames, ..PhaseOptions::default() };
            report(&name, &reference, &options, &format!("{start:?} {parameterization:?} {steps} {calm_frames}"));
        }
        report(&name, &reference, &PhaseOptions::paper(), "paper");
        if reference.len() < 700 {
            report(&name, &reference, &PhaseOptions::to_the_letter(), "to the letter");
        }
    }
}

fn report(name: &str, reference: &Reference, options: &PhaseOptions, label: &str) {
    let begin = cpu_seconds();
    let (pulse, report) = fit(reference, options).unwrap();
    let seconds = cpu_seconds() - begin;
    let error =
        read_bpm(&pulse.fundamental, reference.rate_hertz()) - read_bpm(&reference.waveform, reference.rate_hertz());
    println!(
        "{name} {label} | {seconds:.3} | {:.4} {:.4} {error:+.3} | A {:.2?} mu {:.2?} sigma {:.2?}",
        report.phase_loss.sqrt(),
        report.fundamental_pearson,
        pulse.waveform.amplitude(),
        pulse.waveform.center,
        pulse.waveform.width(),
    );
}

fn clips() -> Vec<(String, Reference)> {
    let mut clips = vec![
        (
            "steady 20 s".to_owned(),
            Reference::from_ppg(&made_up_ppg(30.0, 100.0, |_| 72.0, 0.02), &times(20.0, 30.0)).unwrap(),
        ),
        (
            "wandering 20 s".to_owned(),
            Reference::from_ppg(
                &made_up_ppg(30.0, 100.0, |t| 70.0 + 8.0 * (0.5 * t).sin() + t, 0.02),
                &times(20.0, 30.0),
            )
            .unwrap(),
        ),
        (
            "wandering 600 s".to_owned(),
            Reference::from_ppg(
                &made_up_ppg(610.0, 100.0, |t| 70.0 + 15.0 * (0.05 * t).sin(), 0.02),
                &times(600.0, 30.0),
            )
            .unwrap(),
        ),
    ];
    for (file, seconds, rate) in
        [("ppg_clean_100hz.csv", 24.0, 24.0), ("ppg_wrist_100hz.csv", 20.0, 30.0), ("ppg_noisy_117hz.csv", 60.0, 30.0)]
    {
        if let Some(ppg) = recordings::recording(file) {
            clips.push((file.to_owned(), Reference::from_ppg(&ppg, &times(seconds, rate)).unwrap()));
        }
    }
    clips
}

#[test]
#[ignore = "prints a table; takes minutes"]
fn seconds_against_error_of_the_residual_fit() {
    println!("clip | steps width patches | processor s train+eval | pearson before after | limited");
    let skin = skin(6000);
    for (name, reference) in clips() {
        if reference.len() > 2000 {
            continue;
        }
        let (pulse, before) = fit(&reference, &PhaseOptions::default()).unwrap();
        for (steps, width, patches) in
            [(100, 128, 4), (300, 128, 4), (1000, 128, 4), (300, 32, 4), (300, 64, 4), (300, 128, 1), (300, 128, 8)]
        {
            let options = ResidualOptions { steps, width, patches, ..ResidualOptions::default() };
            let begin = cpu_seconds();
            let (fitted, modulation) = fit_residual(&pulse, &skin, None, &options, &mut onwards).unwrap();
            let seconds = cpu_seconds() - begin;
            let begin = cpu_seconds();
            let (exact, _) = crate::evaluate_all(&fitted, &skin, &Evaluation::Exact).unwrap();
            let exact_seconds = cpu_seconds() - begin;
            let begin = cpu_seconds();
            let _ = crate::evaluate_all(&fitted, &skin, &options.evaluation).unwrap();
            let fast_seconds = cpu_seconds() - begin;
            let apart = exact.offsets.iter().zip(&modulation.offsets).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            let read = read_bpm(&mean_offsets(&modulation), reference.rate_hertz());
            let error = read - read_bpm(&reference.waveform, reference.rate_hertz());
            println!(
                "{name} | {steps} {width} {patches} | {seconds:.2} (eval {fast_seconds:.2}, exact {exact_seconds:.2}, apart {apart:.1e}) | {:.4} {:.4} | {} | {error:+.3} bpm | B {:.3}",
                before.fundamental_pearson,
                fitted.report.full_pearson.unwrap(),
                fitted.report.limited.offsets,
                fitted.strength.residual_weight
            );
        }
    }
}
