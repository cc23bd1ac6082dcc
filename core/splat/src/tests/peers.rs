//! The shared 20k scene with its f64 picture and gradients; skipped, and says so, where `../shared` is not at hand.

use crate::{FrameGradient, RasterOptions, RawGaussians, backward, read_ply, render};
use heartian_space::Camera;
use std::path::PathBuf;

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

fn directory() -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/peers/splat");
    path.join("head_20k.ply").exists().then_some(path)
}

fn npy(path: PathBuf) -> Fallible<Vec<f64>> {
    Ok(npyz::NpyFile::new(&std::fs::read(path)?[..])?.into_vec::<f64>()?)
}

#[test]
fn the_shared_scene_matches_its_reference() -> Fallible<()> {
    let Some(directory) = directory() else {
        println!("skipped: ../shared/peers/splat is not here");
        return Ok(());
    };
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(directory.join("camera.json"))?)?;
    let number = |key: &str| json[key].as_f64().unwrap_or(f64::NAN) as f32;
    let w = |r: usize, c: usize| json["w2c"][r][c].as_f64().unwrap_or(f64::NAN) as f32;
    let camera = Camera {
        width: 512,
        height: 512,
        focal_px: [number("fx"), number("fy")],
        principal_px: [number("cx"), number("cy")],
        rotation: [0, 1, 2].map(|c| [0, 1, 2].map(|r| w(r, c))),
        translation: [0, 1, 2].map(|r| w(r, 3)),
    };
    let raw = read_ply(&directory.join("head_20k.ply"))?;
    let activated = raw.activate();
    let scene = raw.view(&activated);
    let options = RasterOptions { near_metres: 0.01, ..RasterOptions::default() };
    let (prepared, frame) = render(&scene, &camera, &options)?;
    let pixels = 512 * 512;
    let reference = npy(directory.join("ref_20k.npy"))?;
    let planar: Vec<f64> = (0..3 * pixels).map(|i| reference[3 * (i % pixels) + i / pixels]).collect();
    let worst = super::scenes::worst(&frame.planes, &planar);
    assert!(worst < 5e-4, "picture: {worst:e}");
    let weights: Vec<f32> = npyz::NpyFile::new(&std::fs::read(directory.join("weights.npy"))?[..])?.into_vec()?;
    let planar: Vec<f32> = (0..3 * pixels).map(|i| weights[3 * (i % pixels) + i / pixels]).collect();
    let mut g = backward(&scene, &prepared, &frame, &FrameGradient { planes: &planar, ..FrameGradient::default() })?;
    RawGaussians::chain(&activated, &mut g);
    let mut archive = npyz::npz::NpzArchive::open(directory.join("ref_grad_20k.npz"))?;
    for (name, own) in [
        ("means", g.means.as_flattened()),
        ("log_scales", g.scales.as_flattened()),
        ("quats", g.rotations.as_flattened()),
        ("logit", &g.opacities[..]),
        ("rgb", &g.features[..]),
    ] {
        let exact: Vec<f64> = archive.by_name(name)?.ok_or("a gradient is missing")?.into_vec()?;
        let off = super::scenes::relative(own, &exact);
        assert!(off < 2e-4, "gradient of {name}: {off:e}");
    }
    Ok(())
}
