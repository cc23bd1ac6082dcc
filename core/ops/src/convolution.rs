//! Convolutions on `height × width × channels` maps: im2col and a matrix product; depthwise and transposed directly.

use gemm::Parallelism;

use crate::dispatch;
use crate::map::check;
use crate::simd::mul_add;
use crate::{Map, MapMut, ShapeError, Window};

/// The weights of a convolution.
#[derive(Clone, Copy, Debug)]
pub struct Filter<'a> {
    /// `out × kernel height × kernel width × in` (full, transposed) or `kernel height × kernel width × channels` (depthwise).
    pub weights: &'a [f32],
    /// One value an output channel, or empty for none.
    pub bias: &'a [f32],
}

impl Filter<'_> {
    fn check(&self, weights: usize, bias: usize) -> Result<(), ShapeError> {
        check("the filter", weights, self.weights.len())?;
        if self.bias.is_empty() { Ok(()) } else { check("the bias", bias, self.bias.len()) }
    }
}

/// Full convolution; zeros outside the map. `scratch` is reused between calls.
///
/// # Errors
/// When a buffer's length contradicts the shapes.
pub fn conv2d(
    input: Map<'_>,
    filter: Filter<'_>,
    window: Window,
    output: MapMut<'_>,
    scratch: &mut Vec<f32>,
) -> Result<(), ShapeError> {
    let [kh, kw] = window.kernel;
    let depth = kh * kw * input.channels;
    input.check()?;
    output.check()?;
    filter.check(depth * output.channels, output.channels)?;
    let pointwise = window.kernel == [1, 1]
        && window.stride == [1, 1]
        && window.before == [0, 0]
        && (input.height, input.width) == (output.height, output.width);
    // Bound the unrolled matrix to about half a megabyte so that it stays in cache.
    let rows_per_block = if pointwise { output.height } else { (131_072 / (depth * output.width).max(1)).max(1) };
    let mut row = 0;
    while row < output.height {
        let rows = rows_per_block.min(output.height - row);
        let pixels = rows * output.width;
        let unrolled: &[f32] = if pointwise {
            input.data
        } else {
            im2col(&input, &window, row..row + rows, output.width, scratch);
            scratch
        };
        let range = row * output.width * output.channels..(row + rows) * output.width * output.channels;
        product(unrolled, filter, &mut output.data[range], [pixels, output.channels, depth]);
        row += rows;
    }
    Ok(())
}

/// `out[p, o] = bias[o] + Σ_k input[p, k]·weights[o, k]`: a dense layer over rows, or a product with a transposed matrix.
///
/// # Errors
/// When a buffer's length contradicts `[rows, outputs, depth]`.
pub fn linear(
    input: &[f32],
    filter: Filter<'_>,
    out: &mut [f32],
    [rows, outputs, depth]: [usize; 3],
) -> Result<(), ShapeError> {
    check("the input rows", rows * depth, input.len())?;
    check("the output rows", rows * outputs, out.len())?;
    filter.check(depth * outputs, outputs)?;
    product(input, filter, out, [rows, outputs, depth]);
    Ok(())
}

