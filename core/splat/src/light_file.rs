//! Light pictures from files: Radiance `.hdr` (RGBE) and OpenEXR `.exr`, as linear RGB. What a file is, its first bytes
//! say; sizes are checked before anything is allocated.

mod rgbe;

use crate::error::SplatError;
use std::path::Path;

/// Longest side that is read.
const MOST_PIXELS_A_SIDE: usize = 16_384;

/// A linear-light RGB picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightImage {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// `height × width × 3`, interleaved, top row first.
    pub data: Vec<f32>,
}

/// Reads a light picture, by what the file's first bytes say it is.
///
/// # Errors
/// When the file cannot be read, is neither format, is damaged, or is larger than 16384 pixels a side.
pub fn light_from_file(path: &Path) -> Result<LightImage, SplatError> {
    let fail = |reason: String| SplatError::Light { path: path.display().to_string(), reason };
    let bytes = std::fs::read(path).map_err(|e| fail(e.to_string()))?;
    parse(&bytes).map_err(fail)
}

fn parse(bytes: &[u8]) -> Result<LightImage, String> {
    if bytes.starts_with(b"#?") {
        rgbe::parse(bytes)
    } else if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        parse_exr(bytes)
    } else {
        Err("it is neither a Radiance .hdr nor an OpenEXR file; convert it to one of these".into())
    }
}

/// Width and height as sizes, when they can be read.
fn checked_size(width: usize, height: usize) -> Result<[usize; 2], String> {
    if width == 0 || height == 0 || width > MOST_PIXELS_A_SIDE || height > MOST_PIXELS_A_SIDE {
        return Err(format!("its size {width}×{height} is not between 1 and {MOST_PIXELS_A_SIDE} pixels a side"));
    }
    Ok([width, height])
}

fn parse_exr(bytes: &[u8]) -> Result<LightImage, String> {
    use exr::prelude::{MetaData, ReadChannels, ReadLayers, read};
    let damaged = |e: exr::error::Error| format!("it is damaged or of an unsupported kind: {e}");
    let meta = MetaData::read_from_buffered(std::io::Cursor::new(bytes), false).map_err(damaged)?;
    for header in &meta.headers {
        checked_size(header.layer_size.width(), header.layer_size.height())?;
    }
    let picture = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| LightImage { width: size.width(), height: size.height(), data: vec![0.0; 3 * size.area()] },
            |image: &mut LightImage, at, (r, g, b): (f32, f32, f32)| {
                let i = 3 * (at.y() * image.width + at.x());
                image.data[i..i + 3].copy_from_slice(&[r, g, b]);
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(std::io::Cursor::new(bytes))
        .map_err(damaged)?;
    Ok(picture.layer_data.channel_data.pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exr_files_are_read_and_damage_is_named() -> Result<(), Box<dyn std::error::Error>> {
        use exr::prelude::*;
        let value = |x: usize, y: usize| (x as f32 * 0.5, y as f32 + 0.25, 1000.0 * x as f32);
        let mut bytes = std::io::Cursor::new(Vec::new());
        Image::from_channels((5, 3), SpecificChannels::rgb(|at: Vec2<usize>| value(at.x(), at.y())))
            .write()
            .to_buffered(&mut bytes)?;
        let bytes = bytes.into_inner();
        let image = parse(&bytes)?;
        assert_eq!((image.width, image.height), (5, 3));
        for y in 0..3 {
            for x in 0..5 {
                let (r, g, b) = value(x, y);
                assert_eq!(image.data[3 * (y * 5 + x)..][..3], [r, g, b]);
            }
        }
        for cut in [4, 20, bytes.len() / 2] {
            assert!(parse(&bytes[..cut]).is_err());
        }
        assert!(parse(b"PNG").is_err_and(|e| e.contains("neither")));
        assert!(light_from_file(Path::new("/nowhere/light.hdr")).is_err());
        Ok(())
    }
}
