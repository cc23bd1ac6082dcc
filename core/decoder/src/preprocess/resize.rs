//! Resizing by area, with the arithmetic of OpenCV's `INTER_AREA` on 8-bit pictures.
//!
//! Where both axes shrink, each output pixel is the mean of the source rectangle under it, pixels at its rim weighted by how
//! much of them lies inside. Where an axis grows, OpenCV interpolates linearly with weights that follow the same cells, in
//! fixed point. Rounding follows OpenCV's (half to even; the 2×2 mean half up), so that results agree to the last bit but
//! for the order of float sums.

use std::ops::Range;

/// A rectangle of an interleaved RGB frame.
#[derive(Clone, Copy, Debug)]
pub struct Pixels<'a> {
    data: &'a [u8],
    /// Width of the whole frame, pixels.
    frame_width: usize,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl<'a> Pixels<'a> {
    /// The part of a frame in `rows` and `columns`; `None` when that part is empty or reaches beyond the frame.
    pub fn of(data: &'a [u8], frame_width: usize, rows: Range<usize>, columns: Range<usize>) -> Option<Self> {
        let inside = columns.end <= frame_width && rows.end.checked_mul(frame_width)?.checked_mul(3)? <= data.len();
        let part =
            Self { data, frame_width, left: columns.start, top: rows.start, width: columns.len(), height: rows.len() };
        (inside && !rows.is_empty() && !columns.is_empty()).then_some(part)
    }

    /// One row of the rectangle, RGB interleaved.
    pub fn row(&self, y: usize) -> &'a [u8] {
        let from = 3 * ((self.top + y) * self.frame_width + self.left);
        &self.data[from..from + 3 * self.width]
    }

    /// Width and height, pixels, both ≥ 1.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }
}

/// The rectangle resized to `width × height` RGB; nothing when either is 0.
pub fn resize_area(source: &Pixels<'_>, (width, height): (usize, usize)) -> Vec<u8> {
    if width == 0 || height == 0 {
        return Vec::new();
    }
    if source.width < width || source.height < height {
        return enlarge(source, (width, height));
    }
    if source.width.is_multiple_of(width) && source.height.is_multiple_of(height) {
        return shrink_by_integers(source, (width, height));
    }
    shrink(source, (width, height))
}

/// Means of whole pixels.
fn shrink_by_integers(source: &Pixels<'_>, (width, height): (usize, usize)) -> Vec<u8> {
    let (across, down) = (source.width / width, source.height / height);
    let scale = 1.0 / (across * down) as f32;
    let mut out = Vec::with_capacity(3 * width * height);
    let mut sums = vec![0u32; 3 * width];
    for y in 0..height {
        sums.fill(0);
        for row in (y * down..(y + 1) * down).map(|row| source.row(row)) {
            for (sum, cell) in sums.chunks_exact_mut(3).zip(row.chunks_exact(3 * across)) {
                for pixel in cell.as_chunks::<3>().0 {
                    (0..3).for_each(|c| sum[c] += u32::from(pixel[c]));
                }
            }
        }
        out.extend(sums.iter().map(|sum| match across * down {
            4 if across == 2 => ((sum + 2) >> 2) as u8,
            _ => rounded(*sum as f32 * scale),
        }));
    }
    out
}

/// One source pixel's share of one output pixel.
struct Share {
    from: usize,
    to: usize,
    weight: f32,
}

/// The shares along an axis, by output pixel.
fn shares(from: usize, to: usize) -> Vec<Share> {
    let scale = 1.0 / (to as f64 / from as f64);
    let mut shares = Vec::with_capacity(to * (scale.ceil() as usize + 2));
    for cell in 0..to {
        let (start, end) = (cell as f64 * scale, (cell + 1) as f64 * scale);
        let end = end.max(start + scale);
        let width = scale.min(from as f64 - start);
        let last = (end.floor() as usize).min(from - 1);
        let first = (start.ceil() as usize).min(last);
        let mut give = |from: usize, part: f64| shares.push(Share { from, to: cell, weight: (part / width) as f32 });
        if first as f64 - start > 1e-3 {
            give(first - 1, first as f64 - start);
        }
        (first..last).for_each(|pixel| give(pixel, 1.0));
        if end - last as f64 > 1e-3 {
            give(last, (end - last as f64).min(1.0).min(width));
        }
    }
    shares
}

