//! Raw AVI: uncompressed BGR24, bottom row first, rows padded to four bytes, one index chunk.
//!
//! Players and every video tool read this form, and no pixel is lost. The number of frames is told first; the writer then
//! takes exactly that many.

use std::io::{Error, ErrorKind, Result, Write};

use heartian_space::Clip;

/// `RIFF` sizes are 32-bit.
const LIMIT: u64 = u32::MAX as u64;
/// Bytes of the headers before the `movi` list's chunks.
const HEADER: u64 = 224;
/// Frame rates are written as a fraction over this.
const RATE_SCALE: u32 = 1000;

/// What all frames of a file have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AviForm {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Number of frames.
    pub frames: usize,
    /// Frame rate, hertz; written to a thousandth, 1 where it is not positive.
    pub hertz: f64,
}

impl AviForm {
    /// A clip's.
    pub fn of(clip: &Clip) -> Self {
        Self { width: clip.width, height: clip.height, frames: clip.len(), hertz: clip.frame_rate_hertz() }
    }

    fn stride(&self) -> u64 {
        (self.width as u64 * 3).next_multiple_of(4)
    }

    /// The file's size in bytes; nothing when AVI cannot hold it (4 GiB).
    pub fn size(&self) -> Option<u64> {
        let frame = self.stride().checked_mul(self.height as u64)?.checked_add(8 + 16)?;
        let total = frame.checked_mul(self.frames as u64)?.checked_add(HEADER + 8)?;
        let fits = total <= LIMIT && i32::try_from(self.width).is_ok() && i32::try_from(self.height).is_ok();
        fits.then_some(total)
    }
}

/// Writes one file, frame by frame.
pub struct AviWriter<'a> {
    file: &'a mut dyn Write,
    form: AviForm,
    written: usize,
    rows: Vec<u8>,
}

impl<'a> AviWriter<'a> {
    /// Writes the headers.
    ///
    /// # Errors
    /// When the form is too large for AVI, or writing fails.
    pub fn begin(file: &'a mut dyn Write, form: AviForm) -> Result<Self> {
        if form.size().is_none() {
            return Err(Error::new(ErrorKind::InvalidInput, "more than 4 GiB of frames do not fit an AVI file"));
        }
        let image = form.stride() * form.height as u64;
        write_headers(&form, image as u32, file)?;
        Ok(Self { file, form, written: 0, rows: vec![0; image as usize] })
    }

    /// Writes the next frame: RGB interleaved, top row first.
    ///
    /// # Errors
    /// When it has another size, there are enough frames already, or writing fails.
    pub fn frame(&mut self, rgb: &[u8]) -> Result<()> {
        let AviForm { width, height, frames, .. } = self.form;
        if rgb.len() != width * height * 3 || self.written == frames {
            return Err(Error::new(ErrorKind::InvalidInput, "a frame of another size, or one too many"));
        }
        let lines = rgb.chunks_exact(width * 3).rev();
        for (to, from) in self.rows.chunks_exact_mut(self.form.stride() as usize).zip(lines) {
            for (to, from) in to.chunks_exact_mut(3).zip(from.chunks_exact(3)) {
                to.copy_from_slice(&[from[2], from[1], from[0]]);
            }
        }
        chunk(self.file, *b"00db", self.rows.len() as u32)?;
        self.written += 1;
        self.file.write_all(&self.rows)
    }

    /// Writes the index.
    ///
    /// # Errors
    /// When frames are missing, or writing fails.
    pub fn end(self) -> Result<()> {
        if self.written != self.form.frames {
            return Err(Error::new(ErrorKind::InvalidInput, "frames are missing at the end"));
        }
        let (count, image) = (self.written as u32, self.rows.len() as u32);
        chunk(self.file, *b"idx1", count * 16)?;
        for index in 0..count {
            /// Every frame can be decoded alone.
            const KEY_FRAME: u32 = 0x10;
            self.file.write_all(b"00db")?;
            numbers(self.file, &[KEY_FRAME, 4 + index * (image + 8), image])?;
        }
        Ok(())
    }
}

/// Writes a clip, the person over black as the matte says.
///
/// # Errors
/// As [`AviWriter`].
pub fn write_clip(clip: &Clip, file: &mut dyn Write) -> Result<()> {
    let mut writer = AviWriter::begin(file, AviForm::of(clip))?;
    (0..clip.len()).try_for_each(|index| writer.frame(&clip.image_over_black(index).data))?;
    writer.end()
}

fn numbers(file: &mut dyn Write, values: &[u32]) -> Result<()> {
    values.iter().try_for_each(|value| file.write_all(&value.to_le_bytes()))
}

fn chunk(file: &mut dyn Write, name: [u8; 4], size: u32) -> Result<()> {
    file.write_all(&name)?;
    numbers(file, &[size])
}

fn list(file: &mut dyn Write, name: [u8; 4], size: u32) -> Result<()> {
    chunk(file, *b"LIST", size)?;
    file.write_all(&name)
}

