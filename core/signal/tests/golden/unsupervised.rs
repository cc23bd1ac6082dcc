//! `unsupervised/`: the seven methods on small clips, and their evaluation against a label.

use heartian_signal::Method;
use heartian_signal::methods::{Rgb, pseudo_label};
use heartian_signal::metrics::{Evaluation, RateMode};
use heartian_signal::stats::{pearson, standard_deviation};
use heartian_signal::trace::{Weighting, mean_rgb};
use heartian_space::{Clip, Sequence};

use super::file::{Bound, Checks, Golden, Outcome};

/// `unsupervised/case*.npz`.
pub fn case(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    let rate = golden.scalar("fs")?;
    let rgb = mean_rgb(&clip(golden, rate)?, Weighting::WholeFrame)?;
    checks.close("mean RGB", rgb.as_flattened(), golden.array("rgb_mean_f64")?, Bound::absolute(1e-12));
    for (row, method) in Method::ALL.into_iter().enumerate() {
        let trace = compare_trace(golden, checks, method, &rgb, rate)?;
        compare_scores(golden, checks, method, row, (&trace, rate))?;
    }
    let label = pseudo_label(&rgb, rate)?;
    let want = golden.array("pos_pseudo_label_f64")?;
    let tight = golden.tolerance("/<METHOD>_f64/atol_over_std")? * standard_deviation(want);
    checks.close("pseudo label", &label, want, Bound::absolute(tight));
    Ok(())
}

/// The frames as a clip.
fn clip(golden: &Golden, rate: f64) -> Outcome<Clip> {
    let frames: Vec<u8> = golden.array("frames_u8")?.iter().map(|&code| code as u8).collect();
    let &[_, height, width, 3] = golden.shape("frames_u8")? else { return Err("frames_u8 is not T×H×W×3".into()) };
    let pixels = frames.len() / 3;
    let times_seconds = (0..pixels / (width * height)).map(|frame| frame as f64 / rate).collect();
    Ok(Clip::new("golden", width, height, Sequence { frames, alpha: vec![255; pixels], times_seconds })?)
}

/// Compares a trace with the toolbox's f64 and f32 ones; returns it.
fn compare_trace(golden: &Golden, checks: &mut Checks, method: Method, rgb: &[Rgb], rate: f64) -> Outcome<Vec<f64>> {
    let name = method.name();
    let mut trace = method.trace(rgb, rate)?;
    let (double, single) = (golden.array(&format!("{name}_f64"))?, golden.array(name)?);
    if method == Method::Ica && pearson(&trace, double)? < 0.0 {
        trace.iter_mut().for_each(|value| *value = -*value);
    }
    let share = match method {
        Method::Ica => 1e-4,
        Method::Pbv => golden.tolerance("/<METHOD>_f64/PBV_atol_over_std")?,
        _ => golden.tolerance("/<METHOD>_f64/atol_over_std")?,
    };
    checks.close(&format!("{name} f64"), &trace, double, Bound::absolute(share * standard_deviation(double)));
    if method == Method::Pbv {
        checks.at_least("PBV correlation with f32", pearson(&trace, single)?, 0.9);
    } else {
        let loose = golden.tolerance("/<METHOD>/atol_over_std")? * standard_deviation(single);
        checks.close(&format!("{name} f32"), &trace, single, Bound::absolute(loose));
    }
    Ok(trace)
}

/// Compares the scores of a trace against the label, in both modes.
fn compare_scores(
    golden: &Golden,
    checks: &mut Checks,
    method: Method,
    row: usize,
    (trace, rate): (&[f64], f64),
) -> Outcome<()> {
    let exact = [1e-6, 1e-6, 1e-5, 1e-6];
    let single = [golden.tolerance("/eval_hr")?; 2].into_iter();
    let single: Vec<f64> = single.chain([golden.tolerance("/eval_snr_db")?, golden.tolerance("/eval_macc")?]).collect();
    let tables: [(&str, RateMode, &[f64]); 3] = [
        ("eval_fft_f64", RateMode::Fft, &exact),
        ("eval_fft", RateMode::Fft, &single),
        ("eval_peak", RateMode::Peak, &single),
    ];
    for (table, mode, bounds) in tables {
        if method == Method::Pbv && table != "eval_fft_f64" {
            continue;
        }
        let evaluation = Evaluation { mode, ..Evaluation::default() };
        let score = evaluation.score(trace, golden.array("label")?, rate)?[0];
        let got = [score.reference_bpm, score.predicted_bpm, score.snr_db, score.macc];
        let want = &golden.array(table)?[4 * row..4 * row + 4];
        for (k, what) in ["hr_label", "hr_pred", "snr", "macc"].into_iter().enumerate() {
            let name = format!("{table} {} {what}", method.name());
            checks.close(&name, &got[k..=k], &want[k..=k], Bound::absolute(bounds[k]));
        }
    }
    Ok(())
}
