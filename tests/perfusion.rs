//! A perfusion map read back from rendered 8-bit frames: how strongly and when the pulse arrives in each region.

use heartian_avatar::{PerfusionMap, RenderOptions, perfusion, render_clip};
use heartian_pulse::{
    PhaseOptions, Prescription, ResidualOptions, Scene, fit_phase, fit_residual, modulation_from_fundamental,
};
use heartian_signal::regional::arrivals;
use heartian_space::color::linear_from_srgb;
use heartian_space::{Clip, Modulation, Rgb8Image, Skin};

use crate::stage2::{Small, onwards, small_avatar};

const BPM: f64 = 74.0;
/// Largest delay of the drawn map.
const DELAY_SECONDS: f32 = 0.06;

/// Upper half of the face three times as strong as the lower, which is late by the largest delay.
fn drawn() -> Rgb8Image {
    let rows = (0..64u8).flat_map(|row| [if row < 32 { [192u8, 0, 0] } else { [64, 255, 0] }; 64].concat());
    Rgb8Image { width: 64, height: 64, data: rows.collect() }
}

/// Linear green of a clip, frame by frame.
fn green(clip: &Clip) -> Vec<Vec<f32>> {
    let value = |rgb: &[u8; 3]| linear_from_srgb(f32::from(rgb[1]) / 255.0);
    (0..clip.len()).map(|frame| clip.frame(frame).as_chunks::<3>().0.iter().map(value).collect()).collect()
}

fn render(small: &Small, modulation: Option<&Modulation>) -> Vec<Vec<f32>> {
    let options = RenderOptions { label: "test", modulation, ..RenderOptions::default() };
    green(&render_clip(&small.avatar, &small.tracked, &options).unwrap())
}

/// How much each pixel of each frame sees the Gaussians of a region: what a plain offset of theirs does to it.
fn sight(small: &Small, skin: &Skin, plain: &[Vec<f32>], upper: bool) -> Vec<Vec<f32>> {
    let frames = plain.len();
    let offset: Vec<f32> = skin.positions.iter().map(|p| if (p[1] > 0.0) == upper { 0.1 } else { 0.0 }).collect();
    let probe = Modulation {
        gaussians: skin.gaussians.clone(),
        times_seconds: small.recording.clip.times_seconds.clone(),
        offsets: offset.repeat(frames),
        ..Modulation::default()
    };
    let seen = render(small, Some(&probe));
    let weights = |(seen, plain): (&Vec<f32>, &Vec<f32>)| seen.iter().zip(plain).map(|(a, b)| 10.0 * (a - b)).collect();
    seen.iter().zip(plain).map(weights).collect()
}

/// Mean over a region's own pixels, frame by frame, per unit of what they see of it.
fn region(frame: &[f32], plain: &[f32], own: &[f32], other: &[f32]) -> f32 {
    let chosen = (0..frame.len()).filter(|&pixel| own[pixel] > 0.1 && own[pixel] > 8.0 * other[pixel]);
    let (moved, seen) = chosen.fold((0.0, 0.0), |(m, s), k| (m + frame[k] - plain[k], s + own[k]));
    moved / seen
}

#[test]
fn strength_and_delay_of_a_drawn_map_are_read_back_from_rendered_frames() {
    let mut small = small_avatar(12.0);
    let map = perfusion(PerfusionMap::Picture(&drawn()), &small.skin.positions, DELAY_SECONDS).unwrap();
    small.skin.perfusion = map;
    let skin = &small.skin;
    let times = &small.recording.clip.times_seconds;
    let reference = Prescription { heart_rate_bpm: BPM, sdnn_seconds: 0.02, ..Prescription::default() };
    let reference = reference.reference(times).unwrap();
    let scene = Scene { mean_green_albedo: 0.3, ..Scene::default() };
    let (pulse, _) =
        fit_phase(&reference, &scene, &PhaseOptions { steps: 200, ..PhaseOptions::default() }, &mut onwards).unwrap();
    let (fundamental, _) = modulation_from_fundamental(&pulse, skin).unwrap();
    let residual = ResidualOptions { steps: 40, width: 32, ..ResidualOptions::default() };
    let (_, full) = fit_residual(&pulse, skin, None, &residual, &mut onwards).unwrap();

    let plain = render(&small, None);
    let sights = [true, false].map(|upper| sight(&small, skin, &plain, upper));
    for (name, modulation, allowed) in [("fundamental", &fundamental, 0.10), ("with residual", &full, 0.15)] {
        let rendered = render(&small, Some(modulation));
        let table: Vec<f32> = (0..rendered.len())
            .flat_map(|t| {
                [(0, 1), (1, 0)].map(|(own, other)| region(&rendered[t], &plain[t], &sights[own][t], &sights[other][t]))
            })
            .collect();
        let found = arrivals(&table, 2, 30.0, BPM).unwrap();
        let (ratio, late) = (found[0].strength / found[1].strength, found[1].delay_seconds - found[0].delay_seconds);
        println!("{name}: upper over lower {ratio:.3} of 3, lower later by {:.1} of 60 ms", 1e3 * late);
        assert!((ratio / 3.0 - 1.0).abs() < allowed, "{name}: {ratio}");
        assert!((late - f64::from(DELAY_SECONDS)).abs() < 0.008, "{name}: {late}");
    }
}
