//! BenchmarkDecoder: the heart rate in pictures, by decoders that know nothing of how it was written.

use std::path::Path;

use heartian_decoder::{ClipOptions, Measured, Named, Network, Options, Reader, keys, measure, read_clip};
use heartian_face::models::load_detector;
use heartian_face::nets::Detector;
use heartian_graph::{Context, Files, Inputs, Node, NodeError, Outputs, Port, SourceFile, params, register};
use heartian_space::{Clip, Metrics, Progress, Rgb8Image, Series, Table, Traces};

use crate::choices::{Convention, FaceCut, NormalisedOver, Pixels, ReadBy, read, trace};
use crate::scores::{Reference, Scores};

params! {
    /// Reads the heart rate of clips by any number of decoders, classical and neural, and compares it with the reference
    /// trace's, if one is wired. Each clip is gone through once, whatever the number of decoders. Figures are named
    /// LABEL.METHOD.hr_bpm, where LABEL is the clip's: input, baseline_rendered, rendered, relit.
    pub struct BenchmarkDecoder {
        /// Which decoders, in this order. TsCan, PhysFormer, FactorizePhys and PhysNet need a weight file each.
        methods: Vec<ReadBy> = vec![ReadBy::Pos], choices(&[
            "Pos", "Chrom", "Green", "Ica", "Lgi", "Pbv", "Omit", "TsCan", "PhysFormer", "FactorizePhys", "PhysNet",
        ]);
        /// Weight files (.pth of rPPG-Toolbox, or .safetensors). The network is recognised from the file; one that
        /// methods does not name reads too, after those it names.
        weights: Vec<String> = Vec::new();
        /// Which pixels classical methods average: each by its alpha, the whole frame, or the face crop at 72×72, as
        /// rPPG-Toolbox does.
        pixels: Pixels = Pixels::Matte, choices(&["Frame", "Matte", "Face"]);
        /// What networks are shown: the box around the matte, the face that the installed detector sees in the first frame
        /// or in every thirtieth, enlarged by half, or the whole frame.
        face: FaceCut = FaceCut::Matte, choices(&["Matte", "Detector", "MovingDetector", "Frame"]);
        /// Over what the inputs of networks are normalised: the clip, as the toolbox does, or each chunk, in bounded memory.
        normalised_over: NormalisedOver = NormalisedOver::Clip, choices(&["Clip", "Chunk"]);
        /// Band, bins and filter: the paper's (0.75–3.0 Hz, bins of at most 0.1 bpm), rPPG-Toolbox's (0.6–3.3 Hz, next
        /// power of two), or rPPG-Toolbox's with bins of at most 0.1 bpm.
        /// POS band-passes by itself; the toolbox's wider band hardly does it twice. Fundamental is ToolboxFine that also asks
        /// whether the strongest bin is a second harmonic, which POS prefers below about 60 bpm.
        convention: Convention = Convention::ToolboxFine,
            choices(&["Paper", "Toolbox", "ToolboxFine", "Fundamental"]);
        /// Length of the windows whose errors the table sums up and the Bland–Altman plot shows.
        window_seconds: f64 = 10.0, unit("s"), range(1.0, 3600.0);
    }
}
register!(BenchmarkDecoder);