/// `RIFF`, the header list and the opening of `movi`, 224 bytes.
fn write_headers(form: &AviForm, image: u32, file: &mut dyn Write) -> Result<()> {
    let (width, height, count) = (form.width as u32, form.height as u32, form.frames as u32);
    let hertz = form.hertz;
    let rate = if hertz > 0.0 { (hertz * f64::from(RATE_SCALE)).round().clamp(1.0, 1e9) as u32 } else { RATE_SCALE };
    let microseconds = (1e6 * f64::from(RATE_SCALE) / f64::from(rate)).round() as u32;
    let movi = 4 + count * (image + 8);
    chunk(file, *b"RIFF", HEADER as u32 - 8 + movi - 4 + 8 + count * 16)?;
    file.write_all(b"AVI ")?;
    list(file, *b"hdrl", 192)?;
    chunk(file, *b"avih", 56)?;
    /// The file carries an index.
    const HAS_INDEX: u32 = 0x10;
    numbers(file, &[microseconds, 0, 0, HAS_INDEX, count, 0, 1, image, width, height, 0, 0, 0, 0])?;
    list(file, *b"strl", 116)?;
    chunk(file, *b"strh", 56)?;
    file.write_all(b"vidsDIB ")?;
    numbers(file, &[0, 0, 0, RATE_SCALE, rate, 0, count, image, u32::MAX, 0, 0])?;
    let corner = |size: u32| (size.min(u32::from(u16::MAX)) as u16).to_le_bytes();
    file.write_all(&corner(width))?;
    file.write_all(&corner(height))?;
    chunk(file, *b"strf", 40)?;
    numbers(file, &[40, width, height])?;
    file.write_all(&[1, 0, 24, 0])?;
    numbers(file, &[0, image, 0, 0, 0, 0])?;
    list(file, *b"movi", movi)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use heartian_space::Sequence;

    use super::*;

    /// Walks the chunks as a reader would and finds every pixel where it belongs.
    #[test]
    fn a_clip_is_found_again_chunk_by_chunk() {
        let (width, height, count) = (3, 2, 3);
        let frames: Vec<u8> = (0..width * height * 3 * count).map(|value| value as u8 + 1).collect();
        let sequence = Sequence {
            frames: frames.clone(),
            alpha: vec![255; width * height * count],
            times_seconds: vec![0.0, 0.04, 0.08],
        };
        let clip = Clip::new("x", width, height, sequence).unwrap();
        let mut bytes = Vec::new();
        write_clip(&clip, &mut bytes).unwrap();
        assert_eq!(bytes.len() as u64, AviForm::of(&clip).size().unwrap());
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], &bytes[8..12], word(4) + 8), (&b"RIFF"[..], &b"AVI "[..], bytes.len()));
        let header_end = 12 + 8 + word(16);
        assert_eq!(
            (&bytes[header_end..header_end + 4], &bytes[header_end + 8..header_end + 12]),
            (&b"LIST"[..], &b"movi"[..])
        );
        let movi = header_end + 8;
        let index = movi + word(header_end + 4);
        assert_eq!((&bytes[index..index + 4], word(index + 4)), (&b"idx1"[..], 16 * count));
        assert_eq!(index + 8 + 16 * count, bytes.len());
        assert_eq!((word(128), word(132)), (1000, 25000), "25 frames per second");
        for frame in 0..count {
            let at = movi + word(index + 8 + 16 * frame + 8);
            assert_eq!(&bytes[at..at + 4], b"00db");
            for y in 0..height {
                for x in 0..width {
                    let pixel = at + 8 + (height - 1 - y) * 12 + 3 * x;
                    let source = ((frame * height + y) * width + x) * 3;
                    let bgr = [frames[source + 2], frames[source + 1], frames[source]];
                    assert_eq!(bytes[pixel..pixel + 3], bgr);
                }
            }
        }
    }

    #[test]
    fn one_frame_has_a_rate_and_a_giant_has_no_size() {
        let sequence = Sequence { frames: vec![0; 3], alpha: vec![0], times_seconds: vec![0.0] };
        let clip = Clip::new("x", 1, 1, sequence).unwrap();
        let mut bytes = Vec::new();
        write_clip(&clip, &mut bytes).unwrap();
        assert_eq!(bytes.len() as u64, AviForm::of(&clip).size().unwrap());
        let mut bytes = Vec::new();
        let mut writer = AviWriter::begin(&mut bytes, AviForm::of(&clip)).unwrap();
        assert!(writer.frame(&[0; 6]).is_err());
        writer.frame(&[0; 3]).unwrap();
        assert!(writer.frame(&[0; 3]).is_err());
        let giant = Clip { width: 1 << 20, height: 1 << 20, ..clip };
        assert_eq!(AviForm::of(&giant).size(), None);
        assert!(write_clip(&giant, &mut Vec::new()).is_err());
    }
}
