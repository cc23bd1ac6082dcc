//! Element-wise functions, in place, branch-free over lanes.

use crate::dispatch;
use crate::simd::mul_add;

/// `e^x`: relative error below 2e-7 on [−87, 88], 0 below, +∞ clamped to e^88 above.
#[inline(always)]
pub fn exp<const FMA: bool, const L: usize>(x: [f32; L]) -> [f32; L] {
    let mut out = [0.0; L];
    for lane in 0..L {
        let clamped = x[lane].clamp(-87.336, 88.0);
        let n = mul_add::<FMA>(clamped, std::f32::consts::LOG2_E, 12_582_912.0) - 12_582_912.0;
        let r = mul_add::<FMA>(n, 2.121_944_4e-4, mul_add::<FMA>(n, -0.693_359_4, clamped));
        let mut p = 1.987_569_1e-4;
        for c in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5] {
            p = mul_add::<FMA>(p, r, c);
        }
        p = mul_add::<FMA>(p, r * r, r + 1.0);
        // The clamp keeps n in [-126, 127], so the exponent field never overflows.
        out[lane] = p * f32::from_bits((((n as i32) + 127) << 23) as u32);
    }
    out
}

/// Applies a lane function to a slice; the tail runs through a padded block.
#[inline(always)]
fn map_lanes<const L: usize>(values: &mut [f32], f: impl Fn([f32; L]) -> [f32; L]) {
    let (blocks, tail) = values.as_chunks_mut::<L>();
    for block in blocks {
        *block = f(*block);
    }
    if !tail.is_empty() {
        let mut padded = [0.0; L];
        padded[..tail.len()].copy_from_slice(tail);
        tail.copy_from_slice(&f(padded)[..tail.len()]);
    }
}

#[inline(always)]
fn logistic_kernel<const FMA: bool, const L: usize>(values: &mut [f32]) {
    map_lanes::<L>(values, |x| exp::<FMA, L>(x.map(|v| -v)).map(|e| 1.0 / (1.0 + e)));
}

dispatch!(
    /// `1 / (1 + e^−x)` in place.
    pub fn logistic(values: &mut [f32]) = logistic_kernel
);

/// tanh by a rational function of odd degree 13 over even degree 6 on |x| ≤ 7.9, where f32's tanh is 1.
#[inline(always)]
fn tanh_kernel<const FMA: bool, const L: usize>(values: &mut [f32]) {
    const ODD: [f32; 7] =
        [-2.760_768_5e-16, 2.000_188e-13, -8.604_672e-11, 5.122_297e-8, 1.485_722_35e-5, 6.372_619e-4, 4.893_524_6e-3];
    const EVEN: [f32; 4] = [1.198_258_4e-6, 1.185_347_1e-4, 2.268_434_6e-3, 4.893_525e-3];
    // A plain loop: the compiler fills the lanes here, but not through arrays of them.
    for value in values {
        let x = value.clamp(-7.905_311, 7.905_311);
        let square = x * x;
        let odd = ODD.iter().skip(1).fold(ODD[0], |p, c| mul_add::<FMA>(p, square, *c));
        let even = EVEN.iter().skip(1).fold(EVEN[0], |p, c| mul_add::<FMA>(p, square, *c));
        *value = x * odd / even;
    }
}

dispatch!(
    /// Hyperbolic tangent in place; absolute error below 3e-7.
    pub fn tanh(values: &mut [f32]) = tanh_kernel
);

#[inline(always)]
fn elu_kernel<const FMA: bool, const L: usize>(values: &mut [f32]) {
    for value in values {
        let below = exp::<FMA, 1>([value.min(0.0)])[0] - 1.0;
        *value = if *value > 0.0 { *value } else { below };
    }
}

dispatch!(
    /// `x` where positive, `e^x − 1` elsewhere.
    pub fn elu(values: &mut [f32]) = elu_kernel
);

#[inline(always)]
fn softmax_kernel<const FMA: bool, const L: usize>(values: &mut [f32], scale: f32) {
    let most = values.iter().fold(f32::NEG_INFINITY, |most, v| most.max(*v));
    map_lanes::<L>(values, |x| exp::<FMA, L>(x.map(|v| (v - most) * scale)));
    let mut lanes = [0.0f32; L];
    let (blocks, tail) = values.as_chunks::<L>();
    for block in blocks {
        for lane in 0..L {
            lanes[lane] += block[lane];
        }
    }
    let sum: f64 = lanes.iter().chain(tail).map(|v| f64::from(*v)).sum();
    let share = (1.0 / sum) as f32;
    values.iter_mut().for_each(|v| *v *= share);
}

