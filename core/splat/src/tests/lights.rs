//! Lights and deferred shading: energy, parity with the f64 text, exact gradients.

use super::scenes::{Random, noise};
use crate::reference::harmonics::basis_f64;
use crate::reference::shade::{Material, shade as naive};
use crate::{DEFERRED_CHANNELS, Environment, Frame, LightImage, SplatError, shade, shade_backward};
use glam::Vec2;
use heartian_space::Camera;
use heartian_space::color::luminance;

const SIZE: [usize; 2] = [21, 9];

fn camera() -> Camera {
    Camera::at_origin(SIZE[0], SIZE[1], 30.0)
}

/// A frame of random materials with alpha from 0 to 1.
fn materials(seed: u64) -> Frame {
    let (mut r, pixels) = (Random::new(seed), SIZE[0] * SIZE[1]);
    let mut frame = Frame {
        width: SIZE[0],
        height: SIZE[1],
        channels: DEFERRED_CHANNELS + 1,
        planes: vec![0.0; (DEFERRED_CHANNELS + 1) * pixels],
        depth: Vec::new(),
        transmittance: vec![1.0; pixels],
    };
    for i in (0..pixels).filter(|i| i % 7 != 0) {
        let alpha = r.within(0.05, 1.0);
        frame.transmittance[i] = 1.0 - alpha;
        let mut values = [r.unit(), r.unit(), r.unit(), 0.0, 0.0, 0.0, r.within(0.02, 0.98), r.within(0.001, 0.4)];
        for (v, base) in values[3..6].iter_mut().zip([0.0, 0.0, 0.8]) {
            *v = base + r.within(-0.7, 0.7);
        }
        for (c, v) in values.iter().enumerate() {
            frame.planes[c * pixels + i] = v * alpha;
        }
    }
    frame
}

fn material(frame: &Frame, at: usize) -> Material {
    let pixel = Vec2::new((at % SIZE[0]) as f32 + 0.5, (at / SIZE[0]) as f32 + 0.5);
    Material {
        channels: std::array::from_fn(|c| f64::from(frame.plane(c)[at])),
        alpha: 1.0 - f64::from(frame.transmittance[at]),
        view: camera().ray_in_world(pixel).to_array().map(|v| -f64::from(v)),
    }
}

fn random_light(seed: u64) -> Environment {
    let mut light = Environment::uniform([1.0, 0.8, 0.6]);
    for (value, noise) in light.radiance.as_flattened_mut().iter_mut().zip(noise(75, seed)) {
        *value += 0.35 * noise;
    }
    light
}

#[test]
fn a_white_surface_in_a_white_furnace_is_white() -> Result<(), SplatError> {
    let mut frame = materials(1);
    let pixels = SIZE[0] * SIZE[1];
    for reflectance in [0.0, 0.04, 0.5, 1.0] {
        for at in 0..pixels {
            let alpha = 1.0 - frame.transmittance[at];
            for c in 0..3 {
                frame.planes[c * pixels + at] = alpha;
            }
            frame.planes[7 * pixels + at] = reflectance * alpha;
        }
        let rgb = shade(&frame, &camera(), &Environment::uniform([0.5, 1.0, 2.0]))?;
        for (i, value) in rgb.iter().enumerate() {
            let want = [0.5, 1.0, 2.0][i / pixels] * (1.0 - frame.transmittance[i % pixels]);
            assert!((value - want).abs() < 2e-5 * want.max(1.0), "reflectance {reflectance} pixel {i}: {value} {want}");
        }
    }
    Ok(())
}

#[test]
fn fast_shading_is_the_naive_text() -> Result<(), SplatError> {
    let (frame, light, pixels) = (materials(2), random_light(3), SIZE[0] * SIZE[1]);
    let rgb = shade(&frame, &camera(), &light)?;
    for at in 0..pixels {
        let want = naive(&material(&frame, at), &light);
        for c in 0..3 {
            assert!(
                (f64::from(rgb[c * pixels + at]) - want[c]).abs() < 2e-5,
                "pixel {at}: {} {}",
                rgb[c * pixels + at],
                want[c]
            );
        }
    }
    Ok(())
}

