//! What the default amplitude does to an 8-bit picture: the pulse is read back, and the picture hardly pays.
#![expect(clippy::unwrap_used, reason = "tests")]

use heartian_signal::methods::{PosWindow, pos_trace};
use heartian_space::color::{quantise, srgb_from_linear};

use super::*;
use crate::Prescription;

/// A face of one skin tone as pixels: sRGB codes of the baseline render and of the recording it was fitted to.
struct Face {
    /// Linear RGB albedo times irradiance of each pixel.
    linear: Vec<[f32; 3]>,
    irradiance: Vec<f32>,
    recording: Vec<[u8; 3]>,
}

fn face(albedo: [f32; 3], light: f64, error_levels: f64) -> Face {
    let mut random = Random::new(15);
    let (mut linear, mut irradiance, mut recording) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..4000 {
        let shade = (light * (0.5 + 0.5 * random.unit())) as f32;
        let color = albedo.map(|a| a * shade * (1.0 + 0.1 * random.normal() as f32));
        let near = |c: f32| (255.0 * f64::from(srgb_from_linear(c)) + error_levels * random.normal()) as f32 / 255.0;
        recording.push(color.map(near).map(quantise));
        linear.push(color);
        irradiance.push(shade);
    }
    Face { linear, irradiance, recording }
}

/// Mean colour over the face, and the squared error against the recording, of one 8-bit frame with a green offset.
fn frame(face: &Face, offset: f32) -> ([f64; 3], f64) {
    let (mut sum, mut error) = ([0.0; 3], 0.0);
    for ((linear, shade), recorded) in face.linear.iter().zip(&face.irradiance).zip(&face.recording) {
        let color = [linear[0], linear[1] + shade * offset, linear[2]];
        for channel in 0..3 {
            let code = quantise(srgb_from_linear(color[channel].max(0.0)));
            sum[channel] += f64::from(code);
            error += (f64::from(code) - f64::from(recorded[channel])).powi(2);
        }
    }
    (sum.map(|s| s / face.linear.len() as f64), error)
}

#[test]
fn pos_reads_the_pulse_from_8_bit_frames_and_the_picture_hardly_pays() {
    let times = times(20.0, 30.0);
    let reference = Prescription { heart_rate_bpm: 84.0, ..Prescription::default() }.reference(&times).unwrap();
    // Light, medium and dark skin in even light, and dark skin in dim light.
    let cases =
        [([0.60, 0.42, 0.33], 1.0), ([0.40, 0.25, 0.17], 1.0), ([0.12, 0.07, 0.05], 1.0), ([0.12, 0.07, 0.05], 0.4)];
    for (albedo, light) in cases {
        let face = face(albedo, light, 6.0);
        let scene = Scene { mean_green_albedo: f64::from(albedo[1]), ..Scene::default() };
        let options = PhaseOptions { steps: 300, ..PhaseOptions::default() };
        let (pulse, report) = fit_phase(&reference, &scene, &options, &mut onwards).unwrap();
        let (_, still) = frame(&face, 0.0);
        let frames: Vec<_> = pulse.fundamental.iter().map(|&offset| frame(&face, offset as f32)).collect();
        let moving = frames.iter().map(|(_, error)| error).sum::<f64>() / frames.len() as f64;
        let rgb: Vec<[f64; 3]> = frames.iter().map(|(mean, _)| *mean).collect();
        let read = read_bpm(&pos_trace(&rgb, 30.0, PosWindow::SLIDING).unwrap(), 30.0);
        let cost_db = 10.0 * (moving / still).log10();
        let code = 255.0 * srgb_from_linear(albedo[1] * light as f32 * 0.75);
        println!("green code {code:.0}: {:.2} levels, POS {read:.2} of 84, cost {cost_db:.4} dB", report.levels);
        assert!((read - 84.0).abs() < 0.5 && cost_db < 0.02, "{read} {cost_db}");
    }
}
