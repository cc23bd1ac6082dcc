//! Every instruction set this machine has gives the portable lanes' answer, and the tiled f64 text the plain one's.

use super::scenes::{Owned, camera, noise, options, relative};
use crate::lanes::FORCED;
use crate::reference::{Scene, composite, tiled};
use crate::{FrameGradient, SimdLevel, SplatError, backward, render, simd_level};

/// Arrays by name.
type Named = Vec<(&'static str, Vec<f32>)>;

/// Frame and gradients at a level, on a pool of one thread that is held to it.
fn at_level(level: SimdLevel, owned: &Owned) -> Result<Named, Box<dyn std::error::Error>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let result = pool.install(|| -> Result<_, SplatError> {
        FORCED.set(Some(level));
        let (scene, camera) = (owned.view(), camera(150, 90));
        let (prepared, frame) = render(&scene, &camera, &options(true))?;
        let (planes, one) = (noise(owned.channels * 150 * 90, 3), noise(150 * 90, 4));
        let g =
            backward(&scene, &prepared, &frame, &FrameGradient { planes: &planes, depth: &one, transmittance: &one })?;
        Ok(vec![
            ("planes", frame.planes),
            ("depth", frame.depth),
            ("transmittance", frame.transmittance),
            ("means", g.means.into_flattened()),
            ("scales", g.scales.into_flattened()),
            ("rotations", g.rotations.into_flattened()),
            ("opacities", g.opacities),
            ("features", g.features),
        ])
    });
    Ok(result?)
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|v| f64::from(*v)).collect()
}

/// Relative error in the L2 norm without the hundredth of the values that are farthest apart.
fn bulk_error(got: &[f32], want: &[f32]) -> f64 {
    let mut squares: Vec<f64> = got.iter().zip(want).map(|(a, b)| f64::from(a - b).powi(2)).collect();
    squares.sort_by(f64::total_cmp);
    let norm: f64 = want.iter().map(|v| f64::from(*v).powi(2)).sum();
    (squares[..squares.len() - squares.len() / 100].iter().sum::<f64>() / norm).sqrt()
}

#[test]
fn all_levels_of_this_machine_agree() -> Result<(), Box<dyn std::error::Error>> {
    let owned = Owned::random(600, 8, 21);
    let portable = at_level(SimdLevel::Baseline, &owned)?;
    for level in [SimdLevel::Avx2, SimdLevel::Avx512].into_iter().filter(|level| *level <= simd_level()) {
        for ((name, got), (_, want)) in at_level(level, &owned)?.iter().zip(&portable) {
            let (off, bulk) = (relative(got, &wide(want)), bulk_error(got, want));
            // Fused multiplication moves a few samples across the alpha cut: each is 1/255 of a pixel, which is 3.4e-5 of a
            // plane's norm and more of one Gaussian's gradient. All others agree.
            assert!(bulk < 2e-5 && off < 5e-4, "{level:?} {name}: {bulk:e}, {off:e}");
        }
    }
    Ok(())
}

#[test]
fn the_tiled_reference_is_the_plain_one() {
    let (owned, camera, options) = (Owned::random(150, 3, 5), camera(70, 50), options(true));
    let scene = Scene::new(&owned.view());
    let (plain, fast) = (composite::composite(&scene, &camera, &options), tiled::composite(&scene, &camera, &options));
    assert_eq!((plain.planes, plain.depth, plain.transmittance), (fast.planes, fast.depth, fast.transmittance));
    assert!(plain.pairs > 10_000 && plain.pairs == fast.pairs);
}
