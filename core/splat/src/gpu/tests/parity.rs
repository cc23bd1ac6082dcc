//! Pictures within 1e-4 and gradients within 1e-4 relative L2 of the CPU's, over scenes of all kinds.

use super::device;
use crate::gpu::raster::GpuRasteriser;
use crate::tests::scenes::{Owned, camera, noise, options, relative, worst};
use crate::{Frame, FrameGradient, Gaussians, MAX_CHANNELS, SceneGradients, SplatError, backward, render};
use heartian_space::Camera;

const PICTURE: f64 = 1e-4;
const GRADIENT: f64 = 1e-4;

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|v| f64::from(*v)).collect()
}

fn compare_frames(name: &str, fast: &Frame, exact: &Frame) {
    assert_eq!((fast.width, fast.height, fast.channels), (exact.width, exact.height, exact.channels), "{name}");
    for (plane, a, b) in [
        ("features", &fast.planes, &exact.planes),
        ("depth", &fast.depth, &exact.depth),
        ("transmittance", &fast.transmittance, &exact.transmittance),
    ] {
        let off = worst(a, &wide(b));
        assert!(off < PICTURE, "{name}: {plane} differ by {off:e}");
    }
}

fn compare_gradients(name: &str, fast: &SceneGradients, exact: &SceneGradients) {
    for (group, a, b) in [
        ("means", fast.means.as_flattened(), exact.means.as_flattened()),
        ("scales", fast.scales.as_flattened(), exact.scales.as_flattened()),
        ("rotations", fast.rotations.as_flattened(), exact.rotations.as_flattened()),
        ("opacities", &fast.opacities[..], &exact.opacities[..]),
        ("features", &fast.features[..], &exact.features[..]),
        ("means in pixels", fast.means_px.as_flattened(), exact.means_px.as_flattened()),
        ("weights", &fast.weights[..], &exact.weights[..]),
        ("radii", &fast.radii_px[..], &exact.radii_px[..]),
    ] {
        assert!(a.iter().all(|v| v.is_finite()), "{name}: {group} are not finite");
        let off = relative(a, &wide(b));
        assert!(off < GRADIENT, "{name}: gradients of {group} differ by {off:e}");
    }
}

/// Both devices on one scene; gives what the GPU made.
fn both(
    name: &str,
    raster: &mut GpuRasteriser,
    scene: &Gaussians,
    camera: &Camera,
    depth: bool,
) -> Result<(Frame, SceneGradients), SplatError> {
    let (options, pixels) = (options(depth), camera.width * camera.height);
    let (prepared, frame) = render(scene, camera, &options)?;
    let (planes, extra) = (noise(scene.channels * pixels, 1), noise(pixels, 2));
    let gradient = FrameGradient { planes: &planes, depth: if depth { &extra } else { &[] }, transmittance: &extra };
    let exact = backward(scene, &prepared, &frame, &gradient)?;
    let fast_frame = raster.render(scene, camera, &options)?;
    compare_frames(name, &fast_frame, &frame);
    let fast = raster.backward(&gradient)?;
    compare_gradients(name, &fast, &exact);
    Ok((fast_frame, fast))
}

#[test]
fn scenes_of_all_channels_and_sizes_are_those_of_the_cpu() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let mut raster = GpuRasteriser::new(gpu);
    for (width, height) in [(64, 48), (75, 41), (1, 1), (1, 70), (70, 1), (17, 16)] {
        let owned = Owned::random(150, 3, width as u64);
        both(&format!("{width}×{height}"), &mut raster, &owned.view(), &camera(width, height), true)?;
    }
    for channels in [1, 2, 4, 7, 8, 11, MAX_CHANNELS] {
        let owned = Owned::random(120, channels, 50 + channels as u64);
        let depth = channels < MAX_CHANNELS && channels % 2 == 1;
        both(&format!("{channels} channels"), &mut raster, &owned.view(), &camera(40, 33), depth)?;
    }
    Ok(())
}

#[test]
fn needles_pancakes_ends_of_opacity_and_nothing_at_all_are_those_of_the_cpu() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let mut raster = GpuRasteriser::new(gpu);
    let camera = camera(61, 47);
    type Change = fn(usize, &mut Owned);
    let scenes: [(&str, usize, Change); 9] = [
        ("needles", 60, |i, o| o.scales[i] = [0.15, 1e-9, 1e-9]),
        ("pancakes", 60, |i, o| o.scales[i][2] = 0.0),
        ("points", 60, |i, o| o.scales[i] = [0.0; 3]),
        ("behind the camera", 60, |i, o| o.means[i][2] = 0.3),
        ("opaque", 60, |i, o| o.opacities[i] = if i % 3 == 0 { 7.0 } else { 1.0 }),
        ("transparent", 60, |i, o| o.opacities[i] = if i % 2 == 0 { 0.0 } else { 0.5 }),
        ("one depth", 60, |i, o| o.means[i][2] = -1.0),
        ("one", 1, |i, o| o.means[i] = [0.0, 0.0, -1.0]),
        ("none", 0, |_, _| ()),
    ];
    for (name, count, change) in scenes {
        let mut owned = Owned::random(count, 3, 77);
        (0..count).for_each(|i| change(i, &mut owned));
        both(name, &mut raster, &owned.view(), &camera, true)?;
    }
    Ok(())
}

