//! The naive text against finite differences, the fast text against the naive one, and sameness at any thread count.

use super::scenes::{Owned, camera, noise, options, relative, worst};
use crate::reference::{Scene, composite as naive};
use crate::{FrameGradient, SceneGradients, SplatError, backward, blend_weights, composite, render};

fn picture_gradient(
    channels: usize,
    pixels: usize,
    seed: u64,
) -> (Vec<f32>, Vec<f32>, Vec<f32>, naive::PictureGradient) {
    let (planes, depth, transmittance) =
        (noise(channels * pixels, seed), noise(pixels, seed + 1), noise(pixels, seed + 2));
    let wide = |v: &[f32]| v.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
    let exact =
        naive::PictureGradient { planes: wide(&planes), depth: wide(&depth), transmittance: wide(&transmittance) };
    (planes, depth, transmittance, exact)
}

/// The naive backward text against central differences of the naive forward text.
#[test]
fn naive_gradients_are_the_derivative_of_the_naive_picture() {
    let owned = Owned::random(14, 2, 5);
    let scene = Scene::new(&owned.view());
    let (camera, options) = (camera(24, 18), options(true));
    let (.., gradient) = picture_gradient(2, 24 * 18, 11);
    let exact = naive::backward(&scene, &camera, &options, &gradient);
    let loss = |s: &Scene| naive::inner_product(&naive::composite(s, &camera, &options), &gradient);
    let mut checked = 0;
    let mut check = |analytic: f64, touch: &dyn Fn(&mut Scene, f64), step: f64| {
        // A step across the 1/255 cut or the early stop shows as two step sizes that disagree: such points are left out.
        let slope = |h: f64| {
            let (mut up, mut down) = (scene.clone(), scene.clone());
            touch(&mut up, h);
            touch(&mut down, -h);
            (loss(&up) - loss(&down)) / (2.0 * h)
        };
        let (fine, coarse) = (slope(step), slope(2.0 * step));
        let scale = analytic.abs().max(1.0);
        if (fine - coarse).abs() < 1e-4 * scale {
            checked += 1;
            assert!((fine - analytic).abs() < 2e-4 * scale, "{analytic} {fine} {coarse}");
        }
    };
    for i in 0..scene.len() {
        for k in 0..3 {
            check(exact.means[i][k], &|s, h| s.means[i][k] += h, 1e-8);
            check(exact.scales[i][k], &|s, h| s.scales[i][k] += h, 1e-8);
        }
        for k in 0..4 {
            check(exact.rotations[i][k], &|s, h| s.rotations[i][k] += h, 1e-7);
        }
        check(exact.opacities[i], &|s, h| s.opacities[i] += h, 1e-7);
        check(exact.features[2 * i], &|s, h| s.features[2 * i] += h, 1e-6);
    }
    assert!(checked > 14 * 12 * 3 / 4, "only {checked} points could be checked");
}

/// Fast against naive, for every channel count, with and without depth, on an uneven picture.
#[test]
fn fast_pictures_and_gradients_are_the_naive_ones() -> Result<(), SplatError> {
    let camera = camera(75, 41);
    let pixels = 75 * 41;
    for channels in 1..=11 {
        let owned = Owned::random(120, channels, 100 + channels as u64);
        let (scene, exact_scene) = (owned.view(), Scene::new(&owned.view()));
        for depth in [false, true] {
            let options = options(depth);
            let (prepared, frame) = render(&scene, &camera, &options)?;
            let (planes, on_depth, on_transmittance, mut exact_gradient) = picture_gradient(channels, pixels, 7);
            if !depth {
                exact_gradient.depth.fill(0.0);
            }
            let picture = naive::composite(&exact_scene, &camera, &options);
            assert!(
                worst(&frame.planes, &picture.planes) < 5e-4,
                "{channels} {}",
                worst(&frame.planes, &picture.planes)
            );
            assert!(worst(&frame.transmittance, &picture.transmittance) < 5e-4);
            assert!(!depth || worst(&frame.depth, &picture.depth) < 5e-4);
            let gradient = FrameGradient {
                planes: &planes,
                depth: if depth { &on_depth } else { &[] },
                transmittance: &on_transmittance,
            };
            let fast = backward(&scene, &prepared, &frame, &gradient)?;
            let exact = naive::backward(&exact_scene, &camera, &options, &exact_gradient);
            compare(&fast, &exact, channels);
        }
    }
    Ok(())
}

fn compare(fast: &SceneGradients, exact: &naive::Gradients, channels: usize) {
    for (name, fast, exact) in [
        ("means", fast.means.as_flattened(), exact.means.as_flattened()),
        ("scales", fast.scales.as_flattened(), exact.scales.as_flattened()),
        ("rotations", fast.rotations.as_flattened(), exact.rotations.as_flattened()),
        ("opacities", &fast.opacities[..], &exact.opacities[..]),
        ("features", &fast.features[..], &exact.features[..]),
        ("means in pixels", fast.means_px.as_flattened(), exact.means_px.as_flattened()),
        ("weights", &fast.weights[..], &exact.weights[..]),
    ] {
        let off = relative(fast, exact);
        assert!(off < 2e-3, "{name}, {channels} channels: {off:e}");
    }
}

