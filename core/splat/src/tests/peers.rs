//! The shared 20k scene with its f64 picture and gradients; skipped, and says so, where `../shared` is not at hand.

#[path = "../../examples/bench/peers.rs"]
mod files;

use crate::{FrameGradient, RasterOptions, RawGaussians, backward, read_ply, render};
use files::{Fallible, planar, read_camera, read_npy, read_npz};
use std::path::PathBuf;

fn directory() -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/peers/splat");
    path.join("head_20k.ply").exists().then_some(path)
}

#[test]
fn the_shared_scene_matches_its_reference() -> Fallible<()> {
    let Some(directory) = directory() else {
        println!("skipped: ../shared/peers/splat is not here");
        return Ok(());
    };
    let camera = read_camera(&directory.join("camera.json"))?;
    let raw = read_ply(&directory.join("head_20k.ply"))?;
    let activated = raw.activate();
    let scene = raw.view(&activated);
    let options = RasterOptions { near_metres: 0.01, ..RasterOptions::default() };
    let (prepared, frame) = render(&scene, &camera, &options)?;
    let planar_file =
        |name: &str| -> Fallible<Vec<f64>> { Ok(planar(&read_npy(&std::fs::read(directory.join(name))?)?, 3)) };
    let reference = planar_file("ref_20k.npy")?;
    let worst = super::scenes::worst(&frame.planes, &reference);
    assert!(worst < 5e-4, "picture: {worst:e}");
    let weights: Vec<f32> = planar_file("weights.npy")?.iter().map(|&w| w as f32).collect();
    let mut g = backward(&scene, &prepared, &frame, &FrameGradient { planes: &weights, ..FrameGradient::default() })?;
    RawGaussians::chain(&activated, &mut g);
    let archive = std::fs::read(directory.join("ref_grad_20k.npz"))?;
    for (name, own) in [
        ("means", g.means.as_flattened()),
        ("log_scales", g.scales.as_flattened()),
        ("quats", g.rotations.as_flattened()),
        ("logit", &g.opacities[..]),
        ("rgb", &g.features[..]),
    ] {
        let exact = read_npz(&archive, name)?;
        let off = super::scenes::relative(own, &exact);
        assert!(off < 2e-4, "gradient of {name}: {off:e}");
    }
    Ok(())
}