#[test]
fn shading_gradients_are_the_derivative_of_the_naive_text() -> Result<(), SplatError> {
    let (frame, light, pixels) = (materials(4), random_light(5), SIZE[0] * SIZE[1]);
    let gradient = noise(3 * pixels, 6);
    let own = shade_backward(&frame, &camera(), &light, &gradient)?;
    let loss = |at: usize, m: &Material, light: &Environment| -> f64 {
        naive(m, light).iter().enumerate().map(|(c, v)| v * f64::from(gradient[c * pixels + at])).sum()
    };
    let (mut checked, h) = (0, 1e-5);
    for at in 0..pixels {
        let m = material(&frame, at);
        for k in 0..=DEFERRED_CHANNELS {
            let moved = |h: f64| {
                let mut m = m;
                if k == DEFERRED_CHANNELS {
                    m.alpha += h
                } else {
                    m.channels[k] += h
                }
                loss(at, &m, &light)
            };
            let one_sided = [(moved(h) - moved(0.0)) / h, (moved(0.0) - moved(-h)) / h];
            let slope = 0.5 * (one_sided[0] + one_sided[1]);
            let got = if k == DEFERRED_CHANNELS { -own.transmittance[at] } else { own.planes[k * pixels + at] };
            // At a table's node the two sides differ; there either side would do.
            if (one_sided[0] - one_sided[1]).abs() < 1e-3 * slope.abs().max(0.1) {
                checked += 1;
                assert!(
                    (f64::from(got) - slope).abs() < 2e-3 * slope.abs().max(0.2),
                    "pixel {at} input {k}: {got} {slope}"
                );
            }
        }
    }
    assert!(checked > pixels * 6, "only {checked} could be checked");
    for (i, c) in [(0, 0), (3, 1), (7, 2), (12, 0), (18, 1), (24, 2)] {
        let moved = |h: f32| {
            let mut light = light.clone();
            light.radiance[i][c] += h;
            (0..pixels).map(|at| loss(at, &material(&frame, at), &light)).sum::<f64>()
        };
        let h = 1.0 / 256.0;
        let slope = (moved(h) - moved(-h)) / (2.0 * f64::from(h));
        assert!((f64::from(own.radiance[i][c]) - slope).abs() < 1e-3 * slope.abs().max(0.1), "{i} {c}");
    }
    assert!(own.planes[DEFERRED_CHANNELS * pixels..].iter().all(|g| *g == 0.0));
    Ok(())
}

#[test]
fn a_picture_of_a_light_projects_onto_that_light() -> Result<(), SplatError> {
    let light = random_light(9);
    let (width, height) = (256, 128);
    let mut data = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let y = basis_f64(crate::environment::direction_of_pixel(column, row, width, height));
            data.extend(
                (0..3).map(|c| light.radiance.iter().zip(y).map(|(r, y)| r[c] * y as f32).sum::<f32>().max(0.0)),
            );
        }
    }
    let back = Environment::from_equirectangular(&LightImage { width, height, data })?;
    for (a, b) in back.radiance.iter().zip(&light.radiance) {
        assert!((0..3).all(|c| (a[c] - b[c]).abs() < 0.05), "{a:?} {b:?}");
    }
    let flat = Environment::from_equirectangular(&LightImage { width: 16, height: 8, data: vec![0.7; 16 * 8 * 3] })?;
    assert!(flat.radiance[1..].as_flattened().iter().all(|v| v.abs() < 1e-3));
    assert!((flat.mean()[0] - 0.7).abs() < 1e-5);
    let poisoned = LightImage { width: 2, height: 1, data: vec![f32::NAN, -1.0, f32::INFINITY, 1.0, 1.0, 1.0] };
    assert!(Environment::from_equirectangular(&poisoned)?.radiance.as_flattened().iter().all(|v| v.is_finite()));
    assert!(Environment::from_equirectangular(&LightImage::default()).is_err());
    Ok(())
}

#[test]
fn lights_turn_and_keep_their_luminance() {
    let (warm, cool) = (Environment::warm(), Environment::cool());
    for light in [&warm, &cool, &warm.turned(0.7)] {
        assert!((luminance(light.mean()) - 1.0).abs() < 1e-4);
    }
    assert!(warm.mean()[0] > warm.mean()[2] && cool.mean()[2] > cool.mean()[0]);
    let back = warm.turned(0.9).turned(-0.9);
    assert!(back.radiance.as_flattened().iter().zip(warm.radiance.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-5));
    // A quarter turn counter-clockwise seen from above carries light from +z to +x.
    let value = |light: &Environment, d: [f64; 3]| -> f64 {
        light.radiance.iter().zip(basis_f64(d)).map(|(r, y)| f64::from(r[0]) * y).sum()
    };
    let turned = warm.turned(std::f64::consts::FRAC_PI_2);
    assert!((value(&warm, [0.0, 0.0, 1.0]) - value(&turned, [1.0, 0.0, 0.0])).abs() < 1e-4);
    assert!((luminance(warm.with_mean_luminance(0.3).mean()) - 0.3).abs() < 1e-5);
}

#[test]
fn frames_that_cannot_be_shaded_are_refused() {
    let frame = materials(1);
    let few = Frame { channels: 3, planes: frame.planes[..3 * SIZE[0] * SIZE[1]].to_vec(), ..frame.clone() };
    let light = Environment::default();
    assert!(shade(&few, &camera(), &light).is_err());
    assert!(shade(&frame, &Camera::at_origin(3, 3, 1.0), &light).is_err());
    assert!(shade(&frame, &camera(), &Environment { radiance: Vec::new() }).is_err());
    assert!(shade_backward(&frame, &camera(), &light, &[]).is_err());
}
