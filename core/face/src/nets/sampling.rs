//! Cutting the networks' inputs out of a frame. Pixel centres lie at +0.5.

use heartian_space::Rgb8Image;

/// What lies outside the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Border {
    /// Black.
    Black,
    /// The nearest pixel.
    Replicate,
}

/// An affine map from the output's pixels to the image's: `origin + u·right + v·down`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// Image position of the output's corner (0, 0), pixels.
    pub origin: [f32; 2],
    /// Image step for one output pixel to the right.
    pub right: [f32; 2],
    /// Image step for one output pixel down.
    pub down: [f32; 2],
    /// Output width and height.
    pub size: [usize; 2],
    /// What lies outside.
    pub border: Border,
}

/// Bilinear samples, `height × width × 3`, each 8-bit value times `scale` plus `offset`.
pub(super) fn sample(image: &Rgb8Image, patch: &Patch, scale: f32, offset: f32) -> Vec<f32> {
    let [width, height] = patch.size;
    let mut out = Vec::with_capacity(width * height * 3);
    for row in 0..height {
        for column in 0..width {
            let (u, v) = (column as f32 + 0.5, row as f32 + 0.5);
            let x = patch.origin[0] + u * patch.right[0] + v * patch.down[0] - 0.5;
            let y = patch.origin[1] + u * patch.right[1] + v * patch.down[1] - 0.5;
            let rgb = bilinear(image, x, y, patch.border);
            out.extend(rgb.map(|value| value * scale + offset));
        }
    }
    out
}

fn bilinear(image: &Rgb8Image, x: f32, y: f32, border: Border) -> [f32; 3] {
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    // Saturating casts: positions far outside stay far outside.
    let (x0, y0) = (x0 as i64, y0 as i64);
    let mut sum = [0.0; 3];
    for (dy, wy) in [(0, 1.0 - fy), (1, fy)] {
        for (dx, wx) in [(0, 1.0 - fx), (1, fx)] {
            let pixel = fetch(image, x0.saturating_add(dx), y0.saturating_add(dy), border);
            let weight = wx * wy;
            sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += weight * f32::from(value));
        }
    }
    sum
}

fn fetch(image: &Rgb8Image, x: i64, y: i64, border: Border) -> [u8; 3] {
    let (last_x, last_y) = (image.width as i64 - 1, image.height as i64 - 1);
    let inside = (0..=last_x).contains(&x) && (0..=last_y).contains(&y);
    if border == Border::Black && !inside || last_x < 0 || last_y < 0 {
        return [0; 3];
    }
    image.pixel(x.clamp(0, last_x) as usize, y.clamp(0, last_y) as usize)
}