impl Node for BenchmarkDecoder {
    const KIND: &'static str = "BenchmarkDecoder";
    const REVISION: u32 = 2;
    const INPUTS: &'static [Port] = &[
        Port::many::<Clip>("clips", "Clips to read."),
        Port::one::<Series>("reference", "The waveform whose heart rate is the right answer.").optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Traces>(
            "traces",
            "The recovered waveforms, filtered: the first decoder's of all clips, then the next's.",
        ),
        Port::one::<Metrics>(
            "metrics",
            "LABEL.METHOD.hr_bpm, .hr_error_bpm, .snr_db, .macc and .confidence (being right to 5 bpm).",
        ),
        Port::one::<Table>(
            "table",
            "One row a clip and decoder: the figures, and errors over windows with standard errors.",
        ),
        Port::one::<Files>("files", "decoders.csv, decoders.parquet; with a reference, bland_altman_CLIP.png."),
    ];

    fn sources(&self) -> Vec<SourceFile> {
        let remedy = "give the path of a .pth or .safetensors weight file";
        self.weights.iter().map(|path| SourceFile::new("weights", path).remedy(remedy)).collect()
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let clips = inputs.many::<Clip>("clips")?;
        let preset = self.convention.preset();
        let reference = inputs.optional::<Series>("reference")?;
        let reference = reference
            .map(|series| Ok::<_, NodeError>(Reference { bpm: read(&series, preset)?.bpm, series }))
            .transpose()?;
        let (readers, detector) = (self.readers()?, self.detector()?);
        let options = ClipOptions {
            averaged: self.pixels.averaged(),
            cut: self.face.cut(),
            statistics: self.normalised_over.statistics(),
            protocol: preset.protocol(),
        };
        let find = |image: &Rgb8Image| detector.as_ref().and_then(|detector| detector.best_box(image).ok().flatten());
        let mut scores = Scores::new(preset.protocol(), self.window_seconds, reference);
        let mut traces: Vec<Vec<_>> = readers.iter().map(|_| Vec::new()).collect();
        for (done, clip) in clips.iter().enumerate() {
            let watch = &mut |p: Progress| {
                context.progress(done as u64 * p.total + p.step, clips.len() as u64 * p.total, p.metric)
            };
            let waves = match read_clip(clip, &readers, &options, &find, watch) {
                Ok(Some(waves)) => waves,
                Ok(None) => return Err(NodeError::cancelled()),
                Err(error) => {
                    context.warn(&format!("no heart rate in `{}`: {error}", clip.label));
                    keys(&readers).iter().for_each(|key| scores.add(&clip.label, key, None));
                    continue;
                }
            };
            for (reader, (key, measured)) in measure(&readers, waves, &options.protocol).into_iter().enumerate() {
                match &measured {
                    Ok(found) => {
                        let Measured { rate, start_seconds, .. } = found;
                        traces[reader].push(trace(&format!("{}.{key}", clip.label), rate, *start_seconds)?);
                    }
                    Err(error) => context.warn(&format!("no heart rate in `{}` by {key}: {error}", clip.label)),
                }
                scores.add(&clip.label, &key, measured.ok().as_ref());
            }
            if context.cancelled() {
                return Err(NodeError::cancelled());
            }
        }
        let (metrics, table, files) = scores.finish()?;
        let traces = Traces(traces.into_iter().flatten().collect());
        Ok(Outputs::new().put("traces", traces).put("metrics", metrics).put("table", table).put("files", files))
    }
}

impl BenchmarkDecoder {
    /// The decoders in order, networks with their weights.
    fn readers(&self) -> Result<Vec<Reader>, NodeError> {
        let load = |path: &String| {
            Network::load(Path::new(path), &Options::default())
                .map_err(|error| NodeError::new(format!("{path}: {error}")).parameter("weights"))
        };
        let mut networks: Vec<Option<Network>> =
            self.weights.iter().map(load).map(|network| network.map(Some)).collect::<Result<_, _>>()?;
        let mut readers = Vec::new();
        for method in &self.methods {
            readers.push(match method.named() {
                Named::Classical(method) => Reader::Classical(method),
                Named::Neural(architecture) => {
                    let fits = |network: &&mut Option<Network>| {
                        network.as_ref().is_some_and(|n| n.architecture() == architecture)
                    };
                    let network = networks.iter_mut().find(fits).and_then(Option::take);
                    Reader::neural(network.ok_or_else(|| {
                        NodeError::new(format!("{} has no weights", architecture.name()))
                            .parameter("weights")
                            .remedy("add its weight file to weights, or take it out of methods")
                    })?)
                }
            });
        }
        readers.extend(networks.into_iter().flatten().map(Reader::neural));
        Ok(readers)
    }

