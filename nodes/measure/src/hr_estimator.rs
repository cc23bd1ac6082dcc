//! HrEstimator: the heart rate in the albedo itself (paper, "Heart Rate Estimation Protocol").

use heartian_graph::{Context, Files, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_report::{FaceMap, encode_png, face_maps};
use heartian_signal::hrv::Variability;
use heartian_signal::metrics::RateMode;
use heartian_signal::regional::arrivals;
use heartian_signal::stats::{macc, mean, pearson};
use heartian_signal::{EvenTrace, HeartRate, Reader, SignalError, pulse_variability, resampled_evenly};
use heartian_space::{Metrics, Modulation, Series, Skin, Trace, Traces};
use serde::{Deserialize, Serialize};

use crate::choices::{Convention, trace};

/// How a rate is read from the filtered trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Strongest bin of the spectrum.
    Fft,
    /// Mean distance of maxima.
    Peak,
}

params! {
    /// Reads the heart rate from the mean modulated green albedo of the skin Gaussians, beside the reference trace's:
    /// smoothness-prior detrending, first-order zero-phase Butterworth band-pass, strongest bin of the spectrum; whole, by
    /// windows, and beat by beat; and how strongly and when the pulse arrives at each place of the skin.
    pub struct HrEstimator {
        /// Band, bins and filter: the paper's (0.75–3.0 Hz, bins of at most 0.1 bpm), rPPG-Toolbox's (0.6–3.3 Hz, next
        /// power of two), or rPPG-Toolbox's with bins of at most 0.1 bpm.
        convention: Convention = Convention::Paper, choices(&["Paper", "Toolbox", "ToolboxFine", "Fundamental"]);
        /// Strongest bin of the spectrum, or mean distance of maxima.
        mode: Mode = Mode::Fft, choices(&["Fft", "Peak"]);
        /// Read between bins, by a parabola through the strongest bin and its neighbours.
        between_bins: bool = false;
        /// Length of the windows of the rate over time; a shorter clip is one window.
        window_seconds: f64 = 10.0, unit("s"), range(2.0, 600.0);
        /// Distance of the windows.
        hop_seconds: f64 = 1.0, unit("s"), range(0.1, 600.0);
    }
}
register!(HrEstimator);

impl Node for HrEstimator {
    const KIND: &'static str = "HrEstimator";
    const REVISION: u32 = 2;
    const INPUTS: &'static [Port] = &[
        Port::one::<Skin>("skin", "The skin Gaussians and their unmodulated green albedo."),
        Port::one::<Modulation>("modulation", "Offsets of their green albedo, frame by frame."),
        Port::one::<Series>("reference", "The waveform that was to be written."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Traces>("traces", "The reference and the attribute-level waveform, filtered."),
        Port::one::<Traces>(
            "windows",
            "Heart rate over time, bpm at the middle of each window: reference and attribute.",
        ),
        Port::one::<Files>("picture", "perfusion.png: strength and delay of the pulse over the face."),
        Port::one::<Metrics>(
            "metrics",
            "reference.hr_bpm, attribute.*: rate, error, SNR, MACC, confidence, variability.",
        ),
    ];

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (skin, modulation) = (inputs.get::<Skin>("skin")?, inputs.get::<Modulation>("modulation")?);
        let reference = inputs.get::<Series>("reference")?;
        let expected = self.read(&reference).map_err(|error| {
            NodeError::new(format!("the reference waveform: {error}"))
                .remedy("check frames.ppg, or prescribe phase.heart_rate_bpm")
        })?;
        let attribute = Series::new(modulation.times_seconds.clone(), mean_green(&skin, &modulation)?)?;
        let found = self.read(&attribute).map_err(|error| {
            NodeError::new(format!("the mean green albedo of the skin: {error}")).remedy("raise phase.amplitude")
        })?;
        let (wanted, got) = (&expected.rate, &found.rate);
        let same_grid = wanted.filtered.len() == got.filtered.len();
        let correlation = if same_grid { pearson(&wanted.filtered, &got.filtered)? } else { f64::NAN };
        let metrics = Metrics::new()
            .with("reference.hr_bpm", wanted.bpm)
            .with("attribute.hr_bpm", got.bpm)
            .with("attribute.hr_error_bpm", (got.bpm - wanted.bpm).abs())
            .with("attribute.snr_db", got.snr_db(wanted.bpm))
            .with("attribute.waveform_pearson", correlation)
            .with("attribute.macc", macc(&got.filtered, &wanted.filtered)?)
            .with("attribute.confidence", got.confidence());
        let metrics = with_variability(metrics, "reference", &expected.beats);
        let metrics = with_variability(metrics, "attribute", &found.beats);
        let windows = [("reference", &expected, &*reference), ("attribute", &found, &attribute)]
            .map(|(label, reading, series)| self.windows(label, reading, series.times_seconds[0]));
        let windows: Vec<Trace> = windows.into_iter().collect::<Result<_, _>>()?;
        let apart = windows[0].series.values.iter().zip(&windows[1].series.values).map(|(a, b)| (a - b).abs());
        let metrics = metrics.with("attribute.window_mae_bpm", mean(&apart.collect::<Vec<_>>()));
        let traces = Traces(vec![
            trace("prescribed", wanted, reference.times_seconds[0])?,
            trace("attribute", got, attribute.times_seconds[0])?,
        ]);
        let picture = match perfusion_map(&skin, &modulation, got) {
            Ok(bytes) => Files::new().with("perfusion.png", bytes)?,
            Err(error) => {
                context.warn(&format!("no map of the pulse over the face: {}", error.message));
                Files::new()
            }
        };
        Ok(Outputs::new()
            .put("traces", traces)
            .put("windows", Traces(windows))
            .put("picture", picture)
            .put("metrics", metrics))
    }
}

