//! Every kind of bad or extreme input has a defined answer: no panic, no NaN, nothing spoilt next to it.

use super::scenes::{Owned, camera, noise, options};
use crate::{
    Environment, FrameGradient, Gaussians, MAX_CHANNELS, PhotometricWeights, RasterOptions, SplatError, backward,
    blend_weights, photometric, render, shade, shade_backward, srgb_encode, srgb_encode_backward,
};
use heartian_space::Camera;

/// Renders and differentiates; everything must be finite. Gives the number drawn.
fn run(owned: &Owned, camera: &Camera) -> Result<usize, SplatError> {
    let scene = owned.view();
    let (prepared, frame) = render(&scene, camera, &options(true))?;
    let pixels = camera.width * camera.height;
    let (planes, extra) = (noise(owned.channels * pixels, 1), noise(pixels, 2));
    let gradient = FrameGradient { planes: &planes, depth: &extra, transmittance: &extra };
    let g = backward(&scene, &prepared, &frame, &gradient)?;
    let pictures = frame.planes.iter().chain(&frame.depth).chain(&frame.transmittance);
    assert!(pictures.clone().all(|v| v.is_finite()), "a pixel is not finite");
    assert!(frame.transmittance.iter().all(|t| (0.0..=1.0).contains(t)));
    let all = g.means.as_flattened().iter().chain(g.scales.as_flattened()).chain(g.rotations.as_flattened());
    let all = all
        .chain(&g.opacities)
        .chain(&g.features)
        .chain(g.means_px.as_flattened())
        .chain(&g.weights)
        .chain(&g.radii_px);
    assert!(all.clone().all(|v| v.is_finite()), "a gradient is not finite");
    blend_weights(&prepared, None, 4, None)?;
    Ok(prepared.drawn())
}

/// A healthy scene with one Gaussian in front changed.
fn poisoned(change: impl Fn(&mut Owned)) -> Owned {
    let mut owned = Owned::random(40, 3, 9);
    owned.means[0] = [0.0, 0.0, -0.6];
    owned.opacities[0] = 0.7;
    change(&mut owned);
    owned
}

#[test]
fn each_poison_is_left_out_or_drawn_as_defined() -> Result<(), SplatError> {
    let camera = camera(48, 40);
    let healthy = run(&poisoned(|_| {}), &camera)?;
    let nan = f32::NAN;
    type Change = Box<dyn Fn(&mut Owned)>;
    let left_out: Vec<(&str, Change)> = vec![
        ("NaN mean", Box::new(move |o| o.means[0][1] = nan)),
        ("infinite mean", Box::new(|o| o.means[0][0] = f32::INFINITY)),
        ("NaN scale", Box::new(move |o| o.scales[0][2] = nan)),
        ("infinite scale", Box::new(|o| o.scales[0][2] = f32::INFINITY)),
        ("negative scale", Box::new(|o| o.scales[0][2] = -0.01)),
        ("overflowing scale", Box::new(|o| o.scales[0] = [f32::MAX; 3])),
        ("NaN rotation", Box::new(move |o| o.rotations[0][0] = nan)),
        ("NaN opacity", Box::new(move |o| o.opacities[0] = nan)),
        ("zero opacity", Box::new(|o| o.opacities[0] = 0.0)),
        ("negative opacity", Box::new(|o| o.opacities[0] = -1.0)),
        ("behind the camera", Box::new(|o| o.means[0][2] = 0.5)),
        ("at the camera", Box::new(|o| o.means[0] = [0.0; 3])),
        ("nearer than the near plane", Box::new(|o| o.means[0][2] = -0.04)),
    ];
    for (name, change) in left_out {
        assert_eq!(run(&poisoned(change), &camera)?, healthy - 1, "{name}");
    }
    let drawn: Vec<(&str, Change)> = vec![
        ("opacity 1", Box::new(|o| o.opacities[0] = 1.0)),
        ("opacity above 1", Box::new(|o| o.opacities[0] = 7.0)),
        ("infinite opacity", Box::new(|o| o.opacities[0] = f32::INFINITY)),
        ("zero scale", Box::new(|o| o.scales[0] = [0.0; 3])),
        ("denormal scale", Box::new(|o| o.scales[0] = [1e-42; 3])),
        ("needle", Box::new(|o| o.scales[0] = [0.5, 1e-9, 1e-9])),
        ("pancake", Box::new(|o| o.scales[0] = [0.5, 0.5, 0.0])),
        ("huge", Box::new(|o| o.scales[0] = [1e6; 3])),
        ("zero rotation", Box::new(|o| o.rotations[0] = [0.0; 4])),
        ("tiny rotation", Box::new(|o| o.rotations[0] = [1e-30, 0.0, 1e-30, 0.0])),
        ("large rotation", Box::new(|o| o.rotations[0] = [1e30, -1e30, 1e30, 0.0])),
        ("just past the near plane", Box::new(|o| o.means[0][2] = -0.0501)),
        ("NaN feature", Box::new(move |o| o.features[1] = nan)),
        ("far aside", Box::new(|o| o.means[0] = [1e6, 1e6, -0.6])),
        ("far away", Box::new(|o| o.means[0] = [0.0, 0.0, -1e12])),
    ];
    for (name, change) in drawn {
        assert_eq!(run(&poisoned(change), &camera)?, healthy, "{name}");
    }
    Ok(())
}

