//! sRGB transfer of whole pictures and its derivative, in lane code. Twin of `reference/loss.rs`' scalar text and of
//! `heartian_space::color`. Values are taken in [0, 1]: below 0 the linear segment goes on, above 1 the power does.

use crate::error::{SplatError, expect_length};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
use rayon::prelude::*;

/// Pixels of a parallel task.
const CHUNK: usize = 16 * 1024;
/// Linear light where the two segments meet.
const KNEE: f32 = 0.003_130_8;

/// sRGB encoding of linear light, element by element.
pub fn srgb_encode(linear: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; linear.len()];
    out.par_chunks_mut(CHUNK).zip(linear.par_chunks(CHUNK)).for_each(|(out, linear)| encode(linear, out));
    out
}

/// Turns gradients with respect to encoded values into those with respect to the linear ones, in place.
///
/// # Errors
/// When the lengths differ.
pub fn srgb_encode_backward(linear: &[f32], gradient: &mut [f32]) -> Result<(), SplatError> {
    expect_length("the gradient of an encoded picture", linear.len(), gradient.len())?;
    gradient.par_chunks_mut(CHUNK).zip(linear.par_chunks(CHUNK)).for_each(|(gradient, linear)| slope(linear, gradient));
    Ok(())
}

/// Encoded value and slope of `N` linear values.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn transfer<V: Lanes>(linear: V) -> (V, V) {
    // SAFETY: V's features are here by contract.
    unsafe {
        let safe = linear.max(V::splat(KNEE));
        let power = safe.log2().mul(V::splat(1.0 / 2.4)).exp2();
        let curved = power.mul_add(V::splat(1.055), V::splat(-0.055));
        let curved_slope = power.mul(V::splat(1.055 / 2.4)).div(safe);
        let low = linear.lt(V::splat(KNEE));
        (V::select(low, linear.mul(V::splat(12.92)), curved), V::select(low, V::splat(12.92), curved_slope))
    }
}

/// Applies `f` to `N` values at a time, to be inlined with it, the last ones through a padded copy.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn map<V: Lanes>(linear: &[f32], out: &mut [f32], f: impl Fn(V, V) -> V) {
    let whole = linear.len() / V::N * V::N;
    for at in (0..whole).step_by(V::N) {
        // SAFETY: both slices hold N values from `at`.
        unsafe { f(V::load(linear.as_ptr().add(at)), V::load(out.as_ptr().add(at))).store(out.as_mut_ptr().add(at)) };
    }
    let (mut a, mut b) = ([0.5; MAX_LANES], [0.0; MAX_LANES]);
    let rest = linear.len() - whole;
    a[..rest].copy_from_slice(&linear[whole..]);
    b[..rest].copy_from_slice(&out[whole..]);
    // SAFETY: the arrays hold MAX_LANES values.
    unsafe { f(V::load(a.as_ptr()), V::load(b.as_ptr())).store(b.as_mut_ptr()) };
    out[whole..].copy_from_slice(&b[..rest]);
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn encode_lanes<V: Lanes>(linear: &[f32], out: &mut [f32]) {
    // SAFETY: V's features are here by contract.
    unsafe {
        map::<V>(
            linear,
            out,
            #[inline(always)]
            |x, _| transfer(x).0,
        )
    };
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn slope_lanes<V: Lanes>(linear: &[f32], gradient: &mut [f32]) {
    // SAFETY: V's features are here by contract.
    unsafe {
        map::<V>(
            linear,
            gradient,
            #[inline(always)]
            |x, g| g.mul(transfer(x).1),
        )
    };
}

dispatched! { fn encode(linear: &[f32], out: &mut [f32]) = encode_lanes; }
dispatched! { fn slope(linear: &[f32], gradient: &mut [f32]) = slope_lanes; }

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_space::color::{srgb_from_linear, srgb_from_linear_derivative};

    #[test]
    fn pictures_are_encoded_as_single_values_are() {
        let linear: Vec<f32> = (0..1003).map(|i| (i as f32 - 20.0) / 900.0).collect();
        let mut gradient = vec![2.0; linear.len()];
        srgb_encode_backward(&linear, &mut gradient).ok();
        for ((x, y), g) in linear.iter().zip(srgb_encode(&linear)).zip(gradient) {
            assert!((y - srgb_from_linear(*x)).abs() < 2e-6, "{x}");
            assert!((g / 2.0 / srgb_from_linear_derivative(*x) - 1.0).abs() < 1e-5, "{x}");
        }
        assert!(srgb_encode(&[]).is_empty());
        assert!(srgb_encode_backward(&[1.0], &mut []).is_err());
    }
}
