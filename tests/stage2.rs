//! Stage 2 through the linear map against stage 2 that rasterises at every step: the same pulse, on a case small enough
//! to do both whole.

use std::ops::ControlFlow;

use heartian_avatar::{
    Avatar, FrozenRender, OperatorOptions, SkinOptions, TrainOptions, albedo_operator, select_skin, train,
};
use heartian_capture::synthetic::{SyntheticOptions, SyntheticRecording, generate};
use heartian_face::{HeadModel, Track, TrackOptions, track};
use heartian_pulse::{
    FrameByFrame, FrozenRenderer, PhaseOptions, Reference, ResidualOptions, Scene, fit_phase, fit_residual,
};
use heartian_space::{Modulation, Progress, Skin};

pub fn onwards(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// A recording of 64², the head in it, its avatar of a thousand Gaussians, and their skin.
pub struct Small {
    pub recording: SyntheticRecording,
    pub tracked: Track,
    pub avatar: Avatar,
    pub skin: Skin,
}

/// An avatar small enough for a test.
pub fn small_avatar(seconds: f64) -> Small {
    let size = 64;
    let options = SyntheticOptions { seconds, size, motion: 0.3, ..SyntheticOptions::default() };
    let recording = generate(&options, &mut onwards).unwrap();
    let focal = TrackOptions { focal_px: Some(2.2 * size as f64), ..TrackOptions::default() };
    let tracked = track(&HeadModel::procedural(), &recording.observations, &focal, &mut onwards).unwrap();
    let small = TrainOptions { gaussians: 1000, steps: 120, ..TrainOptions::default() };
    let (avatar, _) = train(&recording.clip, &tracked, &small, &mut onwards).unwrap();
    let skin = select_skin(&avatar, &tracked.baked_head(), &SkinOptions::default()).unwrap();
    Small { recording, tracked, avatar, skin }
}

/// Distance of two modulations as a share of the second's size.
fn apart(a: &Modulation, b: &Modulation) -> f64 {
    let square = |values: &mut dyn Iterator<Item = f32>| values.map(|v| f64::from(v).powi(2)).sum::<f64>();
    let difference = square(&mut a.offsets.iter().zip(&b.offsets).map(|(a, b)| a - b));
    (difference / square(&mut b.offsets.iter().copied())).sqrt()
}

#[test]
fn the_linear_map_fits_the_pulse_that_rasterising_every_step_fits() {
    let Small { recording, avatar, skin, .. } = small_avatar(5.0);
    let operator = albedo_operator(&avatar, &skin, &recording.clip, &OperatorOptions::default(), &mut onwards).unwrap();

    let frozen = FrozenRender::new(&avatar, &skin, &recording.clip).unwrap();
    let render = |frame: usize, offsets: &[f32], gradient: &mut [f32]| {
        frozen.loss(frame, offsets, gradient).map_err(|error| error.to_string())
    };
    let rasteriser = FrameByFrame {
        gaussians: skin.gaussians.len(),
        frames: avatar.training_frames,
        levels_per_albedo: operator.levels_per_albedo(),
        seed: 1,
        render: &render,
    };
    let reference = Reference::from_ppg(&recording.ppg, &recording.clip.times_seconds).unwrap();
    let mean_green_albedo =
        skin.green_albedo.iter().map(|&g| f64::from(g)).sum::<f64>() / skin.green_albedo.len() as f64;
    // Few steps take A where the paper's many do only at a higher rate; all else is as it is by default.
    let mut phase = PhaseOptions { steps: 600, ..PhaseOptions::default() };
    phase.rates.scale = 3e-3;
    let residual = ResidualOptions { steps: 80, width: 32, ..ResidualOptions::default() };
    let fit = |renderer: &dyn FrozenRenderer| {
        let scene = Scene { weak_phase: None, renderer: Some(renderer), mean_green_albedo };
        let (pulse, report) = fit_phase(&reference, &scene, &phase, &mut onwards).unwrap();
        let (full, modulation) = fit_residual(&pulse, &skin, Some(renderer), &residual, &mut onwards).unwrap();
        (pulse, report, full, modulation)
    };
    let (quick, quick_report, quick_full, through_map) = fit(&operator);
    let (slow, slow_report, slow_full, through_raster) = fit(&rasteriser);
    let distance = apart(&through_map, &through_raster);
    let (a, b) = (quick.strength.scale, slow.strength.scale);
    let (p, q) = (quick_full.report.full_pearson.unwrap(), slow_full.report.full_pearson.unwrap());
    println!(
        "apart {:.3} %; A {a:.6} {b:.6}; fundamental {:.6} {:.6}; full {p:.6} {q:.6}",
        100.0 * distance,
        quick_report.fundamental_pearson,
        slow_report.fundamental_pearson
    );
    assert!(distance < 0.005, "the two modulations are {:.2} % apart", 100.0 * distance);
    assert!((quick_report.fundamental_pearson - slow_report.fundamental_pearson).abs() < 1e-4);
    assert!((p - q).abs() < 1e-3 && (a / b - 1.0).abs() < 0.02);

    // Both would be equal if L_base had no say at all: without it A stays, with it A falls to its floor.
    let mut alone = phase;
    alone.weights.base = 0.0;
    let scene = Scene { weak_phase: None, renderer: Some(&operator), mean_green_albedo };
    let (free, _) = fit_phase(&reference, &scene, &alone, &mut onwards).unwrap();
    assert!(free.strength.scale > 1.1 * a, "{} {a}", free.strength.scale);
}