/// What was read from one trace.
struct Reading {
    even: EvenTrace,
    rate: HeartRate,
    beats: Result<Variability, SignalError>,
}

impl HrEstimator {
    fn reader(&self) -> Reader {
        let mode = match self.mode {
            Mode::Fft => RateMode::Fft,
            Mode::Peak => RateMode::Peak,
        };
        Reader { protocol: self.convention.preset().protocol(), mode, between_bins: self.between_bins }
    }

    fn read(&self, series: &Series) -> Result<Reading, SignalError> {
        let even = resampled_evenly(&series.times_seconds, &series.values)?;
        let rate = self.reader().read(&even.values, even.rate_hertz)?;
        // Not every clip is long enough for beats; that is no reason to have no heart rate.
        let beats = pulse_variability(&even.values, even.rate_hertz);
        Ok(Reading { even, rate, beats })
    }

    fn windows(&self, label: &str, reading: &Reading, start_seconds: f64) -> Result<Trace, NodeError> {
        let EvenTrace { rate_hertz, values } = &reading.even;
        let window = self.window_seconds.min(values.len() as f64 / rate_hertz);
        let found = self.reader().windows(values, *rate_hertz, window, self.hop_seconds)?;
        // A window without a rate is left out of the trace.
        let known = found.iter().filter(|window| window.bpm.is_finite());
        let (times, rates): (Vec<f64>, Vec<f64>) =
            known.map(|window| (start_seconds + window.middle_seconds, window.bpm)).unzip();
        let (times, rates) = if times.is_empty() { (vec![start_seconds], vec![0.0]) } else { (times, rates) };
        Ok(Trace { label: format!("{label}.window_bpm"), series: Series::new(times, rates)? })
    }
}

/// SDNN and its kin, NaN where the trace shows too few beats.
fn with_variability(metrics: Metrics, label: &str, beats: &Result<Variability, SignalError>) -> Metrics {
    let of = |value: fn(&Variability) -> f64| beats.as_ref().map_or(f64::NAN, value);
    let ratio = beats.as_ref().ok().and_then(|found| found.bands).map_or(f64::NAN, |bands| bands.ratio());
    metrics
        .with(&format!("{label}.sdnn_ms"), of(|found| found.sdnn_ms))
        .with(&format!("{label}.rmssd_ms"), of(|found| found.rmssd_ms))
        .with(&format!("{label}.pnn50_percent"), of(|found| found.pnn50_percent))
        .with(&format!("{label}.lf_hf"), ratio)
}

/// The picture of strength and delay per Gaussian, read back from its own offsets.
fn perfusion_map(skin: &Skin, modulation: &Modulation, rate: &HeartRate) -> Result<Vec<u8>, NodeError> {
    let found = arrivals(&modulation.offsets, modulation.gaussians.len(), rate.rate_hertz, rate.bpm)?;
    let strength: Vec<f64> = found.iter().map(|place| place.strength).collect();
    let delay: Vec<f64> = found.iter().map(|place| 1000.0 * place.delay_seconds).collect();
    let maps = [
        FaceMap { title: "strength of the pulse", unit: "of the mean", values: &strength },
        FaceMap { title: "arrival of the pulse", unit: "ms after the mean", values: &delay },
    ];
    Ok(encode_png(&face_maps(&skin.positions, &maps)?)?)
}

