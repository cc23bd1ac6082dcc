//! Window maxima and means, and bilinear resizing, on `height × width × channels` maps.

use crate::map::check;
use crate::{Map, MapMut, ShapeError, Window};

/// Largest value under each window; pixels outside the map do not count.
///
/// # Errors
/// When a buffer's length contradicts the shapes.
pub fn max_pool(input: Map<'_>, window: Window, output: MapMut<'_>) -> Result<(), ShapeError> {
    pool(input, window, output, f32::NEG_INFINITY, f32::max, |_, _| {})
}

/// Mean under each window over the pixels inside the map.
///
/// # Errors
/// When a buffer's length contradicts the shapes.
pub fn average_pool(input: Map<'_>, window: Window, output: MapMut<'_>) -> Result<(), ShapeError> {
    pool(
        input,
        window,
        output,
        0.0,
        |sum, value| sum + value,
        |pixel, count| {
            let scale = 1.0 / count.max(1) as f32;
            pixel.iter_mut().for_each(|value| *value *= scale);
        },
    )
}

fn pool(
    input: Map<'_>,
    window: Window,
    output: MapMut<'_>,
    start: f32,
    fold: impl Fn(f32, f32) -> f32,
    finish: impl Fn(&mut [f32], usize),
) -> Result<(), ShapeError> {
    input.check()?;
    output.check()?;
    check("the output's channels", input.channels, output.channels)?;
    let (width, channels) = (output.width, output.channels);
    for (index, pixel) in output.data.chunks_exact_mut(channels.max(1)).enumerate() {
        let (y_first, y_last, y_start) = window.taps(0, index / width, input.height);
        let (x_first, x_last, x_start) = window.taps(1, index % width, input.width);
        pixel.fill(start);
        for y in 0..y_last - y_first {
            for x in 0..x_last - x_first {
                let from = input.pixel(y_start + y * window.dilation[0], x_start + x * window.dilation[1]);
                pixel.iter_mut().zip(from).for_each(|(to, from)| *to = fold(*to, *from));
            }
        }
        finish(pixel, (y_last - y_first) * (x_last - x_first));
    }
    Ok(())
}

/// Where an output pixel samples the input when resizing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// `out · (in / out)`: top-left corners coincide.
    Corner,
    /// `out · (in − 1) / (out − 1)`: the corner pixels coincide.
    AlignedCorners,
    /// `(out + ½) · (in / out) − ½`: the images' outlines coincide.
    HalfPixel,
}

impl Sampling {
    /// Lower and upper neighbour and the fraction between them.
    fn at(self, out: usize, input: usize, output: usize) -> (usize, usize, f32) {
        let scale = input as f32 / output as f32;
        let position = match self {
            Self::Corner => out as f32 * scale,
            Self::AlignedCorners if output > 1 => out as f32 * (input - 1) as f32 / (output - 1) as f32,
            Self::AlignedCorners => 0.0,
            Self::HalfPixel => (out as f32 + 0.5) * scale - 0.5,
        };
        let low = position.floor().max(0.0) as usize;
        let low = low.min(input.saturating_sub(1));
        (low, (low + 1).min(input.saturating_sub(1)), (position - low as f32).clamp(0.0, 1.0))
    }
}

/// Bilinear interpolation to the output's size; the border is repeated.
///
/// # Errors
/// When a buffer's length contradicts the shapes, or the input has no pixel.
pub fn resize_bilinear(input: Map<'_>, sampling: Sampling, output: MapMut<'_>) -> Result<(), ShapeError> {
    input.check()?;
    output.check()?;
    check("the output's channels", input.channels, output.channels)?;
    if output.data.is_empty() {
        return Ok(());
    }
    if input.data.is_empty() {
        return check("the input map", 1, 0);
    }
    let (height, width, channels) = (output.height, output.width, output.channels);
    let columns: Vec<_> = (0..width).map(|x| sampling.at(x, input.width, width)).collect();
    for (y, row) in output.data.chunks_exact_mut(width * channels).enumerate() {
        let (y0, y1, fy) = sampling.at(y, input.height, height);
        for (pixel, &(x0, x1, fx)) in row.chunks_exact_mut(channels).zip(&columns) {
            let corners = [input.pixel(y0, x0), input.pixel(y0, x1), input.pixel(y1, x0), input.pixel(y1, x1)];
            let weights = [(1.0 - fy) * (1.0 - fx), (1.0 - fy) * fx, fy * (1.0 - fx), fy * fx];
            for (c, value) in pixel.iter_mut().enumerate() {
                *value = corners.iter().zip(weights).map(|(corner, weight)| corner[c] * weight).sum();
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pools_count_only_pixels_inside() -> Result<(), ShapeError> {
        let data: Vec<f32> = (0..9).map(|i| -(i as f32)).collect();
        let input = Map { height: 3, width: 3, channels: 1, data: &data };
        let window = Window::same([2, 2], [2, 2], [1, 1], [3, 3]);
        let mut out = [0.0; 4];
        max_pool(input, window, MapMut { height: 2, width: 2, channels: 1, data: &mut out })?;
        assert_eq!(out, [0.0, -2.0, -6.0, -8.0]);
        average_pool(input, window, MapMut { height: 2, width: 2, channels: 1, data: &mut out })?;
        assert_eq!(out, [-2.0, -3.5, -6.5, -8.0]);
        Ok(())
    }

    #[test]
    fn resizing_keeps_a_ramp_a_ramp() -> Result<(), ShapeError> {
        let data: Vec<f32> = (0..8).map(|x| x as f32).collect();
        let input = Map { height: 1, width: 8, channels: 1, data: &data };
        let mut out = [0.0; 16];
        for (sampling, at_five) in
            [(Sampling::Corner, 2.5), (Sampling::HalfPixel, 2.25), (Sampling::AlignedCorners, 35.0 / 15.0)]
        {
            resize_bilinear(input, sampling, MapMut { height: 1, width: 16, channels: 1, data: &mut out })?;
            assert!((out[5] - at_five).abs() < 1e-5, "{sampling:?} {}", out[5]);
        }
        let empty = Map { height: 0, width: 0, channels: 1, data: &[] };
        assert!(
            resize_bilinear(empty, Sampling::Corner, MapMut { height: 1, width: 16, channels: 1, data: &mut out })
                .is_err()
        );
        Ok(())
    }
}
