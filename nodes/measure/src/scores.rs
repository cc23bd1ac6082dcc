//! What BenchmarkDecoder reports: metrics by name, the table, and its files.

use std::sync::Arc;

use heartian_decoder::Measured;
use heartian_graph::{Files, NodeError};
use heartian_report::{Agreement, agreement_figure, encode_png, table_csv, table_parquet};
use heartian_signal::Protocol;
use heartian_signal::metrics::{DatasetMetrics, Evaluation, RateMode, WindowScore, bland_altman, summarise};
use heartian_signal::stats::macc;
use heartian_space::{Cell, Metrics, Series, Table};

/// Columns of the table before those of the windows.
const FIGURES: [&str; 8] =
    ["clip", "decoder", "hr_bpm", "reference_bpm", "hr_error_bpm", "snr_db", "macc", "confidence"];
/// Figures over windows; each has a column and one for its standard error.
const OVER_WINDOWS: [&str; 6] = ["mae_bpm", "rmse_bpm", "mape_percent", "pearson", "window_snr_db", "window_macc"];

/// The waveform that the pictures should carry, and its heart rate.
pub(crate) struct Reference {
    pub series: Arc<Series>,
    pub bpm: f64,
}

/// Collects what decoders say of clips.
pub(crate) struct Scores {
    evaluation: Evaluation,
    reference: Option<Reference>,
    metrics: Metrics,
    rows: Vec<Vec<Cell>>,
    /// Predicted and reference rates of windows, by clip, then by decoder.
    pairs: Vec<(String, Groups)>,
}

/// Pairs of rates by decoder.
type Groups = Vec<(String, Vec<(f64, f64)>)>;

impl Scores {
    pub(crate) fn new(protocol: Protocol, window_seconds: f64, reference: Option<Reference>) -> Self {
        let window_seconds = Some(window_seconds);
        let evaluation = Evaluation { protocol, mode: RateMode::Fft, derivative: false, window_seconds };
        Self { evaluation, reference, metrics: Metrics::new(), rows: Vec::new(), pairs: Vec::new() }
    }

    /// Adds what one decoder says of one clip; a decoder that found nothing has a row without figures.
    pub(crate) fn add(&mut self, clip: &str, key: &str, found: Option<&Measured>) {
        let name = format!("{clip}.{key}");
        let expected = self.reference.as_ref().map_or(f64::NAN, |reference| reference.bpm);
        let bpm = found.map_or(f64::NAN, |found| found.rate.bpm);
        let (windows, macc) = found.and_then(|found| self.against_reference(found)).unwrap_or_default();
        let at = if expected.is_nan() { bpm } else { expected };
        let figures = [
            ("hr_bpm", bpm, true),
            ("hr_error_bpm", (bpm - expected).abs(), !expected.is_nan()),
            ("snr_db", found.map_or(f64::NAN, |found| found.rate.snr_db(at)), true),
            ("macc", macc.unwrap_or(f64::NAN), !expected.is_nan()),
            ("confidence", found.map_or(f64::NAN, Measured::confidence), true),
        ];
        for (figure, value, _) in figures.iter().filter(|(_, _, shown)| *shown) {
            self.metrics.0.insert(format!("{name}.{figure}"), *value);
        }
        let mut row = vec![Cell::Text(clip.to_owned()), Cell::Text(key.to_owned())];
        let [(_, bpm, _), (_, error, _), (_, snr_db, _), (_, macc, _), (_, confidence, _)] = figures;
        row.extend([bpm, expected, error, snr_db, macc, confidence].map(Cell::Number));
        row.extend(over_windows(summarise(&windows).ok()).into_iter().flatten().map(Cell::Number));
        self.rows.push(row);
        if !windows.is_empty() {
            let pairs = windows.iter().map(|window| (window.predicted_bpm, window.reference_bpm)).collect();
            match self.pairs.iter_mut().find(|(other, _)| other == clip) {
                Some((_, groups)) => groups.push((key.to_owned(), pairs)),
                None => self.pairs.push((clip.to_owned(), vec![(key.to_owned(), pairs)])),
            }
        }
    }

    /// Scores of the windows, and MACC over the recording.
    fn against_reference(&self, found: &Measured) -> Option<(Vec<WindowScore>, Option<f64>)> {
        let Reference { series, .. } = self.reference.as_ref()?;
        let rate = found.rate.rate_hertz;
        let at = |k: usize| series.at(found.start_seconds + k as f64 / rate);
        let label: Vec<f64> = (0..found.trace.len()).map(at).collect();
        let whole =
            self.evaluation.protocol.filtered(&label, rate).and_then(|label| macc(&found.rate.filtered, &label));
        let windows = self.evaluation.score(&found.trace, &label, rate).unwrap_or_default();
        Some((windows, whole.ok()))
    }

    pub(crate) fn finish(self) -> Result<(Metrics, Table, Files), NodeError> {
        let windows: Vec<String> =
            OVER_WINDOWS.iter().flat_map(|name| [(*name).to_owned(), format!("{name}_se")]).collect();
        let names: Vec<&str> = FIGURES.into_iter().chain(windows.iter().map(String::as_str)).collect();
        let table = Table::from_rows(&names, self.rows)?;
        let mut files = Files::new()
            .with("decoders.csv", table_csv(&table).into_bytes())?
            .with("decoders.parquet", table_parquet(&table))?;
        for (clip, groups) in self.pairs {
            if let Some(picture) = agreement_picture(groups)? {
                // Labels come from graphs; a file's name must stay one.
                let name: String = clip.chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
                files = files.with(&format!("bland_altman_{name}.png"), picture)?;
            }
        }
        Ok((self.metrics, table, files))
    }
}

/// Figures over windows and their standard errors, in the order of the columns; NaN where there are none.
fn over_windows(metrics: Option<DatasetMetrics>) -> [[f64; 2]; 6] {
    metrics.map_or([[f64::NAN; 2]; 6], |m| {
        [m.mae, m.rmse, m.mape, m.pearson, m.snr_db, m.macc].map(|figure| [figure.value, figure.standard_error])
    })
}

/// The Bland–Altman plot of a clip's windows; nothing without two of them.
fn agreement_picture(groups: Groups) -> Result<Option<Vec<u8>>, NodeError> {
    let finite = groups.iter().flat_map(|(_, pairs)| pairs).filter(|(p, g)| p.is_finite() && g.is_finite());
    let (predicted, reference): (Vec<f64>, Vec<f64>) = finite.copied().unzip();
    if predicted.len() < 2 {
        return Ok(None);
    }
    let found = bland_altman(&predicted, &reference)?;
    let agreement = Agreement { groups, mean: found.mean, limits: (found.lower, found.upper) };
    Ok(Some(encode_png(&agreement_figure(&agreement)?)?))
}
