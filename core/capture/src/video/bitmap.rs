//! Uncompressed Windows bitmaps: the pictures of a raw AVI, and `.bmp` files.
//!
//! BGR24 or BGRX32, bottom row first unless the height is negative, rows padded to four bytes.

use heartian_space::Rgb8Image;

/// Longest side of any picture that is read, pixels.
pub(super) const LONGEST_SIDE: usize = 16384;
/// Most pixels of a picture that is read: twice an 8K frame.
pub(super) const MOST_PIXELS: usize = 1 << 26;

/// Whether a picture's size is one that is read.
pub(super) fn is_sane(width: usize, height: usize) -> bool {
    let side = 1..=LONGEST_SIDE;
    side.contains(&width) && side.contains(&height) && width * height <= MOST_PIXELS
}

/// A little-endian word.
pub(super) fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

/// Size and order of the pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bitmap {
    pub width: usize,
    pub height: usize,
    bottom_up: bool,
    bytes_per_pixel: usize,
}

impl Bitmap {
    /// Reads a BITMAPINFOHEADER at a place; the inner error names a coding that is not read here.
    pub fn parse(bytes: &[u8], at: usize) -> Result<Result<Self, String>, &'static str> {
        let field = |offset: usize| word(bytes, at.saturating_add(offset)).ok_or("its picture format is cut short");
        let (width, height) = (field(4)? as i32, field(8)? as i32);
        let (depth, coding) = (field(12)? >> 16, field(16)?);
        let name = coding.to_le_bytes();
        if coding != 0 && &name != b"DIB " || !matches!(depth, 24 | 32) {
            let name =
                if coding == 0 { format!("raw {depth}-bit") } else { String::from_utf8_lossy(&name).into_owned() };
            return Ok(Err(name));
        }
        let (pixels, rows) = (width.unsigned_abs() as usize, height.unsigned_abs() as usize);
        if width <= 0 || !is_sane(pixels, rows) {
            return Err("its picture size is absurd");
        }
        let bytes_per_pixel = depth as usize / 8;
        Ok(Ok(Self { width: pixels, height: rows, bottom_up: height > 0, bytes_per_pixel }))
    }

    /// Bytes of a picture.
    pub fn bytes(&self) -> usize {
        self.stride() * self.height
    }

    fn stride(&self) -> usize {
        (self.width * self.bytes_per_pixel).next_multiple_of(4)
    }

    /// The picture in `bytes`; `None` when there are too few.
    pub fn picture(&self, bytes: &[u8]) -> Option<Rgb8Image> {
        let Self { width, height, bottom_up, bytes_per_pixel } = *self;
        let bytes = bytes.get(..self.bytes())?;
        let mut data = Vec::with_capacity(width * height * 3);
        for row in 0..height {
            let from = if bottom_up { height - 1 - row } else { row } * self.stride();
            let pixels = bytes[from..from + width * bytes_per_pixel].chunks_exact(bytes_per_pixel);
            data.extend(pixels.flat_map(|p| [p[2], p[1], p[0]]));
        }
        Some(Rgb8Image { width, height, data })
    }
}

/// A `.bmp` file's picture; the error says what is wrong with it.
pub(super) fn parse_file(bytes: &[u8]) -> Result<Rgb8Image, String> {
    let from = word(bytes, 10).ok_or("the file is cut short")? as usize;
    let bitmap = Bitmap::parse(bytes, 14)?.map_err(|coding| format!("a bitmap coded as `{coding}` is not read"))?;
    let pixels = bytes.get(from..).unwrap_or_default();
    bitmap.picture(pixels).ok_or_else(|| "the file is cut short".into())
}