/// `out[p, o] = bias[o] + Σ_k unrolled[p, k]·weights[o, k]`; sizes `[pixels, channels, depth]` were checked by the caller.
fn product(unrolled: &[f32], filter: Filter<'_>, out: &mut [f32], [pixels, channels, depth]: [usize; 3]) {
    if filter.bias.is_empty() {
        out.fill(0.0);
    } else {
        out.chunks_exact_mut(channels.max(1)).for_each(|pixel| pixel.copy_from_slice(filter.bias));
    }
    if pixels == 0 || channels == 0 || depth == 0 {
        return;
    }
    assert!(
        unrolled.len() >= pixels * depth && filter.weights.len() >= channels * depth && out.len() >= pixels * channels
    );
    // SAFETY: the assertion above bounds every address the strides can reach.
    unsafe {
        gemm::gemm(
            pixels,
            channels,
            depth,
            out.as_mut_ptr(),
            1,
            channels as isize,
            true,
            unrolled.as_ptr(),
            1,
            depth as isize,
            filter.weights.as_ptr(),
            depth as isize,
            1,
            1.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

/// One row of the matrix per output pixel: its window, `kernel height × kernel width × channels`, zeros outside.
fn im2col(input: &Map<'_>, window: &Window, rows: std::ops::Range<usize>, width: usize, scratch: &mut Vec<f32>) {
    let [kh, kw] = window.kernel;
    let depth = kh * kw * input.channels;
    scratch.clear();
    scratch.resize(rows.len() * width * depth, 0.0);
    let mut pixels = scratch.chunks_exact_mut(depth.max(1));
    for oy in rows {
        let (y_first, y_last, y_start) = window.taps(0, oy, input.height);
        for ox in 0..width {
            let (x_first, x_last, x_start) = window.taps(1, ox, input.width);
            let Some(pixel) = pixels.next() else { return };
            for ky in y_first..y_last {
                let y = y_start + (ky - y_first) * window.dilation[0];
                let to = &mut pixel[(ky * kw + x_first) * input.channels..(ky * kw + x_last) * input.channels];
                if window.dilation[1] == 1 {
                    let from = (y * input.width + x_start) * input.channels;
                    to.copy_from_slice(&input.data[from..from + to.len()]);
                } else {
                    for (k, to) in to.chunks_exact_mut(input.channels.max(1)).enumerate() {
                        to.copy_from_slice(input.pixel(y, x_start + k * window.dilation[1]));
                    }
                }
            }
        }
    }
}

/// Depthwise convolution: one filter a channel; zeros outside the map.
///
/// # Errors
/// When a buffer's length contradicts the shapes.
pub fn depthwise_conv2d(
    input: Map<'_>,
    filter: Filter<'_>,
    window: Window,
    mut output: MapMut<'_>,
) -> Result<(), ShapeError> {
    input.check()?;
    output.check()?;
    check("the output's channels", input.channels, output.channels)?;
    filter.check(window.kernel[0] * window.kernel[1] * input.channels, input.channels)?;
    depthwise(&input, filter, &window, &mut output);
    Ok(())
}

dispatch!(
    fn depthwise(input: &Map<'_>, filter: Filter<'_>, window: &Window, output: &mut MapMut<'_>) = depthwise_kernel
);

#[inline(always)]
fn depthwise_kernel<const FMA: bool, const L: usize>(
    input: &Map<'_>,
    filter: Filter<'_>,
    window: &Window,
    output: &mut MapMut<'_>,
) {
    let channels = input.channels;
    let mut pixels = output.data.chunks_exact_mut(channels.max(1));
    for oy in 0..output.height {
        for ox in 0..output.width {
            let Some(pixel) = pixels.next() else { return };
            let at = [window.taps(0, oy, input.height), window.taps(1, ox, input.width)];
            let mut channel = 0;
            while channel + L <= channels {
                pixel[channel..channel + L].copy_from_slice(&taps::<FMA, L>(input, filter, window, at, channel));
                channel += L;
            }
            while channel + 4 <= channels {
                pixel[channel..channel + 4].copy_from_slice(&taps::<FMA, 4>(input, filter, window, at, channel));
                channel += 4;
            }
            while channel < channels {
                pixel[channel] = taps::<FMA, 1>(input, filter, window, at, channel)[0];
                channel += 1;
            }
        }
    }
}

/// `L` channels of one output pixel of a depthwise convolution.
#[inline(always)]
fn taps<const FMA: bool, const L: usize>(
    input: &Map<'_>,
    filter: Filter<'_>,
    window: &Window,
    [(y_first, y_last, y_start), (x_first, x_last, x_start)]: [(usize, usize, usize); 2],
    channel: usize,
) -> [f32; L] {
    let channels = input.channels;
    let mut sum = [0.0; L];
    if !filter.bias.is_empty() {
        sum.copy_from_slice(&filter.bias[channel..channel + L]);
    }
    for ky in y_first..y_last {
        let y = y_start + (ky - y_first) * window.dilation[0];
        for kx in x_first..x_last {
            let x = x_start + (kx - x_first) * window.dilation[1];
            let values = &input.data[(y * input.width + x) * channels + channel..][..L];
            let weights = &filter.weights[(ky * window.kernel[1] + kx) * channels + channel..][..L];
            for lane in 0..L {
                sum[lane] = mul_add::<FMA>(values[lane], weights[lane], sum[lane]);
            }
        }
    }
    sum
}

/// Transposed convolution: input pixel (y, x) adds `value·weights` at `(y, x)·stride − before + tap`.
///
/// # Errors
/// When a buffer's length contradicts the shapes.
pub fn transposed_conv2d(
    input: Map<'_>,
    filter: Filter<'_>,
    window: Window,
    output: MapMut<'_>,
) -> Result<(), ShapeError> {
    let [kh, kw] = window.kernel;
    input.check()?;
    output.check()?;
    filter.check(kh * kw * input.channels * output.channels, output.channels)?;
    let (out_height, out_width, out_channels) = (output.height, output.width, output.channels);
    output.data.fill(0.0);
    if !filter.bias.is_empty() {
        output.data.chunks_exact_mut(out_channels.max(1)).for_each(|pixel| pixel.copy_from_slice(filter.bias));
    }
    for y in 0..input.height {
        for x in 0..input.width {
            let values = input.pixel(y, x);
            for tap in 0..kh * kw {
                let oy = (y * window.stride[0] + tap / kw).wrapping_sub(window.before[0]);
                let ox = (x * window.stride[1] + tap % kw).wrapping_sub(window.before[1]);
                if oy >= out_height || ox >= out_width {
                    continue;
                }
                for channel in 0..out_channels {
                    let weights = &filter.weights[(channel * kh * kw + tap) * input.channels..][..input.channels];
                    let sum: f32 = values.iter().zip(weights).map(|(value, weight)| value * weight).sum();
                    output.data[(oy * out_width + ox) * out_channels + channel] += sum;
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values in [−1, 1) from a fixed generator.
    fn noise(count: usize, seed: u64) -> Vec<f32> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / 8_388_608.0 - 1.0
        };
        (0..count).map(|_| next()).collect()
    }

    struct Case {
        input: [usize; 3],
        out_channels: usize,
        window: Window,
        output: [usize; 2],
    }

    /// (y, x) of a tap, when inside the map.
    fn source(case: &Case, oy: usize, ox: usize, ky: usize, kx: usize) -> Option<(usize, usize)> {
        let w = case.window;
        let y = (oy * w.stride[0] + ky * w.dilation[0]).checked_sub(w.before[0])?;
        let x = (ox * w.stride[1] + kx * w.dilation[1]).checked_sub(w.before[1])?;
        (y < case.input[0] && x < case.input[1]).then_some((y, x))
    }

    fn cases() -> Vec<Case> {
        let mut cases = Vec::new();
        for (size, kernel, stride, dilation) in
            [([9, 7], 3, 1, 1), ([8, 11], 5, 2, 1), ([10, 10], 3, 1, 2), ([4, 4], 1, 1, 1)]
        {
            for (channels, out_channels) in [(3, 5), (16, 16), (27, 8)] {
                let window = Window::same([kernel; 2], [stride; 2], [dilation; 2], size);
                let output = size.map(|n| n.div_ceil(stride));
                cases.push(Case { input: [size[0], size[1], channels], out_channels, window, output });
                let window = Window::valid([kernel; 2], [stride; 2], [dilation; 2]);
                let output = window.valid_output(size);
                cases.push(Case { input: [size[0], size[1], channels], out_channels, window, output });
            }
        }
        cases
    }

    #[test]
    fn convolution_agrees_with_its_definition() -> Result<(), ShapeError> {
        for case in cases() {
            let [height, width, channels] = case.input;
            let ([kh, kw], [oh, ow], oc) = (case.window.kernel, case.output, case.out_channels);
            let (x, w, b) = (noise(height * width * channels, 1), noise(oc * kh * kw * channels, 2), noise(oc, 3));
            let mut out = vec![9.0; oh * ow * oc];
            let input = Map { height, width, channels, data: &x };
            let output = MapMut { height: oh, width: ow, channels: oc, data: &mut out };
            conv2d(input, Filter { weights: &w, bias: &b }, case.window, output, &mut Vec::new())?;
            for (i, value) in out.iter().enumerate() {
                let (oy, ox, o) = (i / oc / ow, i / oc % ow, i % oc);
                let mut want = f64::from(b[o]);
                for (tap, c) in (0..kh * kw).flat_map(|tap| (0..channels).map(move |c| (tap, c))) {
                    if let Some((y, sx)) = source(&case, oy, ox, tap / kw, tap % kw) {
                        want += f64::from(x[(y * width + sx) * channels + c])
                            * f64::from(w[(o * kh * kw + tap) * channels + c]);
                    }
                }
                assert!((f64::from(*value) - want).abs() < 1e-4, "{:?} {i}: {value} {want}", case.window);
            }
        }
        Ok(())
    }

    #[test]
    fn depthwise_agrees_with_its_definition() -> Result<(), ShapeError> {
        for case in cases() {
            let [height, width, channels] = case.input;
            let ([kh, kw], [oh, ow]) = (case.window.kernel, case.output);
            let (x, w, b) = (noise(height * width * channels, 4), noise(kh * kw * channels, 5), noise(channels, 6));
            let mut out = vec![9.0; oh * ow * channels];
            let output = MapMut { height: oh, width: ow, channels, data: &mut out };
            let input = Map { height, width, channels, data: &x };
            depthwise_conv2d(input, Filter { weights: &w, bias: &b }, case.window, output)?;
            for (i, value) in out.iter().enumerate() {
                let (oy, ox, c) = (i / channels / ow, i / channels % ow, i % channels);
                let mut want = f64::from(b[c]);
                for tap in 0..kh * kw {
                    if let Some((y, sx)) = source(&case, oy, ox, tap / kw, tap % kw) {
                        want += f64::from(x[(y * width + sx) * channels + c]) * f64::from(w[tap * channels + c]);
                    }
                }
                assert!((f64::from(*value) - want).abs() < 1e-5, "{:?} {i}: {value} {want}", case.window);
            }
        }
        Ok(())
    }

    /// ⟨conv(x), y⟩ = ⟨x, transposed(y)⟩ with the filter's channel axes swapped: the definition of the transpose.
    #[test]
    fn transposed_is_the_adjoint_of_convolution() -> Result<(), ShapeError> {
        let (size, ci, co, k, stride) = ([8, 6], 3, 4, 2, 2);
        let window = Window::same([k; 2], [stride; 2], [1, 1], size);
        let half = size.map(|n| n / stride);
        let (x, y) = (noise(size[0] * size[1] * ci, 7), noise(half[0] * half[1] * co, 8));
        let w = noise(co * k * k * ci, 9);
        let mut swapped = vec![0.0; w.len()];
        for (o, tap, c) in (0..co).flat_map(|o| (0..k * k).flat_map(move |t| (0..ci).map(move |c| (o, t, c)))) {
            swapped[(c * k * k + tap) * co + o] = w[(o * k * k + tap) * ci + c];
        }
        let (mut forward, mut back) = (vec![0.0; y.len()], vec![0.0; x.len()]);
        let (big, small) = ((size[0], size[1]), (half[0], half[1]));
        conv2d(
            Map { height: big.0, width: big.1, channels: ci, data: &x },
            Filter { weights: &w, bias: &[] },
            window,
            MapMut { height: small.0, width: small.1, channels: co, data: &mut forward },
            &mut Vec::new(),
        )?;
        transposed_conv2d(
            Map { height: small.0, width: small.1, channels: co, data: &y },
            Filter { weights: &swapped, bias: &[] },
            window,
            MapMut { height: big.0, width: big.1, channels: ci, data: &mut back },
        )?;
        let dot = |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum() };
        assert!((dot(&forward, &y) - dot(&x, &back)).abs() < 1e-4);
        Ok(())
    }

    #[test]
    fn contradicting_lengths_are_refused() {
        let window = Window::valid([1, 1], [1, 1], [1, 1]);
        let input = Map { height: 2, width: 2, channels: 1, data: &[0.0; 3] };
        let filter = Filter { weights: &[1.0], bias: &[] };
        let mut out = [0.0; 4];
        let output = MapMut { height: 2, width: 2, channels: 1, data: &mut out };
        assert!(conv2d(input, filter, window, output, &mut Vec::new()).is_err());
    }
}