/// The paper's c̄(t): mean over the skin Gaussians of base plus offset, clamped to [0, 1] as the renderer clamps it.
fn mean_green(skin: &Skin, modulation: &Modulation) -> Result<Vec<f64>, NodeError> {
    if skin.gaussians != modulation.gaussians {
        let message = format!(
            "the modulation speaks of {} Gaussians that are not the {} of the skin selection",
            modulation.gaussians.len(),
            skin.gaussians.len()
        );
        return Err(NodeError::new(message).remedy("wire both from the same SkinSelector"));
    }
    let mean = |frame: usize| {
        let offsets = modulation.frame(frame);
        let sum: f64 = skin
            .green_albedo
            .iter()
            .zip(offsets)
            .map(|(base, offset)| f64::from((base + offset).clamp(0.0, 1.0)))
            .sum();
        sum / offsets.len() as f64
    };
    Ok((0..modulation.times_seconds.len()).map(mean).collect())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use std::f64::consts::TAU;

    use heartian_graph::AnyArtifact;

    use super::*;

    fn inputs(bpm_written: f64, amplitude: f32) -> Inputs {
        let times: Vec<f64> = (0..600).map(|k| f64::from(k) / 30.0).collect();
        let wave = |bpm: f64| move |t: &f64| (TAU * bpm / 60.0 * t).sin();
        let offsets = times.iter().flat_map(|t| [amplitude * wave(bpm_written)(t) as f32; 2]).collect();
        let skin = Skin {
            gaussians: vec![3, 8],
            positions: vec![[0.0; 3]; 2],
            green_albedo: vec![0.3, 0.4],
            distances_metres: vec![0.0; 2],
            ..Skin::default()
        };
        let reference = Series::new(times.clone(), times.iter().map(wave(72.0)).collect()).unwrap();
        let modulation = Modulation { gaussians: vec![3, 8], times_seconds: times, offsets, ..Modulation::default() };
        Inputs::new()
            .with("skin", AnyArtifact::new(skin))
            .with("modulation", AnyArtifact::new(modulation))
            .with("reference", AnyArtifact::new(reference))
    }

    #[test]
    fn reads_what_was_written_and_says_how_far_off_it_is() {
        for (written, error) in [(72.0, 0.0), (90.0, 18.0)] {
            let outputs = HrEstimator::default().run(&inputs(written, 0.004), &Context::silent()).unwrap();
            let metrics = outputs.get("metrics").unwrap().downcast::<Metrics>().unwrap();
            assert!((metrics.get("attribute.hr_error_bpm").unwrap() - error).abs() < 0.15, "{metrics:?}");
            assert!((metrics.get("attribute.window_mae_bpm").unwrap() - error).abs() < 0.3, "{metrics:?}");
            assert!(metrics.get("attribute.confidence").unwrap() > 0.9);
            assert!(metrics.get("attribute.sdnn_ms").unwrap() < 10.0, "{metrics:?}");
            let picture = outputs.get("picture").unwrap().downcast::<Files>().unwrap();
            assert_eq!(picture.iter().count(), 1);
        }
    }

    #[test]
    fn every_mode_reads_the_same_heart() {
        for (mode, between_bins, convention) in [
            (Mode::Peak, false, Convention::Paper),
            (Mode::Fft, true, Convention::Toolbox),
            (Mode::Fft, true, Convention::ToolboxFine),
        ] {
            let node = HrEstimator { mode, between_bins, convention, ..HrEstimator::default() };
            let outputs = node.run(&inputs(72.0, 0.004), &Context::silent()).unwrap();
            let metrics = outputs.get("metrics").unwrap().downcast::<Metrics>().unwrap();
            let found = metrics.get("attribute.hr_bpm").unwrap();
            assert!((found - 72.0).abs() < 0.6, "{node:?}: {found}");
        }
    }

    #[test]
    fn an_unmodulated_avatar_has_no_heart_rate() {
        let error = HrEstimator::default().run(&inputs(72.0, 0.0), &Context::silent()).err().unwrap();
        assert!(error.message.contains("mean green albedo") && error.remedy.is_some(), "{error:?}");
    }
}
