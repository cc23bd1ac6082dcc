//! Layers whose weights are rearranged when they are packed, against their definitions in f64.

use heartian_ops::{Extent, Volume};

use crate::attention::temporal_difference;
use crate::layer::{Layer, Pool, identity, max_pool};
use crate::nets::{factorizephys, physnet};
use crate::parts::{Affine, Parts};
use crate::{Architecture, Tensor, Weights};

fn numbers(count: usize, seed: f32) -> Vec<f32> {
    (0..count).map(|i| ((i as f32 + 1.0) * (0.37 + seed)).sin()).collect()
}

fn close(got: &[f32], want: &[f64]) {
    assert_eq!(got.len(), want.len());
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        assert!((f64::from(*got) - want).abs() < 2e-5, "{i}: {got} {want}");
    }
}

/// A convolution `outputs × inputs × kt × k × k` of a dense array, zeros outside, term by term.
fn convolved(
    dense: &[f32],
    extent: Extent,
    weights: &[f32],
    [outputs, kt, k]: [usize; 3],
    stride: usize,
    pad: [usize; 2],
) -> Vec<f64> {
    let Extent { frames, channels, height, width } = extent;
    let side = |size: usize| (size + 2 * pad[1] - k) / stride + 1;
    let mut out = Vec::new();
    for (o, t) in (0..outputs * frames).map(|i| (i / frames, i % frames)) {
        for (y, x) in (0..side(height) * side(width)).map(|i| (i / side(width), i % side(width))) {
            let mut sum = 0.0;
            for (c, tap) in (0..channels * kt * k * k).map(|i| (i / (kt * k * k), i % (kt * k * k))) {
                let from = [
                    (t + tap / (k * k)).wrapping_sub(pad[0]),
                    (y * stride + tap / k % k).wrapping_sub(pad[1]),
                    (x * stride + tap % k).wrapping_sub(pad[1]),
                ];
                if from[0] < frames && from[1] < height && from[2] < width {
                    let value = dense[((c * frames + from[0]) * height + from[1]) * width + from[2]];
                    sum += f64::from(weights[(o * channels + c) * kt * k * k + tap]) * f64::from(value);
                }
            }
            out.push(sum);
        }
    }
    out
}

#[test]
fn a_step_of_two_is_a_step_of_one_over_phases() {
    for (height, width) in [(9, 11), (8, 10)] {
        let extent = Extent { frames: 5, channels: 3, height, width };
        let (dense, weights) = (numbers(extent.values(), 0.0), numbers(4 * 3 * 27, 0.1));
        let input = Volume::from_dense(extent, 0, &dense, false).unwrap();
        let kernel = factorizephys::halving(&weights, [3, 4]).unwrap();
        let (kernel, padding) = ((&kernel).into(), [1, 0]);
        let layer = Layer { kernel, padding, activation: identity, pool: Pool::Keep, margin: 0 };
        let got = layer.run(&factorizephys::phases(&input)).unwrap().to_dense();
        close(&got, &convolved(&dense, extent, &weights, [4, 3, 3], 2, [1, 0]));
    }
}

#[test]
fn the_temporal_difference_folds_into_the_centre() {
    let extent = Extent { frames: 4, channels: 2, height: 4, width: 4 };
    let (dense, weights) = (numbers(extent.values(), 0.0), numbers(2 * 2 * 27, 0.2));
    let theta = 0.7f32;
    let whole = convolved(&dense, extent, &weights, [2, 3, 3], 1, [1, 1]);
    let borders: Vec<f32> = weights.chunks(27).map(|k| k[..9].iter().chain(&k[18..]).sum()).collect();
    let pointwise = convolved(&dense, extent, &borders, [2, 1, 1], 1, [0, 0]);
    let want: Vec<f64> = whole.iter().zip(pointwise).map(|(a, b)| a - f64::from(theta) * b).collect();
    let kernel = temporal_difference(Affine { weights, bias: vec![0.0; 2] }, theta).paired(2).unwrap();
    let input = Volume::from_dense(extent, 1, &dense, false).unwrap();
    let kernel = (&kernel).into();
    let layer = Layer { kernel, padding: [1, 1], activation: identity, pool: Pool::Keep, margin: 0 };
    close(&layer.run(&input).unwrap().to_dense(), &want);
}

#[test]
fn a_doubling_scatters_every_frame_over_four() {
    let tensor = |shape: &[usize], values: Vec<f32>| Tensor { shape: shape.to_vec(), data: values };
    let (weights, bias) = (numbers(64 * 64 * 4, 0.3), numbers(64, 0.4));
    let tensors = [
        ("up.0.weight", tensor(&[64, 64, 4, 1, 1], weights.clone())),
        ("up.0.bias", tensor(&[64], bias.clone())),
        ("up.1.weight", tensor(&[64], vec![1.0; 64])),
        ("up.1.bias", tensor(&[64], vec![0.0; 64])),
        ("up.1.running_mean", tensor(&[64], vec![0.0; 64])),
        ("up.1.running_var", tensor(&[64], vec![1.0 - 1e-5; 64])),
    ];
    let weights_of = Weights::from_tensors(tensors.map(|(name, tensor)| (name.to_owned(), tensor))).unwrap();
    let pair = physnet::doubling(&Parts::new(&weights_of, Architecture::PhysNet), "up").unwrap();
    let extent = Extent { frames: 3, channels: 64, height: 1, width: 2 };
    let dense = numbers(extent.values(), 0.5);
    let got = physnet::doubled(&pair, &Volume::from_dense(extent, 0, &dense, false).unwrap()).unwrap().to_dense();
    let mut want: Vec<f64> = bias.iter().flat_map(|b| [f64::from(*b); 12]).collect();
    for (i, k, x) in (0..3 * 4 * 2usize).map(|n| (n / 8, n / 2 % 4, n % 2)) {
        let Some(frame) = (2 * i + k).checked_sub(1).filter(|frame| *frame < 6) else { continue };
        for (input, out) in (0..64 * 64).map(|n| (n / 64, n % 64)) {
            let term = f64::from(weights[(input * 64 + out) * 4 + k]) * f64::from(dense[(input * 3 + i) * 2 + x]);
            want[(out * 6 + frame) * 2 + x] += term;
        }
    }
    let elu: Vec<f64> = want.iter().map(|v| if *v > 0.0 { *v } else { v.exp_m1() }).collect();
    close(&got, &elu);
}

#[test]
fn pooling_drops_what_does_not_fill_a_window() {
    let extent = Extent { frames: 5, channels: 1, height: 3, width: 5 };
    let dense = numbers(extent.values(), 0.6);
    let pooled = max_pool(&Volume::from_dense(extent, 0, &dense, false).unwrap(), 2, 2, 0);
    assert_eq!(pooled.extent(), Extent { frames: 2, channels: 1, height: 1, width: 2 });
    let at = |t: usize, y: usize, x: usize| dense[(t * 3 + y) * 5 + x];
    let most =
        |t: usize, x: usize| (0..8).map(|i| at(t + i / 4, i / 2 % 2, x + i % 2)).fold(f32::NEG_INFINITY, f32::max);
    assert_eq!(pooled.to_dense(), [most(0, 0), most(0, 2), most(2, 0), most(2, 2)]);
}
