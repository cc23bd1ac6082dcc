//! Image losses against their f64 definitions and finite differences of those.

use super::scenes::Random;
use crate::reference::loss as naive;
use crate::{PhotometricWeights, SplatError, mask_loss, photometric, psnr, ssim};

fn pictures(planes: usize, size: [usize; 2], seed: u64) -> (Vec<f32>, Vec<f32>) {
    let mut r = Random::new(seed);
    let n = planes * size[0] * size[1];
    let a: Vec<f32> = (0..n).map(|i| 0.5 + 0.4 * (i as f32 * 0.05).sin() * r.unit()).collect();
    let b = a.iter().map(|v| (v + r.within(-0.2, 0.2)).clamp(0.0, 1.0)).collect();
    (a, b)
}

fn wide(v: &[f32]) -> Vec<f64> {
    v.iter().map(|&x| f64::from(x)).collect()
}

#[test]
fn measures_are_their_definitions() -> Result<(), SplatError> {
    for (planes, size) in [(3, [40, 27]), (1, [1, 1]), (2, [5, 70]), (3, [70, 3])] {
        let (a, b) = pictures(planes, size, 3);
        let exact = naive::ssim(&wide(&a), &wide(&b), size);
        assert!((ssim(&a, &b, size[0], size[1])? - exact).abs() < 2e-6, "{size:?}");
        assert!((ssim(&a, &a, size[0], size[1])? - 1.0).abs() < 1e-6);
        assert!((psnr(&a, &b)? - naive::psnr(&wide(&a), &wide(&b))).abs() < 1e-6);
        assert_eq!(psnr(&a, &a)?, f64::INFINITY);
    }
    assert!(ssim(&[], &[], 0, 0).is_err() && psnr(&[], &[]).is_err() && ssim(&[0.0; 3], &[0.0; 3], 2, 1).is_err());
    Ok(())
}

#[test]
fn photometric_gradients_are_the_derivative_of_the_definition() -> Result<(), SplatError> {
    let size = [23, 37];
    let (a, b) = pictures(3, size, 6);
    let mut gradient = vec![0.25f32; a.len()];
    let weights = PhotometricWeights { l1: 0.8, dssim: 0.2 };
    let loss = photometric(&a, &b, size, weights, &mut gradient)?;
    let exact =
        |a: &[f64]| 0.8 * naive::mean_absolute_error(a, &wide(&b)) + 0.2 * (1.0 - naive::ssim(a, &wide(&b), size));
    assert!((loss.total - exact(&wide(&a))).abs() < 1e-6);
    let mut r = Random::new(8);
    for _ in 0..30 {
        let i = (r.unit() * a.len() as f32) as usize;
        let (mut up, mut down) = (wide(&a), wide(&a));
        let h = 1e-6;
        (up[i], down[i]) = (up[i] + h, down[i] - h);
        let slope = (exact(&up) - exact(&down)) / (2.0 * h);
        let own = f64::from(gradient[i]) - 0.25;
        assert!((own - slope).abs() < 2e-3 * slope.abs().max(1e-4), "{own} {slope}");
    }
    assert!(photometric(&a, &b[1..], size, weights, &mut gradient).is_err());
    assert!(photometric(&a, &b, [22, 37], weights, &mut gradient).is_err());
    Ok(())
}

#[test]
fn mask_gradient_is_that_of_a_square() -> Result<(), SplatError> {
    let (t, m) = (vec![0.2f32, 0.9, 0.5], vec![1.0f32, 0.0, 0.5]);
    let mut gradient = vec![0.0; 3];
    let value = mask_loss(&t, &m, 3.0, &mut gradient)?;
    assert!((value - (0.04 + 0.01) / 3.0).abs() < 1e-7);
    // d/dt of 3·mean((1 − t − m)²) = −2·(1 − t − m)
    for (g, want) in gradient.iter().zip([0.4, -0.2, 0.0]) {
        assert!((g - want).abs() < 1e-6);
    }
    Ok(())
}
