//! Gaussians in the standard 3D Gaussian splatting `.ply` (SH degree 0), out and in.
//!
//! Properties: x y z, nx ny nz (zeros, which viewers expect), f_dc_0‥2 (colour = ½ + 0.2820948·f_dc), opacity (logit),
//! scale_0‥2 (natural log), rot_0‥3 (w x y z), all float, binary little-endian. Reading takes more; see `ply/read.rs`.

mod read;

use crate::error::{SplatError, expect_length};
use crate::gaussians::RawGaussians;
use std::io::Write;
use std::path::Path;

/// The constant spherical harmonic, `½·√(1/π)`.
const SH_CONSTANT: f32 = 0.282_094_8;
/// The properties in the order that other programs write.
const NAMES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// Reads a scene; numbers that are not finite are read as they are, and not drawn later.
///
/// # Errors
/// When the file cannot be read, is no ply of Gaussians, or is cut short.
pub fn read_ply(path: &Path) -> Result<RawGaussians, SplatError> {
    let fail = |reason: String| SplatError::File { path: path.display().to_string(), reason };
    let file = std::fs::File::open(path).map_err(|e| fail(e.to_string()))?;
    read::parse(&mut std::io::BufReader::with_capacity(1 << 18, file)).map_err(fail)
}

/// Writes a scene.
///
/// # Errors
/// When the scene's arrays disagree or the file cannot be written.
pub fn write_ply(path: &Path, scene: &RawGaussians) -> Result<(), SplatError> {
    let n = scene.means.len();
    for (what, found) in [
        ("the scene's log scales", scene.log_scales.len()),
        ("the scene's rotations", scene.rotations.len()),
        ("the scene's logits", scene.logits.len()),
        ("the scene's colours", scene.colors.len()),
    ] {
        expect_length(what, n, found)?;
    }
    let fail = |e: std::io::Error| SplatError::File { path: path.display().to_string(), reason: e.to_string() };
    let mut out = std::io::BufWriter::new(std::fs::File::create(path).map_err(fail)?);
    write(scene, &mut out).and_then(|()| out.flush()).map_err(fail)
}

/// The bytes of a scene's file.
pub fn ply_bytes(scene: &RawGaussians) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1024 + scene.means.len() * NAMES.len() * size_of::<f32>());
    // Writing to memory cannot fail.
    let _ = write(scene, &mut bytes);
    bytes
}

fn write(scene: &RawGaussians, out: &mut impl Write) -> std::io::Result<()> {
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", scene.means.len())?;
    for name in NAMES {
        writeln!(out, "property float {name}")?;
    }
    out.write_all(b"end_header\n")?;
    for i in 0..scene.means.len() {
        let dc = scene.colors[i].map(|c| (c - 0.5) / SH_CONSTANT);
        let row = [&scene.means[i][..], &[0.0; 3], &dc, &[scene.logits[i]], &scene.log_scales[i], &scene.rotations[i]];
        for value in row.into_iter().flatten() {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
