//! BenchmarkDecoder: the heart rate in pictures, by decoders that know nothing of how it was written.

use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_signal::HeartRate;
use heartian_signal::trace::clip_heart_rate;
use heartian_space::{Clip, Metrics, Series, Traces};

use crate::choices::{Convention, Pixels, ReadBy, read, trace};

params! {
    /// Reads the heart rate of clips by classical rPPG methods and compares it with the reference trace's, if one is
    /// wired. Figures are named LABEL.METHOD.hr_bpm, where LABEL is the clip's: input, baseline_rendered, rendered, relit.
    pub struct BenchmarkDecoder {
        /// Which methods, in this order.
        methods: Vec<ReadBy> = vec![ReadBy::Pos], choices(&["Pos", "Chrom", "Green", "Ica", "Lgi", "Pbv", "Omit"]);
        /// Which pixels count: each by its alpha, or the whole frame, as rPPG-Toolbox reads a face crop.
        pixels: Pixels = Pixels::Matte, choices(&["Frame", "Matte"]);
        /// Band, bins and filter: the paper's (0.75–3.0 Hz, bins of at most 0.1 bpm), rPPG-Toolbox's (0.6–3.3 Hz, next
        /// power of two), or rPPG-Toolbox's with bins of at most 0.1 bpm.
        /// POS band-passes by itself; the toolbox's wider band does not do it twice.
        convention: Convention = Convention::ToolboxFine, choices(&["Paper", "Toolbox", "ToolboxFine"]);
    }
}
register!(BenchmarkDecoder);

impl Node for BenchmarkDecoder {
    const KIND: &'static str = "BenchmarkDecoder";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[
        Port::many::<Clip>("clips", "Clips to read."),
        Port::one::<Series>("reference", "The waveform whose heart rate is the right answer.").optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Traces>("traces", "The recovered waveforms, filtered."),
        Port::one::<Metrics>("metrics", "LABEL.METHOD.hr_bpm, .hr_error_bpm and .snr_db."),
    ];

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let clips = inputs.many::<Clip>("clips")?;
        let preset = self.convention.preset();
        let reference = inputs.optional::<Series>("reference")?;
        let expected_bpm = reference.map(|series| read(&series, preset)).transpose()?.map(|rate| rate.bpm);
        let (mut traces, mut metrics) = (Traces::default(), Metrics::new());
        let total = (clips.len() * self.methods.len()) as u64;
        for (done, (clip, by)) in
            clips.iter().flat_map(|clip| self.methods.iter().map(move |by| (clip, by))).enumerate()
        {
            let name = format!("{}.{}", clip.label, by.method().name().to_lowercase());
            match clip_heart_rate(clip, self.pixels.weighting(), by.method(), preset) {
                Ok(rate) => {
                    metrics = with_figures(metrics, &name, &rate, expected_bpm);
                    traces.0.push(trace(&name, &rate, clip.times_seconds[0])?);
                }
                Err(error) => {
                    context.warn(&format!("no heart rate in `{}` by {}: {error}", clip.label, by.method().name()));
                    metrics = metrics.with(&format!("{name}.hr_bpm"), f64::NAN);
                }
            }
            if context.progress(done as u64 + 1, total, None).is_break() {
                return Err(NodeError::cancelled());
            }
        }
        Ok(Outputs::new().put("traces", traces).put("metrics", metrics))
    }
}

fn with_figures(metrics: Metrics, name: &str, rate: &HeartRate, expected_bpm: Option<f64>) -> Metrics {
    let metrics = metrics.with(&format!("{name}.hr_bpm"), rate.bpm);
    match expected_bpm {
        Some(bpm) => metrics
            .with(&format!("{name}.hr_error_bpm"), (rate.bpm - bpm).abs())
            .with(&format!("{name}.snr_db"), rate.snr_db(bpm)),
        None => metrics.with(&format!("{name}.snr_db"), rate.snr_db(rate.bpm)),
    }
}