#[test]
fn poison_is_left_out_as_on_the_cpu() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let mut raster = GpuRasteriser::new(gpu);
    let (camera, nan) = (camera(48, 40), f32::NAN);
    type Change = Box<dyn Fn(&mut Owned)>;
    let poisons: Vec<(&str, Change)> = vec![
        ("NaN mean", Box::new(move |o| o.means[0][1] = nan)),
        ("infinite mean", Box::new(|o| o.means[0][0] = f32::INFINITY)),
        ("NaN scale", Box::new(move |o| o.scales[0][2] = nan)),
        ("negative scale", Box::new(|o| o.scales[0][2] = -0.01)),
        ("overflowing scale", Box::new(|o| o.scales[0] = [f32::MAX; 3])),
        ("NaN rotation", Box::new(move |o| o.rotations[0][0] = nan)),
        ("zero rotation", Box::new(|o| o.rotations[0] = [0.0; 4])),
        ("tiny rotation", Box::new(|o| o.rotations[0] = [1e-30, 0.0, 1e-30, 0.0])),
        ("large rotation", Box::new(|o| o.rotations[0] = [1e30, -1e30, 1e30, 0.0])),
        ("NaN opacity", Box::new(move |o| o.opacities[0] = nan)),
        ("infinite opacity", Box::new(|o| o.opacities[0] = f32::INFINITY)),
        ("negative opacity", Box::new(|o| o.opacities[0] = -1.0)),
        ("at the camera", Box::new(|o| o.means[0] = [0.0; 3])),
        ("just past the near plane", Box::new(|o| o.means[0][2] = -0.0501)),
        ("NaN feature", Box::new(move |o| o.features[1] = nan)),
        ("denormal scale", Box::new(|o| o.scales[0] = [1e-42; 3])),
        ("far aside", Box::new(|o| o.means[0] = [1e6, 1e6, -0.6])),
        ("far away", Box::new(|o| o.means[0] = [0.0, 0.0, -1e12])),
    ];
    for (name, change) in poisons {
        let mut owned = Owned::random(40, 3, 9);
        owned.means[0] = [0.0, 0.0, -0.6];
        owned.opacities[0] = 0.7;
        change(&mut owned);
        // With depth one at 10¹² m would drown all else in the comparison.
        both(name, &mut raster, &owned.view(), &camera, false)?;
    }
    Ok(())
}

#[test]
fn a_scene_gives_the_same_bits_again_also_in_used_buffers() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let (owned, camera) = (Owned::random(700, 9, 3), camera(120, 70));
    let mut raster = GpuRasteriser::new(gpu);
    let first = both("first", &mut raster, &owned.view(), &camera, true)?;
    let other = Owned::random(90, 3, 4);
    both("between", &mut raster, &other.view(), &Camera::at_origin(33, 90, 100.0), false)?;
    assert_eq!(both("again", &mut raster, &owned.view(), &camera, true)?, first);
    assert_eq!(both("anew", &mut GpuRasteriser::new(gpu), &owned.view(), &camera, true)?, first);
    assert!(raster.resident_seconds(2, true)? > 0.0 && GpuRasteriser::new(gpu).resident_seconds(1, false).is_err());
    Ok(())
}

#[test]
fn more_entries_than_there_is_room_for_are_given_room() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    // Every one of them covers all 96 tiles: past the room that is made at first.
    let mut owned = Owned::random(900, 1, 5);
    owned.scales.fill([3.0, 2.0, 1.0]);
    owned.opacities.fill(0.02);
    both("wide", &mut GpuRasteriser::new(gpu), &owned.view(), &camera(192, 128), false)?;
    Ok(())
}

#[test]
fn what_does_not_fit_is_an_error_that_says_what_to_do() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let mut raster = GpuRasteriser::new(gpu);
    let one = Owned::random(1, MAX_CHANNELS, 1);
    assert!(raster.backward(&FrameGradient::default()).is_err_and(|e| e.to_string().contains("render first")));
    let huge = Camera::at_origin(32_768, 32_768, 1000.0);
    let refused = raster.render(&one.view(), &huge, &options(false));
    assert!(refused.is_err_and(|e| e.to_string().contains("--device cpu")));
    // And the device still works.
    both("after", &mut raster, &one.view(), &camera(20, 20), false)?;
    let mut wrong = vec![0.0; 3];
    wrong.clear();
    assert!(raster.backward(&FrameGradient { planes: &wrong, ..FrameGradient::default() }).is_err());
    Ok(())
}