dispatch!(
    /// `e^(scale·x)` over its sum, in place; `scale` ≥ 0.
    pub fn softmax(values: &mut [f32], scale: f32) = softmax_kernel
);

#[inline(always)]
fn hard_swish_kernel<const FMA: bool, const L: usize>(values: &mut [f32]) {
    map_lanes::<L>(values, |x| x.map(|v| v * (v + 3.0).clamp(0.0, 6.0) * (1.0 / 6.0)));
}

dispatch!(
    /// `x · clamp(x + 3, 0, 6) / 6` in place.
    pub fn hard_swish(values: &mut [f32]) = hard_swish_kernel
);

#[inline(always)]
fn clamp_kernel<const FMA: bool, const L: usize>(values: &mut [f32], low: f32, high: f32) {
    map_lanes::<L>(values, |x| x.map(|v| v.max(low).min(high)));
}

dispatch!(
    /// Clamps to `[low, high]` in place (ReLU is `[0, ∞]`).
    pub fn clamp(values: &mut [f32], low: f32, high: f32) = clamp_kernel
);

#[inline(always)]
fn prelu_kernel<const FMA: bool, const L: usize>(values: &mut [f32], slopes: &[f32]) {
    for pixel in values.chunks_exact_mut(slopes.len().max(1)) {
        for (value, slope) in pixel.iter_mut().zip(slopes) {
            *value = value.max(0.0) + slope * value.min(0.0);
        }
    }
}

dispatch!(
    /// `x` where positive, `slope·x` elsewhere, one slope a channel (channels fastest).
    pub fn prelu(values: &mut [f32], slopes: &[f32]) = prelu_kernel
);

#[cfg(test)]
mod tests {
    use super::*;

    fn check(f: impl Fn(&mut [f32]), exact: impl Fn(f64) -> f64, tolerance: f64) {
        let mut values: Vec<f32> = (-9000..9003).map(|i| i as f32 * 0.01).collect();
        let inputs = values.clone();
        f(&mut values);
        for (x, y) in inputs.iter().zip(&values) {
            let want = exact(f64::from(*x));
            assert!((f64::from(*y) - want).abs() <= tolerance * (1.0 + want.abs()), "f({x}) = {y}, not {want}");
        }
    }

    #[test]
    fn each_function_agrees_with_its_formula() {
        check(logistic, |x| 1.0 / (1.0 + (-x).exp()), 2e-7);
        check(tanh, f64::tanh, 3e-7);
        check(elu, |x| if x > 0.0 { x } else { x.exp() - 1.0 }, 2e-7);
        check(hard_swish, |x| x * (x + 3.0).clamp(0.0, 6.0) / 6.0, 2e-7);
        check(|v| clamp(v, 0.0, 6.0), |x| x.clamp(0.0, 6.0), 0.0);
        check(|v| prelu(v, &[0.25]), |x| if x > 0.0 { x } else { 0.25 * x }, 1e-7);
        check(
            |v| map_lanes::<8>(v, exp::<false, 8>),
            |x| if x < -87.336 { (-87.336f64).exp() } else { x.min(88.0).exp() },
            3e-7,
        );
    }

    #[test]
    fn softmax_is_a_distribution_however_large_its_arguments() {
        let mut values: Vec<f32> = (0..37).map(|i| (i as f32 * 0.7).sin() * 300.0).collect();
        let exact: Vec<f64> = values.iter().map(|v| ((f64::from(*v) - 300.0) / 3.0).exp()).collect();
        let sum: f64 = exact.iter().sum();
        softmax(&mut values, 1.0 / 3.0);
        for (value, exact) in values.iter().zip(&exact) {
            assert!((f64::from(*value) - exact / sum).abs() < 1e-5, "{value} {}", exact / sum);
        }
    }

    #[test]
    fn tanh_of_the_ends() {
        let mut ends = [f32::INFINITY, f32::NEG_INFINITY, 0.0, 1e-30];
        tanh(&mut ends);
        assert!((ends[0] - 1.0).abs() < 1e-6 && (ends[1] + 1.0).abs() < 1e-6 && ends[2] == 0.0);
        assert!((ends[3] - 1e-30).abs() < 1e-35);
    }

    #[test]
    fn prelu_slopes_follow_the_channel() {
        let mut values = [-1.0, -1.0, 2.0, 2.0];
        prelu(&mut values, &[0.5, 0.1]);
        assert_eq!(values, [-0.5, -0.1, 2.0, 2.0]);
    }
}
