//! `signals/`: whole evaluations of recordings and data sets.

use heartian_signal::metrics::{DatasetMetrics, Evaluation, Figure, RateMode, WindowScore, bland_altman, summarise};

use super::file::{Bound, Checks, Golden, Outcome};

/// A score as the goldens list it.
fn row(score: &WindowScore) -> [f64; 4] {
    [score.reference_bpm, score.predicted_bpm, score.snr_db, score.macc]
}

/// `signals/per_video.npz`, summed up in f64: the bounds that the manifest's note states for that.
pub fn per_video(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    for k in 0..golden.count("pred") {
        let [rate, derivative, peaks] = golden.array(&format!("cfg{k}"))? else {
            return Err("cfg has three values".into());
        };
        let mode = if *peaks > 0.0 { RateMode::Peak } else { RateMode::Fft };
        let evaluation = Evaluation { mode, derivative: *derivative > 0.0, ..Evaluation::default() };
        let (predicted, label) = (golden.array(&format!("pred{k}"))?, golden.array(&format!("label{k}"))?);
        let got = row(&evaluation.score(predicted, label, *rate)?[0]);
        let (double, single) = (golden.array(&format!("out64_{k}"))?, golden.array(&format!("out{k}"))?);
        for (column, (name, pointer, tight)) in COLUMNS.into_iter().enumerate() {
            let loose = Bound::absolute(golden.tolerance(pointer)?);
            checks.close(&format!("{name} f64"), &got[column..=column], &double[column..=column], tight);
            checks.close(&format!("{name} f32"), &got[column..=column], &single[column..=column], loose);
        }
    }
    Ok(())
}

const COLUMNS: [(&str, &str, Bound); 4] = [
    ("hr_label", "/hr_atol", Bound { absolute: 1e-9, relative: 0.0 }),
    ("hr_pred", "/hr_atol", Bound { absolute: 1e-9, relative: 0.0 }),
    ("snr", "/snr_atol_db", Bound { absolute: 1e-6, relative: 0.0 }),
    ("macc", "/macc_atol", Bound { absolute: 1e-8, relative: 0.0 }),
];

/// `signals/dataset_metrics.npz`.
pub fn dataset(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    for name in golden.names("out_") {
        let parts: Vec<&str> = name.split('_').collect();
        let [_, label_type, mode, window] = parts[..] else {
            return Err(format!("{name} is not out_<label>_<mode>_<window>").into());
        };
        let evaluation = Evaluation {
            mode: if mode == "Peak" { RateMode::Peak } else { RateMode::Fft },
            derivative: label_type == "DiffNormalized",
            window_seconds: window.strip_prefix("win").map(str::parse).transpose()?,
            ..Evaluation::default()
        };
        let mut scores = Vec::new();
        for video in 0..golden.count(&format!("{label_type}_pred_v")) {
            let predicted = golden.array(&format!("{label_type}_pred_v{video}"))?;
            scores.extend(evaluation.score(predicted, golden.array(&format!("{label_type}_label_v{video}"))?, 30.0)?);
        }
        let rates = if mode == "Peak" { 1e-6 } else { golden.tolerance("/hr_metrics_rtol")? };
        // A standard error may be exactly zero in the golden; then only its absolute bound counts.
        let rates = Bound { absolute: 1e-12, relative: rates };
        let snr = Bound::absolute(golden.tolerance("/snr_atol_db")?);
        let macc = Bound::absolute(golden.tolerance("/macc_atol")?);
        let want = golden.array(name)?;
        let bounds = [rates, rates, rates, rates, snr, macc];
        for (k, ((what, figure), bound)) in figures(&summarise(&scores)?).into_iter().zip(bounds).enumerate() {
            let got = [figure.value, figure.standard_error];
            checks.close(&format!("{what} {mode}"), &got, &want[2 * k..2 * k + 2], bound);
        }
    }
    Ok(())
}

fn figures(metrics: &DatasetMetrics) -> [(&'static str, Figure); 6] {
    [
        ("MAE", metrics.mae),
        ("RMSE", metrics.rmse),
        ("MAPE", metrics.mape),
        ("Pearson", metrics.pearson),
        ("SNR", metrics.snr_db),
        ("MACC", metrics.macc),
    ]
}

/// `signals/metric_formulas.npz`.
pub fn formulas(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    let bound = Bound { absolute: 0.0, relative: golden.tolerance("/rtol")? };
    let (predicted, reference) = (golden.array("hr_pred")?, golden.array("hr_gt")?);
    let score = |(&predicted_bpm, &reference_bpm): (&f64, &f64)| WindowScore {
        reference_bpm,
        predicted_bpm,
        snr_db: 0.0,
        macc: 0.0,
    };
    let scores: Vec<WindowScore> = predicted.iter().zip(reference).map(score).collect();
    for (what, figure) in figures(&summarise(&scores)?).into_iter().take(4) {
        checks.close(what, &[figure.value, figure.standard_error], golden.array(what)?, bound);
    }
    let agreement = bland_altman(predicted, reference)?;
    let got = [agreement.mean, agreement.deviation, agreement.upper, agreement.lower];
    checks.close("Bland–Altman", &got, golden.array("bland_altman_mean_error_sd_ci_averaged")?, bound);
    Ok(())
}
