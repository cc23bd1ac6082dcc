//! HrEstimator: the heart rate in the albedo itself (paper, "Heart Rate Estimation Protocol").

use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_signal::stats::{macc, pearson};
use heartian_space::{Metrics, Modulation, Series, Skin, Traces};

use crate::choices::{Convention, read, trace};

params! {
    /// Reads the heart rate from the mean modulated green albedo of the skin Gaussians, beside the reference trace's:
    /// smoothness-prior detrending, first-order zero-phase Butterworth band-pass, strongest bin of the spectrum.
    pub struct HrEstimator {
        /// Band, bins and filter: the paper's (0.75–3.0 Hz, bins of at most 0.1 bpm), rPPG-Toolbox's (0.6–3.3 Hz, next
        /// power of two), or rPPG-Toolbox's with bins of at most 0.1 bpm.
        convention: Convention = Convention::Paper, choices(&["Paper", "Toolbox", "ToolboxFine"]);
    }
}
register!(HrEstimator);

impl Node for HrEstimator {
    const KIND: &'static str = "HrEstimator";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[
        Port::one::<Skin>("skin", "The skin Gaussians and their unmodulated green albedo."),
        Port::one::<Modulation>("modulation", "Offsets of their green albedo, frame by frame."),
        Port::one::<Series>("reference", "The waveform that was to be written."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Traces>("traces", "The reference and the attribute-level waveform, filtered."),
        Port::one::<Metrics>("metrics", "reference.hr_bpm and attribute.*."),
    ];

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let (skin, modulation) = (inputs.get::<Skin>("skin")?, inputs.get::<Modulation>("modulation")?);
        let reference = inputs.get::<Series>("reference")?;
        let preset = self.convention.preset();
        let expected = read(&reference, preset).map_err(|error| {
            NodeError::new(format!("the reference waveform: {error}"))
                .remedy("check frames.ppg, or prescribe phase.heart_rate_bpm")
        })?;
        let attribute = Series::new(modulation.times_seconds.clone(), mean_green(&skin, &modulation)?)?;
        let found = read(&attribute, preset).map_err(|error| {
            NodeError::new(format!("the mean green albedo of the skin: {error}")).remedy("raise phase.amplitude")
        })?;
        let same_grid = expected.filtered.len() == found.filtered.len();
        let correlation = if same_grid { pearson(&expected.filtered, &found.filtered)? } else { f64::NAN };
        let metrics = Metrics::new()
            .with("reference.hr_bpm", expected.bpm)
            .with("attribute.hr_bpm", found.bpm)
            .with("attribute.hr_error_bpm", (found.bpm - expected.bpm).abs())
            .with("attribute.snr_db", found.snr_db(expected.bpm))
            .with("attribute.waveform_pearson", correlation)
            .with("attribute.macc", macc(&found.filtered, &expected.filtered)?);
        let traces = Traces(vec![
            trace("prescribed", &expected, reference.times_seconds[0])?,
            trace("attribute", &found, attribute.times_seconds[0])?,
        ]);
        Ok(Outputs::new().put("traces", traces).put("metrics", metrics))
    }
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
        }
    }

    #[test]
    fn an_unmodulated_avatar_has_no_heart_rate() {
        let error = HrEstimator::default().run(&inputs(72.0, 0.0), &Context::silent()).err().unwrap();
        assert!(error.message.contains("mean green albedo") && error.remedy.is_some(), "{error:?}");
    }
}