    /// The face detector, where it is asked for.
    fn detector(&self) -> Result<Option<Detector>, NodeError> {
        let wanted = matches!(self.face, FaceCut::Detector | FaceCut::MovingDetector);
        let load = || load_detector().map_err(|error| NodeError::from(error).parameter("face"));
        wanted.then(load).transpose()
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use heartian_graph::AnyArtifact;
    use heartian_space::{Cells, Sequence};

    use super::*;

    /// A patch of skin with a pulse of 78 bpm, or in the dark.
    fn clip(label: &str, light: f64) -> Clip {
        let code = |index: usize| {
            let (frame, channel, pixel) = (index / 192, index % 3, index % 192 / 3);
            let beat = (std::f64::consts::TAU * 1.3 * frame as f64 / 30.0).sin();
            (light * ([150.0, 110.0, 90.0][channel] + [0.5, 1.5, 0.9][channel] * beat + (pixel % 8) as f64 / 8.0)) as u8
        };
        let sequence = Sequence {
            frames: (0..600 * 192).map(code).collect(),
            alpha: vec![255; 600 * 64],
            times_seconds: (0..600).map(|frame| f64::from(frame) / 30.0).collect(),
        };
        Clip::new(label, 8, 8, sequence).unwrap()
    }

    fn inputs(reference: bool) -> Inputs {
        let dark = AnyArtifact::new(clip("relit", 0.0));
        let inputs = Inputs::new().with("clips", AnyArtifact::new(clip("rendered", 1.0))).with("clips", dark);
        let times: Vec<f64> = (0..600).map(|k| f64::from(k) / 30.0).collect();
        let values = times.iter().map(|t| (std::f64::consts::TAU * 1.3 * t).sin()).collect();
        let series = Series::new(times, values).unwrap();
        if reference { inputs.with("reference", AnyArtifact::new(series)) } else { inputs }
    }

    #[test]
    fn figures_and_tables_say_the_same_and_a_dark_clip_fails_alone() {
        let node = BenchmarkDecoder { methods: vec![ReadBy::Pos, ReadBy::Green], ..BenchmarkDecoder::default() };
        let outputs = node.run(&inputs(true), &Context::silent()).unwrap();
        let metrics = outputs.get("metrics").unwrap().downcast::<Metrics>().unwrap();
        assert!(metrics.get("rendered.pos.hr_error_bpm").unwrap() < 0.5, "{metrics:?}");
        assert!(
            metrics.get("rendered.green.snr_db").unwrap() > 3.0 && metrics.get("relit.pos.hr_bpm").unwrap().is_nan()
        );
        let table = outputs.get("table").unwrap().downcast::<Table>().unwrap();
        let Some(Cells::Numbers(bpm)) = table.column("hr_bpm") else { panic!("{table:?}") };
        assert_eq!((table.rows(), bpm[0]), (4, metrics.get("rendered.pos.hr_bpm").unwrap()));
        let Some(Cells::Numbers(mae)) = table.column("mae_bpm") else { panic!("{table:?}") };
        assert!(mae[0] < 1.5 && mae[2].is_nan());
        let files = outputs.get("files").unwrap().downcast::<Files>().unwrap();
        let names: Vec<&str> = files.iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["bland_altman_rendered.png", "decoders.csv", "decoders.parquet"]);
        let traces = outputs.get("traces").unwrap().downcast::<Traces>().unwrap();
        assert_eq!(
            traces.0.iter().map(|trace| trace.label.as_str()).collect::<Vec<_>>(),
            ["rendered.pos", "rendered.green"]
        );

        let alone = node.run(&inputs(false), &Context::silent()).unwrap();
        let metrics = alone.get("metrics").unwrap().downcast::<Metrics>().unwrap();
        assert!(metrics.get("rendered.pos.hr_error_bpm").is_none() && metrics.get("rendered.pos.snr_db").is_some());
    }

    #[test]
    fn a_network_without_weights_and_weights_that_are_none_are_told_apart() {
        let node = BenchmarkDecoder { methods: vec![ReadBy::PhysNet], ..BenchmarkDecoder::default() };
        let error = node.run(&inputs(true), &Context::silent()).err().unwrap();
        assert!(error.message.contains("PhysNet") && error.parameter == Some("weights") && error.remedy.is_some());
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), b"no weights at all").unwrap();
        let weights = vec![file.path().display().to_string()];
        let error = BenchmarkDecoder { weights, ..BenchmarkDecoder::default() };
        let error = error.run(&inputs(true), &Context::silent()).err().unwrap();
        assert!(error.message.contains("weight file"), "{error:?}");
    }
}
