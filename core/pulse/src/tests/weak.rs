//! The weak phase from video: found when the video holds the pulse, dropped when it holds another.
#![expect(clippy::unwrap_used, reason = "tests")]

use heartian_signal::methods::PosWindow;

use super::*;
use crate::numeric::wrap;
use crate::reference::weak_phase;
use crate::{Prescription, Waveform};

/// Mean colours of a face whose skin darkens with each beat, chiefly in green, under flicker and noise.
fn colors(phase: &[f64], noise: f64) -> Vec<[f64; 3]> {
    let (shape, mut random) = (Waveform::default(), Random::new(5));
    let color = |(t, phase): (usize, &f64)| {
        let pulse = shape.at(wrap(*phase));
        let light = 1.0 + 0.02 * (0.01 * t as f64).sin();
        let mut mix = |base: f64, depth: f64| base * light * (1.0 - depth * pulse + noise * random.normal());
        [mix(170.0, 0.002), mix(120.0, 0.008), mix(100.0, 0.004)]
    };
    phase.iter().enumerate().map(color).collect()
}

#[test]
fn the_videos_own_pulse_keeps_step_and_anchors_the_phase() {
    let reference =
        Prescription { sdnn_seconds: 0.02, ..Prescription::default() }.reference(&times(20.0, 30.0)).unwrap();
    for window in [PosWindow::Global, PosWindow::SLIDING] {
        let weak = weak_phase(&colors(&reference.phase, 5e-4), &reference, window).unwrap().unwrap();
        println!("{window:?}: coherence {:.3}", weak.coherence);
        assert!(weak.coherence > 0.8 && weak.theta.len() == 600);
        let scene = Scene { weak_phase: Some(&weak), mean_green_albedo: 0.3, ..Scene::default() };
        let options = PhaseOptions { steps: 300, ..PhaseOptions::default() };
        let (_, report) = fit_phase(&reference, &scene, &options, &mut onwards).unwrap();
        assert!(report.pos_loss > 0.0 && report.phase_loss.sqrt() < 0.15, "{report:?}");
        let (_, alone) = fit(&reference, &options).unwrap();
        println!(
            "phase {:.4} rad and Pearson {:.5} with the video's phase, {:.4} and {:.5} without",
            report.phase_loss.sqrt(),
            report.fundamental_pearson,
            alone.phase_loss.sqrt(),
            alone.fundamental_pearson
        );
        assert!((report.fundamental_pearson - alone.fundamental_pearson).abs() < 0.01);
    }
}

#[test]
fn another_pulse_is_no_prior_and_bad_colours_are_refused() {
    let times = times(20.0, 30.0);
    let reference = Prescription { heart_rate_bpm: 96.0, ..Prescription::default() }.reference(&times).unwrap();
    let own = Prescription { heart_rate_bpm: 63.0, ..Prescription::default() }.reference(&times).unwrap();
    assert!(weak_phase(&colors(&own.phase, 5e-4), &reference, PosWindow::Global).unwrap().is_none());
    assert!(weak_phase(&[[1.0; 3]; 10], &reference, PosWindow::Global).is_err());
    assert!(weak_phase(&vec![[0.0; 3]; 600], &reference, PosWindow::Global).is_err());
    let still = weak_phase(&vec![[90.0, 80.0, 70.0]; 600], &reference, PosWindow::Global);
    assert!(matches!(still, Ok(None) | Err(_)));
}