fn shrink(source: &Pixels<'_>, (width, height): (usize, usize)) -> Vec<u8> {
    let (columns, rows) = (shares(source.width, width), shares(source.height, height));
    let mut out = Vec::with_capacity(3 * width * height);
    let mut line = vec![0.0f32; 3 * width];
    let mut sum = vec![0.0f32; 3 * width];
    let mut current = 0;
    for row in &rows {
        if row.to != current {
            out.extend(sum.iter().map(|value| rounded(*value)));
            sum.fill(0.0);
            current = row.to;
        }
        line.fill(0.0);
        let pixels = source.row(row.from).as_chunks::<3>().0;
        for share in &columns {
            let (pixel, into) = (pixels[share.from], &mut line[3 * share.to..3 * share.to + 3]);
            (0..3).for_each(|c| into[c] += f32::from(pixel[c]) * share.weight);
        }
        sum.iter_mut().zip(&line).for_each(|(sum, value)| *sum += row.weight * value);
    }
    out.extend(sum.iter().map(|value| rounded(*value)));
    out
}

/// Weights of linear interpolation are in this many parts.
const PARTS: f32 = 2048.0;

/// For each output pixel the source pixel before it and the weights of that one and the next.
fn taps(from: usize, to: usize) -> Vec<(usize, [i32; 2])> {
    let growth = to as f64 / from as f64;
    let scale = 1.0 / growth;
    (0..to)
        .map(|cell| {
            let pixel = (cell as f64 * scale).floor() as usize;
            let fraction = ((cell + 1) as f64 - (pixel + 1) as f64 * growth) as f32;
            let fraction = if fraction <= 0.0 { 0.0 } else { fraction - fraction.floor() };
            let (pixel, fraction) = if pixel + 1 >= from { (from - 1, 0.0) } else { (pixel, fraction) };
            let part = |value: f32| (value * PARTS).round_ties_even() as i32;
            (pixel, [part(1.0 - fraction), part(fraction)])
        })
        .collect()
}

fn enlarge(source: &Pixels<'_>, (width, height): (usize, usize)) -> Vec<u8> {
    let (columns, rows) = (taps(source.width, width), taps(source.height, height));
    let line = |y: usize| -> Vec<i32> {
        let pixels = source.row(y).as_chunks::<3>().0;
        let blend = |&(at, [near, far]): &(usize, [i32; 2])| {
            let next = (at + 1).min(pixels.len() - 1);
            [0, 1, 2].map(|c| i32::from(pixels[at][c]) * near + i32::from(pixels[next][c]) * far)
        };
        columns.iter().flat_map(blend).collect()
    };
    let mut out = Vec::with_capacity(3 * width * height);
    let mut cached: Option<(usize, Vec<i32>, Vec<i32>)> = None;
    for &(at, [near, far]) in &rows {
        if cached.as_ref().is_none_or(|(row, ..)| *row != at) {
            cached = Some((at, line(at), line((at + 1).min(source.height - 1))));
        }
        let Some((_, above, below)) = &cached else { continue };
        let blend = |(a, b): (&i32, &i32)| {
            let value = (((near * (a >> 4)) >> 16) + ((far * (b >> 4)) >> 16) + 2) >> 2;
            value.clamp(0, 255) as u8
        };
        out.extend(above.iter().zip(below).map(blend));
    }
    out
}

/// Nearest code, half to even.
fn rounded(value: f32) -> u8 {
    value.round_ties_even() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize) -> Vec<u8> {
        (0..3 * width * height).map(|i| (i * 7919 % 251) as u8).collect()
    }

    #[test]
    fn the_same_size_is_a_copy_and_one_colour_stays_at_any_size() {
        let data = picture(7, 5);
        let whole = Pixels::of(&data, 7, 0..5, 0..7).expect("inside");
        assert_eq!(resize_area(&whole, (7, 5)), data);
        let flat = [[9u8, 80, 255]; 63].concat();
        let whole = Pixels::of(&flat, 9, 0..7, 0..9).expect("inside");
        for size in [(1, 1), (2, 3), (9, 20), (31, 2), (64, 64)] {
            let out = resize_area(&whole, size);
            assert!(out.as_chunks::<3>().0.iter().all(|p| *p == [9, 80, 255]) && out.len() == 3 * size.0 * size.1);
        }
        assert!(resize_area(&whole, (0, 4)).is_empty());
    }

    #[test]
    fn shrinking_keeps_the_mean() {
        let (width, height) = (53, 41);
        let data = picture(width, height);
        let whole = Pixels::of(&data, width, 0..height, 0..width).expect("inside");
        let mean = |data: &[u8]| data.iter().map(|v| f64::from(*v)).sum::<f64>() / data.len() as f64;
        for size in [(1, 1), (7, 9), (52, 40)] {
            assert!((mean(&resize_area(&whole, size)) - mean(&data)).abs() < 0.6, "{size:?}");
        }
    }

    #[test]
    fn parts_outside_the_frame_are_refused() {
        let data = picture(4, 4);
        assert!(Pixels::of(&data, 4, 0..5, 0..4).is_none());
        assert!(Pixels::of(&data, 4, 0..4, 2..5).is_none());
        assert!(Pixels::of(&data, 4, 2..2, 0..4).is_none());
        assert!(Pixels::of(&data, usize::MAX, 0..4, 0..4).is_none());
    }
}
