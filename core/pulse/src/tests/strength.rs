//! How strongly the skin pulses: bounds, the cost to the picture, and the artifacts on disk.
#![expect(clippy::unwrap_used, reason = "tests")]

use heartian_artifact::{Artifact, BundleReader};

use super::*;
use crate::render_loss::{exact_l1, tests::made_up_operator};
use crate::{Prescription, ResidualOptions, evaluate_all, fit_residual, mean_offsets, modulation_from_fundamental};

fn reference(seconds: f64) -> Reference {
    Prescription { sdnn_seconds: 0.03, ..Prescription::default() }.reference(&times(seconds, 30.0)).unwrap()
}

fn extent(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max) - values.iter().copied().fold(f64::INFINITY, f64::min)
}

#[test]
fn the_amplitude_is_what_was_asked_for_and_the_mean_colour_stays() {
    let options = PhaseOptions { amplitude: 0.03, steps: 200, ..PhaseOptions::default() };
    let (pulse, report) = fit(&reference(10.0), &options).unwrap();
    assert!((extent(&pulse.fundamental) - 0.009).abs() < 1e-4, "{}", extent(&pulse.fundamental));
    assert!(crate::numeric::mean(&pulse.fundamental).abs() < 1e-9);
    assert!(report.levels > 0.5 && report.levels < 4.0, "{report:?}");
    let paper = PhaseOptions { centred: false, ..options };
    let (pulse, _) = fit(&reference(10.0), &paper).unwrap();
    assert!(pulse.fundamental.iter().all(|value| *value >= 0.0));
}

#[test]
fn the_bound_in_8_bit_levels_holds_for_every_offset() {
    let options = PhaseOptions { amplitude: 0.5, most_levels: 2.0, steps: 100, ..PhaseOptions::default() };
    let (pulse, report) = fit(&reference(10.0), &options).unwrap();
    assert!(report.levels <= 2.0 + 1e-9);
    let options = ResidualOptions { steps: 60, width: 32, ..ResidualOptions::default() };
    let (fitted, modulation) = fit_residual(&pulse, &skin(40), None, &options, &mut onwards).unwrap();
    let most = fitted.most_offset(0) as f32;
    assert!(modulation.offsets.iter().all(|offset| offset.abs() <= most));
}

#[test]
fn the_photometric_loss_is_seen_and_stays_small() {
    let reference = reference(4.0);
    let operator = made_up_operator(120, 30, 40, 3);
    let scene = Scene { renderer: Some(&operator), mean_green_albedo: 0.3, ..Scene::default() };
    let options = PhaseOptions { steps: 300, ..PhaseOptions::default() };
    let (pulse, report) = fit_phase(&reference, &scene, &options, &mut onwards).unwrap();
    let base = exact_l1(&operator, &vec![0.0; 120 * 40]);
    let residual = ResidualOptions { steps: 60, width: 32, ..ResidualOptions::default() };
    let (_, modulation) = fit_residual(&pulse, &skin(40), Some(&operator), &residual, &mut onwards).unwrap();
    let offsets: Vec<f64> = modulation.offsets.iter().map(|&offset| f64::from(offset)).collect();
    let modulated = exact_l1(&operator, &offsets);
    println!("L1 {base:.6} → {modulated:.6}; surrogate {:.6}", report.base_loss);
    assert!(report.base_loss > 0.0 && modulated < 1.02 * base);
    let wrong = made_up_operator(120, 30, 39, 3);
    assert!(fit_residual(&pulse, &skin(40), Some(&wrong), &residual, &mut onwards).is_err());
}

#[test]
fn the_residual_leaves_phase_and_waveform_alone_and_improves_the_match() {
    let ppg = made_up_ppg(14.0, 100.0, |t| 70.0 + 6.0 * t.sin(), 0.05);
    let reference = Reference::from_ppg(&ppg, &times(10.0, 30.0)).unwrap();
    let (pulse, before) = fit(&reference, &PhaseOptions { steps: 300, ..PhaseOptions::default() }).unwrap();
    let options = ResidualOptions { width: 32, ..ResidualOptions::default() };
    let (fitted, modulation) = fit_residual(&pulse, &skin(300), None, &options, &mut onwards).unwrap();
    assert_eq!((&fitted.phase, &fitted.waveform, &fitted.theta), (&pulse.phase, &pulse.waveform, &pulse.theta));
    let (before, after) = (before.fundamental_pearson, fitted.report.full_pearson.unwrap());
    assert!(after > before && after > 0.99, "{before} {after}");
    assert!(crate::numeric::mean(&mean_offsets(&modulation)).abs() < 1e-6);
}

#[test]
fn low_rank_evaluation_is_the_exact_one_to_its_tolerance() {
    let (pulse, _) = fit(&reference(20.0), &PhaseOptions { steps: 100, ..PhaseOptions::default() }).unwrap();
    let skin = skin(2000);
    let options = ResidualOptions { steps: 60, width: 48, ..ResidualOptions::default() };
    let (fitted, fast) = fit_residual(&pulse, &skin, None, &options, &mut onwards).unwrap();
    let (exact, _) = evaluate_all(&fitted, &skin, &crate::Evaluation::Exact).unwrap();
    let square = |values: &mut dyn Iterator<Item = f32>| values.map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
    let apart = square(&mut exact.offsets.iter().zip(&fast.offsets).map(|(a, b)| a - b));
    let whole = square(&mut exact.offsets.iter().copied());
    println!("low rank against exact: {:.1e} of the modulation", apart / whole);
    assert!(apart > 0.0 && apart < 1e-3 * whole);
}

#[test]
fn the_same_input_gives_the_same_bytes_at_any_thread_count() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (pulse, _) = fit(&reference(8.0), &PhaseOptions { steps: 50, ..PhaseOptions::default() }).unwrap();
            let options = ResidualOptions { steps: 20, ..ResidualOptions::default() };
            let (fitted, modulation) = fit_residual(&pulse, &skin(1500), None, &options, &mut onwards).unwrap();
            (fitted.to_bundle().unwrap().to_bytes().unwrap(), modulation.to_bundle().unwrap().to_bytes().unwrap())
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn a_pulse_survives_the_disk_with_and_without_residual() {
    let (pulse, _) = fit(&reference(4.0), &PhaseOptions { steps: 20, ..PhaseOptions::default() }).unwrap();
    let options = ResidualOptions { steps: 5, width: 16, ..ResidualOptions::default() };
    let (fitted, _) = fit_residual(&pulse, &skin(9), None, &options, &mut onwards).unwrap();
    for pulse in [pulse, fitted] {
        let bytes = pulse.to_bundle().unwrap().to_bytes().unwrap();
        assert_eq!(Pulse::from_bundle(BundleReader::new(&bytes).unwrap()).unwrap(), pulse);
        let mut broken = pulse.clone();
        broken.theta.pop();
        let bytes = broken.to_bundle().map(|bundle| bundle.to_bytes());
        let read =
            bytes.ok().and_then(Result::ok).map(|bytes| BundleReader::new(&bytes).and_then(Pulse::from_bundle).is_ok());
        assert_ne!(read, Some(true));
    }
}

#[test]
fn a_modulation_without_residual_is_the_fundamental_everywhere() {
    let (pulse, _) = fit(&reference(4.0), &PhaseOptions { steps: 20, ..PhaseOptions::default() }).unwrap();
    let (modulation, _) = modulation_from_fundamental(&pulse, &skin(7)).unwrap();
    for (t, value) in pulse.fundamental.iter().enumerate() {
        assert!(modulation.frame(t).iter().all(|offset| *offset == *value as f32));
    }
}