#[test]
fn poison_does_not_touch_its_neighbours() -> Result<(), SplatError> {
    let camera = camera(48, 40);
    let mut without = poisoned(|_| {});
    without.opacities[0] = 0.0;
    let clean = render(&without.view(), &camera, &options(true))?.1;
    let spoilt = render(&poisoned(|o| o.scales[0][0] = f32::NAN).view(), &camera, &options(true))?.1;
    assert_eq!(clean, spoilt);
    Ok(())
}

#[test]
fn sizes_at_the_edges_are_defined() -> Result<(), SplatError> {
    let none = Owned { channels: 3, ..Owned::default() };
    assert_eq!(run(&none, &camera(17, 5))?, 0);
    assert!(render(&none.view(), &camera(17, 5), &options(false))?.1.transmittance.iter().all(|t| *t == 1.0));
    let one = Owned {
        means: vec![[0.0, 0.0, -1.0]],
        scales: vec![[0.01; 3]],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]],
        opacities: vec![0.5],
        features: vec![1.0],
        channels: 1,
    };
    for (width, height) in [(1, 1), (1, 70), (70, 1), (2048, 2048)] {
        assert_eq!(run(&one, &Camera::at_origin(width, height, 300.0))?, 1);
    }
    let full = Owned::random(5, MAX_CHANNELS, 1);
    assert!(matches!(render(&full.view(), &camera(8, 8), &options(true)), Err(SplatError::Channels { found: 13, .. })));
    assert!(render(&full.view(), &camera(8, 8), &options(false)).is_ok());
    Ok(())
}

