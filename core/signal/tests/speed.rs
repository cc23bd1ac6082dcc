//! Times against rPPG-Toolbox's on the same sizes: POS on 1,800 frames of 72² (0.38 s there, mean colours included) and
//! post-processing of 1,800 samples (0.6 s). Run with `cargo test --release -p heartian-signal --test speed -- --ignored
//! --nocapture`; timings are not asserted in ordinary runs.

use std::hint::black_box;
use std::time::Instant;

use heartian_signal::beats::{BeatOptions, detect_beats};
use heartian_signal::metrics::Evaluation;
use heartian_signal::trace::{Weighting, clip_heart_rate, mean_rgb};
use heartian_signal::{Method, Preset};
use heartian_space::{Clip, Sequence};

/// Best of several runs, milliseconds.
fn best_ms<T>(mut run: impl FnMut() -> T) -> f64 {
    let time = |_| {
        let start = Instant::now();
        black_box(run());
        1e3 * start.elapsed().as_secs_f64()
    };
    (0..15).map(time).fold(f64::INFINITY, f64::min)
}

#[test]
#[ignore = "a measurement"]
fn against_the_toolbox() -> Result<(), Box<dyn std::error::Error>> {
    let (size, count) = (72, 1800);
    let code = |index: usize| {
        let frame = index / (size * size * 3);
        let beat = 4.0 * (std::f64::consts::TAU * 1.2 * frame as f64 / 30.0).sin();
        (120.0 + beat + (index * 7919 % 23) as f64) as u8
    };
    let matte = |pixel: usize| {
        let (row, column) = (pixel / size % size, pixel % size);
        let radius = (row as f64 - 36.0).hypot(column as f64 - 36.0);
        (255.0 * (30.0 - radius).clamp(0.0, 1.0)) as u8
    };
    let sequence = Sequence {
        frames: (0..count * size * size * 3).map(code).collect(),
        // A disc with a soft rim, as mattes are.
        alpha: (0..count * size * size).map(matte).collect(),
        times_seconds: (0..count).map(|frame| frame as f64 / 30.0).collect(),
    };
    let clip = Clip::new("speed", size, size, sequence)?;
    let rgb = mean_rgb(&clip, Weighting::WholeFrame)?;
    let mean = best_ms(|| mean_rgb(&clip, Weighting::WholeFrame));
    let alpha = best_ms(|| mean_rgb(&clip, Weighting::Alpha));
    println!("mean colours of 1,800 frames: {mean:.3} ms, alpha-weighted {alpha:.3} ms");
    for method in Method::ALL {
        println!("{:5} on 1,800 colours: {:.3} ms", method.name(), best_ms(|| method.trace(&rgb, 30.0)));
    }
    let pos = mean + best_ms(|| Method::Pos.trace(&rgb, 30.0));
    let trace = Method::Pos.trace(&rgb, 30.0)?;
    let scoring = best_ms(|| Evaluation::default().score(&trace, &trace, 30.0));
    println!("POS on a clip: {pos:.3} ms, {:.0}× the toolbox's 380 ms", 380.0 / pos);
    println!("post-processing (both signals, rates, SNR, MACC): {scoring:.3} ms, {:.0}× its 600 ms", 600.0 / scoring);
    let whole = best_ms(|| clip_heart_rate(&clip, Weighting::WholeFrame, Method::Pos, Preset::Paper));
    println!("clip to heart rate, fine bins: {whole:.3} ms");
    println!("beats of 1,800 samples: {:.3} ms", best_ms(|| detect_beats(&trace, 30.0, &BeatOptions::default())));
    Ok(())
}
