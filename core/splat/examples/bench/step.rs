//! One fitting step of a shaded avatar's size, part by part: 15,000 Gaussians with the deferred channels at 256².

use super::timed;
use crate::peers::Fallible;
use heartian_space::Camera;
use heartian_splat::{
    Adam, AdamOptions, DEFERRED_CHANNELS, Environment, FrameGradient, Gaussians, PhotometricWeights, RasterOptions,
    RawGaussians, backward, photometric, render, shade, shade_backward, srgb_encode, srgb_encode_backward,
};

/// Gaussians of the step, or as many as the scene has.
const GAUSSIANS: usize = 15_000;
/// Parameters of a Gaussian that the optimiser moves.
const PARAMETERS: usize = 80;

/// Times the parts of a step and the whole.
pub fn time(raw: &RawGaussians, camera: &Camera, runs: usize) -> Fallible<()> {
    let activated = raw.activate();
    let all = raw.view(&activated);
    let n = GAUSSIANS.min(all.len());
    let features: Vec<f32> = (0..n)
        .flat_map(|i| {
            let [r, g, b] = raw.colors[i];
            let m = raw.means[i];
            let norm = m.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-6);
            [r, g, b, m[0] / norm, m[1] / norm, m[2] / norm, 0.6, 0.04]
        })
        .collect();
    let scene = Gaussians {
        means: &all.means[..n],
        scales: &all.scales[..n],
        rotations: &all.rotations[..n],
        opacities: &all.opacities[..n],
        features: &features,
        channels: DEFERRED_CHANNELS,
    };
    let (options, light, size) = (RasterOptions::default(), Environment::warm(), [camera.width, camera.height]);
    let (prepared, frame) = render(&scene, camera, &options)?;
    let linear = shade(&frame, camera, &light)?;
    let image = srgb_encode(&linear);
    let target = vec![0.4; image.len()];
    let mut on_image = vec![0.0; image.len()];
    photometric(&image, &target, size, PhotometricWeights::default(), &mut on_image)?;
    let on_frame = shade_backward(&frame, camera, &light, &on_image)?;
    let upstream = FrameGradient { planes: &on_frame.planes, depth: &[], transmittance: &on_frame.transmittance };

    println!("a step of {n} Gaussians, {DEFERRED_CHANNELS} channels, {}×{}:", size[0], size[1]);
    timed("  render", runs, || drop(render(&scene, camera, &options)));
    timed("  shade", runs, || drop(shade(&frame, camera, &light)));
    timed("  encode", runs, || drop(srgb_encode(&linear)));
    timed("  loss", runs, || {
        drop(photometric(&image, &target, size, PhotometricWeights::default(), &mut on_image.clone()))
    });
    timed("  encode backward", runs, || drop(srgb_encode_backward(&linear, &mut on_image.clone())));
    timed("  shade backward", runs, || drop(shade_backward(&frame, camera, &light, &on_image)));
    timed("  backward", runs, || drop(backward(&scene, &prepared, &frame, &upstream)));
    let mut adam = Adam::new(n * PARAMETERS, AdamOptions::default());
    let (mut parameters, gradients) = (vec![0.5; n * PARAMETERS], vec![0.1; n * PARAMETERS]);
    timed("  Adam, 80 each", runs, || drop(adam.step(&mut parameters, &gradients, 1e-4)));
    timed("  render to gradient", runs, || {
        let step = || -> Result<(), heartian_splat::SplatError> {
            let (prepared, frame) = render(&scene, camera, &options)?;
            let linear = shade(&frame, camera, &light)?;
            let image = srgb_encode(&linear);
            let mut gradient = vec![0.0; image.len()];
            photometric(&image, &target, size, PhotometricWeights::default(), &mut gradient)?;
            srgb_encode_backward(&linear, &mut gradient)?;
            let on_frame = shade_backward(&frame, camera, &light, &gradient)?;
            let upstream =
                FrameGradient { planes: &on_frame.planes, depth: &[], transmittance: &on_frame.transmittance };
            backward(&scene, &prepared, &frame, &upstream).map(drop)
        };
        drop(step());
    });
    Ok(())
}
