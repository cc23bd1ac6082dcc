//! Frames as the clip stores them: shading within 1e-4 of the CPU's, codes within one of its, in order, two in flight.

use super::device;
use crate::gpu::present::GpuPresenter;
use crate::tests::scenes::{Owned, camera, worst};
use crate::{Environment, Frame, RasterOptions, SplatError, render, shade, srgb_encode};
use heartian_space::{Camera, color};

/// Materials as an avatar has them: unit normals, roughness and reflectance in their ranges.
pub(super) fn materials(count: usize, seed: u64) -> Owned {
    let mut owned = Owned::random(count, 8, seed);
    for row in owned.features.chunks_exact_mut(8) {
        let normal = [row[3] - 0.5, row[4] - 0.5, row[5] + 0.2];
        let length = normal.iter().map(|n| n * n).sum::<f32>().sqrt();
        row[3..6].copy_from_slice(&normal.map(|n| n / length));
        row[7] = 0.02 + 0.13 * row[7];
    }
    owned
}

fn straight(frame: &Frame, encoded: &[f32]) -> Vec<u8> {
    let pixels = frame.width * frame.height;
    let code = |i: usize| {
        let matte = color::quantise(1.0 - frame.transmittance[i]);
        let unit = f32::from(matte) / 255.0;
        let colors = [0, 1, 2].map(|c| if matte > 0 { color::quantise(encoded[c * pixels + i] / unit) } else { 0 });
        [colors[0], colors[1], colors[2], matte]
    };
    (0..pixels).flat_map(code).collect()
}

fn on_cpu(owned: &Owned, camera: &Camera, light: &Environment) -> Result<(Vec<f32>, Vec<u8>), SplatError> {
    let frame = render(&owned.view(), camera, &RasterOptions::default())?.1;
    let linear = shade(&frame, camera, light)?;
    let codes = straight(&frame, &srgb_encode(&linear));
    Ok((linear, codes))
}

#[test]
fn shaded_pictures_are_those_of_the_cpu() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let mut presenter = GpuPresenter::new(gpu)?;
    for (size, light) in [([61, 37], Environment::warm()), ([16, 48], Environment::cool())] {
        let (owned, camera) = (materials(160, size[0] as u64), camera(size[0], size[1]));
        let (linear, _) = on_cpu(&owned, &camera, &light)?;
        let exact: Vec<f64> = linear.iter().map(|v| f64::from(*v)).collect();
        let off = worst(&presenter.shaded(&owned.view(), &camera, &light)?, &exact);
        assert!(off < 1e-4, "{size:?}: {off:e}");
    }
    Ok(())
}

#[test]
fn frames_in_flight_come_back_in_order_and_whole() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let (camera, light) = (camera(40, 30), Environment::warm());
    let mut presenter = GpuPresenter::new(gpu)?;
    assert!(presenter.collect().is_err());
    // The third has more entries than there is room for at first, so that it and what follows must be sent again.
    let mut scenes: Vec<Owned> = (0..5).map(|i| materials(90, i)).collect();
    scenes[2] = materials(12_000, 9);
    scenes[2].scales.fill([2.0, 1.5, 1.0]);
    scenes[2].opacities.fill(0.05);
    let (mut sent, mut frames) = (0, Vec::new());
    while frames.len() < scenes.len() {
        while sent < scenes.len() && presenter.in_flight() < GpuPresenter::AHEAD {
            presenter.submit(&scenes[sent].view(), &camera, &light)?;
            sent += 1;
        }
        match presenter.collect()? {
            Some(frame) => frames.push(frame),
            None => sent = frames.len(),
        }
    }
    for (index, (frame, scene)) in frames.iter().zip(&scenes).enumerate() {
        let (_, exact) = on_cpu(scene, &camera, &light)?;
        assert_eq!(frame.len(), exact.len());
        // The straight colour of a nearly empty pixel is a quotient of small numbers: it may be off by more than one code.
        let solid = frame.chunks_exact(4).zip(exact.chunks_exact(4)).filter(|(_, b)| b[3] > 32);
        let off = solid.flat_map(|(a, b)| a.iter().zip(b)).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(off.is_some_and(|off| off <= 1), "frame {index}: {off:?}");
    }
    Ok(())
}
