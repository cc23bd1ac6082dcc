//! A whole step against the CPU's functions one after another: losses, and gradients within 1e-4 relative L2.

use super::device;
use super::present::materials;
use crate::gpu::fit::GpuFitter;
use crate::tests::scenes::{Owned, camera, noise, relative};
use crate::{
    Environment, FitStep, FitTarget, FrameGradient, PhotometricWeights, SplatError, backward, mask_loss, photometric,
    render, shade, shade_backward, srgb_encode, srgb_encode_backward,
};
use heartian_space::Camera;

/// A step on the CPU, but for the squared error.
fn on_cpu(
    owned: &Owned,
    camera: &Camera,
    light: Option<&Environment>,
    target: &FitTarget<'_>,
) -> Result<FitStep, SplatError> {
    let (scene, size) = (owned.view(), [camera.width, camera.height]);
    let (prepared, frame) = render(&scene, camera, &crate::RasterOptions::default())?;
    let linear = match light {
        Some(light) => shade(&frame, camera, light)?,
        None => frame.planes.clone(),
    };
    let encoded = srgb_encode(&linear);
    let mut on_image = vec![0.0; encoded.len()];
    let photometric = photometric(&encoded, target.rgb, size, target.weights, &mut on_image)?;
    srgb_encode_backward(&linear, &mut on_image)?;
    let (planes, mut on_transmittance, radiance) = match light {
        Some(light) => {
            let back = shade_backward(&frame, camera, light, &on_image)?;
            (back.planes, back.transmittance, back.radiance)
        }
        None => (on_image, vec![0.0; frame.transmittance.len()], Vec::new()),
    };
    let mask = mask_loss(&frame.transmittance, target.alpha, target.mask_weight, &mut on_transmittance)?;
    let gradient = FrameGradient { planes: &planes, depth: &[], transmittance: &on_transmittance };
    let gradients = backward(&scene, &prepared, &frame, &gradient)?;
    Ok(FitStep { photometric, mask, gradients, radiance, ..FitStep::default() })
}

#[test]
fn steps_with_and_without_a_light_are_those_of_the_cpu() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let mut fitter = GpuFitter::new(gpu)?;
    let warm = Environment::warm();
    for (size, light) in [([61, 37], Some(&warm)), ([48, 30], None), ([16, 16], Some(&warm))] {
        let (camera, pixels) = (camera(size[0], size[1]), size[0] * size[1]);
        let owned = if light.is_some() { materials(150, 3) } else { Owned::random(150, 3, 4) };
        let rgb: Vec<f32> = noise(3 * pixels, 5).iter().map(|v| v.abs()).collect();
        let alpha: Vec<f32> = noise(pixels, 6).iter().map(|v| v.abs()).collect();
        let weights = PhotometricWeights::default();
        let target = FitTarget { rgb: &rgb, alpha: &alpha, weights, mask_weight: 0.2 };
        let made = on_cpu(&owned, &camera, light, &target)?;
        let exact = &made.gradients;
        let step = fitter.step(&owned.view(), &camera, light, &target)?;
        let losses = |step: &FitStep| [step.photometric.l1, step.photometric.ssim, step.photometric.total, step.mask];
        for (a, b) in losses(&step).into_iter().zip(losses(&made)) {
            assert!((a - b).abs() < 1e-5, "{size:?}: {a} {b}");
        }
        for (group, a, b) in [
            ("means", step.gradients.means.as_flattened(), exact.means.as_flattened()),
            ("scales", step.gradients.scales.as_flattened(), exact.scales.as_flattened()),
            ("rotations", step.gradients.rotations.as_flattened(), exact.rotations.as_flattened()),
            ("opacities", &step.gradients.opacities[..], &exact.opacities[..]),
            ("features", &step.gradients.features[..], &exact.features[..]),
            ("light", step.radiance.as_flattened(), made.radiance.as_flattened()),
        ] {
            let exact: Vec<f64> = b.iter().map(|v| f64::from(*v)).collect();
            let off = relative(a, &exact);
            assert!(off < 1e-4, "{size:?}: gradients of {group} differ by {off:e}");
        }
        let again = fitter.step(&owned.view(), &camera, light, &target)?;
        assert_eq!((again.gradients, again.radiance), (step.gradients, step.radiance));
    }
    let (camera, none) = (camera(8, 8), [0.0; 64 * 3]);
    let target = FitTarget { rgb: &none, alpha: &none[..64], weights: PhotometricWeights::default(), mask_weight: 0.0 };
    assert!(fitter.step(&Owned::random(5, 3, 1).view(), &camera, Some(&warm), &target).is_err());
    assert!(fitter.step(&Owned::random(5, 3, 1).view(), &camera, None, &FitTarget { rgb: &[], ..target }).is_err());
    Ok(())
}
