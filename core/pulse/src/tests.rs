//! Whole fits: heart rates recovered, real and broken recordings, lengths, determinism, and what each setting costs.

mod broken;
mod colour;
mod drift;
mod hard;
mod perfusion;
mod physiology;
mod picture;
mod rates;
mod recordings;
mod strength;
mod table;
mod weak;

use std::ops::ControlFlow;

use heartian_signal::{Band, Resolution, Spectrum, bandpass, detrend};
use heartian_space::{Progress, Series, Skin};

use crate::fit::Scene;
use crate::numeric::Random;
use crate::{FitReport, PhaseOptions, Pulse, PulseError, Reference, fit_phase};

/// Evenly spaced frame times.
fn times(seconds: f64, rate_hertz: f64) -> Vec<f64> {
    (0..(seconds * rate_hertz).round() as usize).map(|t| t as f64 / rate_hertz).collect()
}

/// A callback that lets the work go on.
fn onwards(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// A made-up skin of `count` Gaussians.
fn skin(count: usize) -> Skin {
    let mut random = Random::new(31);
    Skin {
        gaussians: (0..count as u32).collect(),
        positions: (0..count).map(|_| std::array::from_fn(|_| (2.0 * random.unit() - 1.0) as f32)).collect(),
        green_albedo: (0..count).map(|_| (0.3 + 0.03 * random.normal()) as f32).collect(),
        distances_metres: vec![0.0; count],
        ..Skin::default()
    }
}

/// The phase fit without video or renderer.
fn fit(reference: &Reference, options: &PhaseOptions) -> Result<(Pulse, FitReport), PulseError> {
    let scene = Scene { mean_green_albedo: 0.3, ..Scene::default() };
    fit_phase(reference, &scene, options, &mut onwards)
}

/// A reader of its own: detrended, band-passed, FFT peak at 0.05 bpm, over a band that holds 40–200 bpm.
fn read_bpm(signal: &[f64], rate_hertz: f64) -> f64 {
    let band = Band { low_hertz: 0.5, high_hertz: 3.7f64.min(0.45 * rate_hertz) };
    let read = || {
        let clean = bandpass(&detrend(signal, 100.0 * (rate_hertz / 30.0).powi(2))?, rate_hertz, band, 1)?;
        let window = |(t, v): (usize, &f64)| v * (std::f64::consts::PI * t as f64 / clean.len() as f64).sin().powi(2);
        let windowed: Vec<f64> = clean.iter().enumerate().map(window).collect();
        let spectrum = Spectrum::of(&windowed, rate_hertz, Resolution::Bin { bpm: 0.05 })?;
        Ok::<_, heartian_signal::SignalError>(spectrum.refined_bpm(spectrum.peak_bin(band)?))
    };
    read().unwrap_or(f64::NAN)
}

/// A PPG at `rate_hertz` from a beat rate as a function of time, with drift and noise.
fn made_up_ppg(seconds: f64, rate_hertz: f64, bpm: impl Fn(f64) -> f64, noise: f64) -> Series {
    let (waveform, mut random) = (crate::Waveform::default(), Random::new(77));
    let mut phase = 0.0;
    let (mut at, mut values) = (Vec::new(), Vec::new());
    for k in 0..(seconds * rate_hertz) as usize {
        let time = k as f64 / rate_hertz;
        phase += std::f64::consts::TAU * bpm(time) / 60.0 / rate_hertz;
        at.push(time);
        values.push(500.0 + 80.0 * waveform.at(phase) + 20.0 * (0.2 * time).sin() + 80.0 * noise * random.normal());
    }
    Series { times_seconds: at, values }
}
