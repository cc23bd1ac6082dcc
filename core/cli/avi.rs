//! Clips as raw AVI: uncompressed BGR24, bottom row first, rows padded to four bytes, one index chunk.
//!
//! The person is shown over black, as the matte says. Players and every video tool read this form, and no pixel is lost.

use std::io::{Result, Write};

use heartian_space::Clip;

/// `RIFF` sizes are 32-bit.
const LIMIT: u64 = u32::MAX as u64;
/// Bytes of the headers before the `movi` list's chunks.
const HEADER: u64 = 224;
/// Frame rates are written as a fraction over this.
const RATE_SCALE: u32 = 1000;

fn stride(clip: &Clip) -> u64 {
    (clip.width as u64 * 3).next_multiple_of(4)
}

/// The file's size in bytes; nothing when AVI cannot hold it.
pub fn size(clip: &Clip) -> Option<u64> {
    let frame = stride(clip).checked_mul(clip.height as u64)?.checked_add(8 + 16)?;
    let total = frame.checked_mul(clip.len() as u64)?.checked_add(HEADER + 8)?;
    let fits = total <= LIMIT && i32::try_from(clip.width).is_ok() && i32::try_from(clip.height).is_ok();
    fits.then_some(total)
}

/// Writes the clip; [`size`] must have given one.
pub fn write(clip: &Clip, file: &mut dyn Write) -> Result<()> {
    let image = (stride(clip) * clip.height as u64) as u32;
    let count = clip.len() as u32;
    write_headers(clip, image, file)?;
    let mut rows = vec![0u8; image as usize];
    for index in 0..clip.len() {
        let picture = clip.image_over_black(index);
        let lines = picture.data.chunks_exact(clip.width * 3).rev();
        for (to, from) in rows.chunks_exact_mut(stride(clip) as usize).zip(lines) {
            for (to, from) in to.chunks_exact_mut(3).zip(from.chunks_exact(3)) {
                to.copy_from_slice(&[from[2], from[1], from[0]]);
            }
        }
        chunk(file, *b"00db", image)?;
        file.write_all(&rows)?;
    }
    chunk(file, *b"idx1", count * 16)?;
    for index in 0..count {
        /// Every frame can be decoded alone.
        const KEY_FRAME: u32 = 0x10;
        file.write_all(b"00db")?;
        numbers(file, &[KEY_FRAME, 4 + index * (image + 8), image])?;
    }
    Ok(())
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
fn write_headers(clip: &Clip, image: u32, file: &mut dyn Write) -> Result<()> {
    let (width, height, count) = (clip.width as u32, clip.height as u32, clip.len() as u32);
    let hertz = clip.frame_rate_hertz();
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
        write(&clip, &mut bytes).unwrap();
        assert_eq!(bytes.len() as u64, size(&clip).unwrap());
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
        write(&clip, &mut bytes).unwrap();
        assert_eq!(bytes.len() as u64, size(&clip).unwrap());
        let giant = Clip { width: 1 << 20, height: 1 << 20, ..clip };
        assert_eq!(size(&giant), None);
    }
}