#[test]
fn one_thread_and_many_give_the_same_bits() -> Result<(), Box<dyn std::error::Error>> {
    let (owned, camera, options) = (Owned::random(900, 9, 3), camera(200, 120), options(true));
    let gradient = noise(9 * 200 * 120, 1);
    let mut results = Vec::new();
    for threads in [1, 2, 3, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        results.push(pool.install(|| -> Result<_, SplatError> {
            let scene = owned.view();
            let (prepared, frame) = render(&scene, &camera, &options)?;
            let gradients =
                backward(&scene, &prepared, &frame, &FrameGradient { planes: &gradient, ..FrameGradient::default() })?;
            Ok((blend_weights(&prepared, None, 8, None)?, frame, gradients))
        })?);
    }
    assert!(results.windows(2).all(|pair| pair[0] == pair[1]));
    Ok(())
}

/// The sparse operator times the features is the pooled picture.
#[test]
fn blend_weights_reproduce_the_pooled_picture() -> Result<(), SplatError> {
    let (owned, camera, [width, height]) = (Owned::random(300, 1, 8), camera(70, 45), [70, 45]);
    let (prepared, frame) = render(&owned.view(), &camera, &options(false))?;
    let factor: Vec<f32> = noise(width * height, 4);
    for cell in [1, 3, 8, 50, 200] {
        let csr = blend_weights(&prepared, None, cell, Some(&factor))?;
        let columns = width.div_ceil(cell);
        assert_eq!(csr.rows(), columns * height.div_ceil(cell));
        let mut pooled = vec![0.0f64; csr.rows()];
        for (at, value) in frame.planes.iter().enumerate() {
            pooled[at / width / cell * columns + at % width / cell] += f64::from(value * factor[at]);
        }
        for (row, want) in pooled.iter().enumerate() {
            let got: f64 = csr.row(row).map(|(g, w)| f64::from(w * owned.features[g as usize])).sum();
            assert!((got - want).abs() < 1e-5 * (cell * cell) as f64, "cell {cell} row {row}: {got} {want}");
            assert!(csr.row(row).zip(csr.row(row).skip(1)).all(|(a, b)| a.0 < b.0));
        }
    }
    let some: Vec<bool> = (0..300).map(|i| i % 3 == 0).collect();
    let (all, part) = (blend_weights(&prepared, None, 4, None)?, blend_weights(&prepared, Some(&some), 4, None)?);
    for row in 0..all.rows() {
        assert!(all.row(row).filter(|(g, _)| some[*g as usize]).eq(part.row(row)));
    }
    assert!(
        blend_weights(&prepared, Some(&[true]), 4, None).is_err() && blend_weights(&prepared, None, 0, None).is_err()
    );
    Ok(())
}

/// Metamorphic: what is hidden behind an opaque wall changes nothing; features enter linearly.
#[test]
fn hidden_gaussians_change_nothing_and_features_are_linear() -> Result<(), SplatError> {
    let (camera, options) = (camera(64, 48), options(false));
    let mut owned = Owned { channels: 1, ..Owned::default() };
    for depth in [0.8f32, 0.81, 0.82] {
        owned.means.push([0.0, 0.0, -depth]);
        owned.scales.push([4.0, 4.0, 0.01]);
        owned.rotations.push([1.0, 0.0, 0.0, 0.0]);
        owned.opacities.push(1.0);
        owned.features.push(depth);
    }
    let wall = render(&owned.view(), &camera, &options)?.1;
    let mut more = owned.clone();
    let hidden = Owned::random(50, 1, 2);
    more.means.extend(hidden.means.iter().map(|m| [m[0], m[1], m[2] - 1.0]));
    more.scales.extend(&hidden.scales);
    more.rotations.extend(&hidden.rotations);
    more.opacities.extend(&hidden.opacities);
    more.features.extend(&hidden.features);
    let both = render(&more.view(), &camera, &options)?.1;
    assert!(wall.planes.iter().zip(&both.planes).all(|(a, b)| (a - b).abs() < 2e-4));
    let mut doubled = hidden.clone();
    doubled.features.iter_mut().for_each(|f| *f *= 2.0);
    let (one, two) =
        (composite(&crate::prepare(&hidden.view(), &camera, &options)?), render(&doubled.view(), &camera, &options)?.1);
    assert!(one.planes.iter().zip(&two.planes).all(|(a, b)| (2.0 * a - b).abs() < 1e-6));
    Ok(())
}