#[test]
fn a_million_on_one_pixel_saturate() -> Result<(), SplatError> {
    let n = 1_000_000;
    let owned = Owned {
        means: (0..n).map(|i| [0.0, 0.0, -1.0 - 1e-6 * (i % 7) as f32]).collect(),
        scales: vec![[1e-4; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacities: vec![0.05; n],
        features: vec![0.5; n],
        channels: 1,
    };
    assert_eq!(run(&owned, &camera(33, 17))?, n);
    Ok(())
}

#[test]
fn more_pairs_than_memory_holds_are_refused() {
    let n = 20_000;
    let owned = Owned {
        means: vec![[0.0, 0.0, -1.0]; n],
        scales: vec![[10.0; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacities: vec![0.05; n],
        features: vec![0.5; n],
        channels: 1,
    };
    let result = render(&owned.view(), &camera(2048, 2048), &options(false));
    assert!(matches!(result, Err(SplatError::Pairs { .. })), "8192 tiles each");
}

#[test]
fn nothing_in_front_of_the_camera_is_an_open_picture_without_gradients() -> Result<(), SplatError> {
    let mut behind = Owned::random(300, 3, 4);
    behind.means.iter_mut().for_each(|m| m[2] = -m[2]);
    let camera = camera(40, 30);
    assert_eq!(run(&behind, &camera)?, 0);
    let (prepared, frame) = render(&behind.view(), &camera, &options(true))?;
    assert!(frame.transmittance.iter().all(|t| *t == 1.0) && frame.planes.iter().all(|v| *v == 0.0));
    let ones = vec![1.0; frame.planes.len()];
    let g = backward(&behind.view(), &prepared, &frame, &FrameGradient { planes: &ones, ..FrameGradient::default() })?;
    assert!(g.means.as_flattened().iter().chain(&g.features).chain(&g.opacities).all(|v| *v == 0.0));
    Ok(())
}

/// Picture, shading, encoding, loss and all the way back, for pictures without alpha, all black and over-bright.
#[test]
fn empty_black_and_saturated_frames_go_there_and_back() -> Result<(), SplatError> {
    let camera = camera(48, 40);
    let pixels = 48 * 40;
    for (albedo, radiance, target) in
        [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1e4, 1.0), (1.0, 1e4, 0.0), (0.5, -3.0, 0.5), (1e6, 1e6, 1.0)]
    {
        for count in [0, 60] {
            let mut owned = Owned::random(count, 8, 6);
            for features in owned.features.chunks_exact_mut(8) {
                features[..3].fill(albedo);
            }
            let light = Environment::uniform([radiance; 3]);
            let (prepared, frame) = render(&owned.view(), &camera, &options(false))?;
            let linear = shade(&frame, &camera, &light)?;
            let image = srgb_encode(&linear);
            let (target, mut on_image) = (vec![target; 3 * pixels], vec![0.0; 3 * pixels]);
            let loss = photometric(&image, &target, [48, 40], PhotometricWeights::default(), &mut on_image)?;
            srgb_encode_backward(&linear, &mut on_image)?;
            let on_frame = shade_backward(&frame, &camera, &light, &on_image)?;
            let gradient =
                FrameGradient { planes: &on_frame.planes, depth: &[], transmittance: &on_frame.transmittance };
            let g = backward(&owned.view(), &prepared, &frame, &gradient)?;
            let all = linear.iter().chain(&image).chain(&on_image).chain(&g.features).chain(&g.opacities);
            let all = all.chain(g.means.as_flattened()).chain(on_frame.radiance.as_flattened());
            assert!(all.clone().all(|v| v.is_finite()), "albedo {albedo}, light {radiance}, {count} Gaussians");
            assert!(loss.total.is_finite() && (count > 0 || linear.iter().all(|v| *v == 0.0)));
        }
    }
    Ok(())
}

#[test]
fn wrong_shapes_and_cameras_are_named() {
    let owned = Owned::random(4, 3, 1);
    let good = owned.view();
    let (camera, options) = (camera(8, 8), RasterOptions::default());
    let short = [0.0; 2];
    let bad = [
        Gaussians { opacities: &short, ..good },
        Gaussians { features: &short, ..good },
        Gaussians { scales: &good.scales[1..], ..good },
        Gaussians { rotations: &good.rotations[1..], ..good },
        Gaussians { channels: 0, ..good },
        Gaussians { channels: 99, ..good },
    ];
    assert!(bad.iter().all(|scene| render(scene, &camera, &options).is_err()));
    for broken in [
        Camera { width: 0, ..camera },
        Camera { height: 1 << 20, ..camera },
        Camera { focal_px: [0.0, 1.0], ..camera },
        Camera { focal_px: [f32::NAN, 1.0], ..camera },
        Camera { translation: [f32::NAN, 0.0, 0.0], ..camera },
    ] {
        assert!(matches!(render(&good, &broken, &options), Err(SplatError::Camera(_))));
    }
    let (prepared, frame) = render(&good, &camera, &options).unwrap_or_else(|e| panic!("{e}"));
    assert!(backward(&good, &prepared, &frame, &FrameGradient::default()).is_err());
    let fewer = Owned::random(3, 3, 1);
    let planes = vec![0.0; frame.planes.len()];
    let gradient = FrameGradient { planes: &planes, ..FrameGradient::default() };
    assert!(backward(&fewer.view(), &prepared, &frame, &gradient).is_err());
    assert!(backward(&good, &prepared, &frame, &FrameGradient { depth: &planes, ..gradient }).is_err());
}
