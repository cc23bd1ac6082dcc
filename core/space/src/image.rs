//! One 8-bit sRGB image.

use crate::SpaceError;

/// `height × width × 3` bytes, sRGB-encoded, row-major, top row first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rgb8Image {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Interleaved RGB.
    pub data: Vec<u8>,
}

impl Rgb8Image {
    /// An image of one colour.
    pub fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        Self { width, height, data: color.repeat(width * height) }
    }

    /// Wraps a buffer.
    ///
    /// # Errors
    /// When its length is not `3·width·height`.
    pub fn from_data(width: usize, height: usize, data: Vec<u8>) -> Result<Self, SpaceError> {
        let expected = width.saturating_mul(height).saturating_mul(3);
        if data.len() == expected {
            Ok(Self { width, height, data })
        } else {
            Err(SpaceError::Length { what: "an RGB image", expected, found: data.len() })
        }
    }

    /// The pixel at column `x`, row `y`; black outside.
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        if x >= self.width || y >= self.height {
            return [0; 3];
        }
        let i = 3 * (y * self.width + x);
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }

    /// Sets a pixel; positions outside are ignored.
    pub fn set_pixel(&mut self, x: usize, y: usize, color: [u8; 3]) {
        if x < self.width && y < self.height {
            let i = 3 * (y * self.width + x);
            self.data[i..i + 3].copy_from_slice(&color);
        }
    }

    /// Copies `other` with its top-left corner at (`x`, `y`), clipped to this image.
    pub fn paste(&mut self, other: &Rgb8Image, x: usize, y: usize) {
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let width = other.width.min(self.width.saturating_sub(x));
            let (to, from) = (3 * ((y + row) * self.width + x), 3 * row * other.width);
            self.data[to..to + 3 * width].copy_from_slice(&other.data[from..from + 3 * width]);
        }
    }
}
