//! Green alone against blood in three colours: what each classical reader recovers, by skin tone and light.
//! `cargo test -p heartian-pulse recoverability -- --nocapture` prints the table.
#![expect(clippy::unwrap_used, reason = "tests")]

use heartian_signal::{Method, Preset};
use heartian_space::color::{quantise, srgb_from_linear};

use super::*;
use crate::{Parameterization, Prescription};

const TONES: [(&str, [f32; 3]); 4] = [
    ("light", [0.60, 0.42, 0.33]),
    ("medium", [0.40, 0.25, 0.17]),
    ("brown", [0.22, 0.12, 0.075]),
    ("dark", [0.12, 0.07, 0.05]),
];
const LIGHTS: [(&str, [f32; 3]); 3] =
    [("white", [0.8, 0.8, 0.8]), ("warm", [1.0, 0.71, 0.42]), ("dim", [0.28, 0.28, 0.28])];
const METHODS: [Method; 4] = [Method::Green, Method::Pos, Method::Chrom, Method::Pbv];
/// Relative pulsatility of haemoglobin: the figures of `heartian_avatar::blood`, which this crate does not see.
const PULSATILITY: [f32; 3] = [0.33, 0.77, 0.53];
const PIXELS: usize = 24 * 24;

/// Mean sRGB codes of 8-bit frames with sensor noise and a light that trembles by half a percent.
fn film(pulse: &Pulse, albedo: [f32; 3], light: [f32; 3], red_blue: [f32; 2]) -> Vec<[f64; 3]> {
    let mut random = Random::new(9);
    let frame = |offset: &f64| {
        let offset = *offset as f32;
        let moved = [red_blue[0] * offset, offset, red_blue[1] * offset];
        let tremble = 1.0 + 0.005 * random.normal() as f32;
        let mut sum = [0.0; 3];
        for _ in 0..PIXELS {
            for channel in 0..3 {
                let linear = (albedo[channel] + moved[channel]) * light[channel] * tremble;
                let noisy = srgb_from_linear(linear) + 1.5 / 255.0 * random.normal() as f32;
                sum[channel] += f64::from(quantise(noisy));
            }
        }
        sum.map(|sum| sum / PIXELS as f64)
    };
    pulse.fundamental.iter().map(frame).collect()
}

#[test]
fn recoverability_by_tone_and_light() {
    let reference = Prescription { heart_rate_bpm: 76.0, sdnn_seconds: 0.02, ..Prescription::default() };
    let reference = reference.reference(&times(20.0, 30.0)).unwrap();
    println!("tone light | SNR dB of GREEN POS CHROM PBV, green alone | the same in three colours");
    let mut mean = [[0.0f64; METHODS.len()]; 2];
    for (tone, albedo) in TONES {
        let scene = Scene { mean_green_albedo: f64::from(albedo[1]), ..Scene::default() };
        let options =
            PhaseOptions { parameterization: Parameterization::Anchored, steps: 60, ..PhaseOptions::default() };
        let (pulse, _) = fit_phase(&reference, &scene, &options, &mut onwards).unwrap();
        let share = |c: usize| PULSATILITY[c] / PULSATILITY[1] * albedo[c] / albedo[1];
        for (light, color) in LIGHTS {
            let mut line = format!("{tone} {light} |");
            for (k, red_blue) in [[0.0, 0.0], [share(0), share(2)]].into_iter().enumerate() {
                let rgb = film(&pulse, albedo, color, red_blue);
                for (m, method) in METHODS.into_iter().enumerate() {
                    let trace = method.trace(&rgb, 30.0).unwrap();
                    let found = Preset::ToolboxFine.protocol().estimate(&trace, 30.0).unwrap();
                    let snr = found.snr_db(reference.mean_bpm);
                    mean[k][m] += snr / (TONES.len() * LIGHTS.len()) as f64;
                    line += &format!(" {snr:.1}");
                    if method == Method::Pos {
                        assert!((found.bpm - 76.0).abs() < 1.5, "{tone} {light} {k}: {}", found.bpm);
                    }
                }
                line += " |";
            }
            println!("{line}");
        }
    }
    println!("mean: green alone {:.1?}, three colours {:.1?}", mean[0], mean[1]);
    // PBV looks for the signature itself, so it must gain; POS and CHROM take the common part away.
    assert!(mean[1][3] > mean[0][3], "{mean:?}");
}
