//! Report: the pictures of a run, for people who would rather look.

use heartian_graph::{Context, Files, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_report::{Curve, contact_sheet, encode_png, encode_preview, waveform_figure};
use heartian_signal::{Band, Resolution, Spectrum, resampled_evenly};
use heartian_space::{Clip, Series, Trace, Traces};

params! {
    /// Draws the contact sheet of some clips, the waveforms with their spectra, and a small animated preview.
    pub struct Report {
        /// Columns of the contact sheet: frames spread evenly over the clips.
        columns: usize = 6, range(1.0, 24.0);
        /// Waveforms drawn: the first so many of all traces.
        curves: usize = 6, range(1.0, 24.0);
        /// How much of the waveforms is drawn, and how much of the clips is previewed.
        seconds: f64 = 8.0, unit("s"), range(0.5, 60.0);
        /// Largest side of a clip in the preview.
        preview_size: usize = 128, unit("px"), range(16.0, 1024.0);
    }
}
register!(Report);

impl Node for Report {
    const KIND: &'static str = "Report";
    const REVISION: u32 = 3;
    const INPUTS: &'static [Port] = &[
        Port::many::<Clip>("clips", "Clips of equal size and length, one row each."),
        Port::many::<Traces>("traces", "Waveforms, one colour each.").optional(),
    ];
    const OUTPUTS: &'static [Port] =
        &[Port::one::<Files>("files", "contact_sheet.png, preview.png, waveforms.png, waveforms.csv.")];

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let clips = inputs.many::<Clip>("clips")?;
        let clips: Vec<&Clip> = clips.iter().map(AsRef::as_ref).collect();
        let mut files = Files::new()
            .with("contact_sheet.png", encode_png(&contact_sheet(&clips, self.columns)?)?)?
            .with("preview.png", encode_preview(&clips, self.preview_size, self.seconds)?)?;
        let (mut curves, mut text) = (Vec::new(), "label,time_s,value\n".to_owned());
        for traces in inputs.many::<Traces>("traces")? {
            for trace in traces.0.iter().take(self.curves - curves.len().min(self.curves)) {
                curves.push(curve(&trace.label, &trace.series)?);
                write_samples(&mut text, trace);
            }
        }
        if !curves.is_empty() {
            let band = Band::TOOLBOX;
            let figure = waveform_figure(&curves, self.seconds, (band.low_hertz, band.high_hertz))?;
            files = files.with("waveforms.png", encode_png(&figure)?)?.with("waveforms.csv", text.into_bytes())?;
        }
        Ok(Outputs::new().put("files", files))
    }
}

/// One line a sample; a label holds no comma, for it is made of the names of clips and methods.
fn write_samples(text: &mut String, trace: &Trace) {
    for (time, value) in trace.series.times_seconds.iter().zip(&trace.series.values) {
        text.push_str(&format!("{},{time},{value}\n", trace.label.replace(',', " ")));
    }
}

fn curve(label: &str, series: &Series) -> Result<Curve, NodeError> {
    let even = resampled_evenly(&series.times_seconds, &series.values)?;
    let spectrum = Spectrum::of(&even.values, even.rate_hertz, Resolution::FINE)?;
    let hertz = (0..spectrum.power.len()).map(|bin| spectrum.hertz(bin)).collect();
    Ok(Curve { label: label.to_owned(), series: series.clone(), spectrum: (hertz, spectrum.power) })
}
