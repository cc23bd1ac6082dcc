//! Gaussians in the standard 3D Gaussian splatting `.ply` (binary little-endian, SH degree 0), in and out.
//!
//! Properties: x y z, f_dc_0‥2 (colour = ½ + 0.2820948·f_dc), opacity (logit), scale_0‥2 (natural log), rot_0‥3 (w x y z).
//! Others are skipped on reading; nx ny nz are written as zeros because viewers expect them.

use crate::error::SplatError;
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
const HEADER_MOST_BYTES: usize = 65_536;

/// Reads a scene.
///
/// # Errors
/// When the file cannot be read, is not a binary little-endian ply, lacks a property or is cut short.
pub fn read_ply(path: &Path) -> Result<RawGaussians, SplatError> {
    let fail = |reason: String| SplatError::File { path: path.display().to_string(), reason };
    let bytes = std::fs::read(path).map_err(|e| fail(e.to_string()))?;
    parse(&bytes).map_err(fail)
}

/// Writes a scene.
///
/// # Errors
/// When the file cannot be written.
pub fn write_ply(path: &Path, scene: &RawGaussians) -> Result<(), SplatError> {
    let fail = |e: std::io::Error| SplatError::File { path: path.display().to_string(), reason: e.to_string() };
    let mut out = std::io::BufWriter::new(std::fs::File::create(path).map_err(fail)?);
    out.write_all(&to_bytes(scene)).and_then(|()| out.flush()).map_err(fail)
}

fn to_bytes(scene: &RawGaussians) -> Vec<u8> {
    let mut bytes =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", scene.means.len()).into_bytes();
    for name in NAMES {
        bytes.extend_from_slice(format!("property float {name}\n").as_bytes());
    }
    bytes.extend_from_slice(b"end_header\n");
    for i in 0..scene.means.len() {
        let dc = scene.colors[i].map(|c| (c - 0.5) / SH_CONSTANT);
        let rest = [&scene.means[i][..], &[0.0; 3], &dc, &[scene.logits[i]], &scene.log_scales[i], &scene.rotations[i]];
        for value in rest.into_iter().flatten() {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
    }
    bytes
}

/// Number of vertices, bytes of one vertex, and the offset of each of [`NAMES`] in it.
struct Layout {
    count: usize,
    stride: usize,
    offsets: [Option<usize>; 17],
}

fn parse_header(header: &str) -> Result<Layout, String> {
    let mut layout = Layout { count: 0, stride: 0, offsets: [None; 17] };
    let mut in_vertex = false;
    for line in header.lines().skip(1) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["format", "binary_little_endian", ..] | ["comment" | "obj_info", ..] | [] => {}
            ["format", other, ..] => {
                return Err(format!("format {other} is not read; write it as binary_little_endian"));
            }
            ["element", "vertex", count] => {
                layout.count =
                    count.parse().map_err(|_| format!("a count of vertices, not {count:?}, was expected"))?;
                in_vertex = true;
            }
            ["element", ..] if !in_vertex => return Err("the vertices must be its first element".into()),
            ["element", ..] => in_vertex = false,
            ["property", kind, name] if in_vertex => {
                let size = match *kind {
                    "float" | "float32" | "int" | "uint" | "int32" | "uint32" => 4,
                    "double" | "float64" => 8,
                    "uchar" | "char" | "uint8" | "int8" => 1,
                    "short" | "ushort" | "int16" | "uint16" => 2,
                    other => return Err(format!("property type {other} is not known")),
                };
                if let Some(place) = NAMES.iter().position(|known| known == name) {
                    if !matches!(*kind, "float" | "float32") {
                        return Err(format!("property {name} is {kind}; float is expected"));
                    }
                    layout.offsets[place] = Some(layout.stride);
                }
                layout.stride += size;
            }
            _ => {}
        }
    }
    Ok(layout)
}

fn parse(bytes: &[u8]) -> Result<RawGaussians, String> {
    const END: &[u8] = b"end_header\n";
    if !bytes.starts_with(b"ply") {
        return Err("this is not a ply file".into());
    }
    let head = &bytes[..bytes.len().min(HEADER_MOST_BYTES)];
    let end = head.windows(END.len()).position(|w| w == END).ok_or("its header does not end")?;
    let header = std::str::from_utf8(&bytes[..end]).map_err(|_| "its header is not text")?;
    let layout = parse_header(header)?;
    let body = &bytes[end + END.len()..];
    if layout.count.checked_mul(layout.stride).is_none_or(|wanted| wanted > body.len()) {
        return Err(format!(
            "it is cut short: {} vertices of {} bytes do not fit {}",
            layout.count,
            layout.stride,
            body.len()
        ));
    }
    let mut at = [0; 17];
    for (place, offset) in layout.offsets.iter().enumerate() {
        at[place] = match offset {
            Some(offset) => *offset,
            None if (3..6).contains(&place) => usize::MAX,
            None => return Err(format!("property {} is missing", NAMES[place])),
        };
    }
    let mut scene = RawGaussians::default();
    for vertex in body.chunks_exact(layout.stride.max(1)).take(layout.count) {
        let get = |place: usize| {
            let from = at[place];
            f32::from_le_bytes([vertex[from], vertex[from + 1], vertex[from + 2], vertex[from + 3]])
        };
        scene.means.push([get(0), get(1), get(2)]);
        scene.colors.push([6, 7, 8].map(|place| 0.5 + SH_CONSTANT * get(place)));
        scene.logits.push(get(9));
        scene.log_scales.push([get(10), get(11), get(12)]);
        scene.rotations.push([get(13), get(14), get(15), get(16)]);
    }
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_survives_the_round_trip_and_damage_is_named() {
        let scene = RawGaussians {
            means: vec![[1.0, -2.0, 3.5], [0.0; 3]],
            log_scales: vec![[-5.0, -6.0, -7.0]; 2],
            rotations: vec![[1.0, 0.1, 0.2, 0.3]; 2],
            logits: vec![0.3, -4.0],
            colors: vec![[0.5, 0.25, 0.75]; 2],
        };
        let bytes = to_bytes(&scene);
        let back = parse(&bytes).unwrap_or_default();
        assert_eq!((back.means, back.logits, back.rotations), (scene.means, scene.logits, scene.rotations));
        assert!(back.colors[0].iter().zip(scene.colors[0]).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(parse(&bytes[..bytes.len() - 1]).is_err_and(|e| e.contains("cut short")));
        assert!(parse(b"plx").is_err());
        assert!(parse(b"ply\nformat ascii 1.0\nend_header\n").is_err_and(|e| e.contains("ascii")));
        assert!(
            parse(b"ply\nelement vertex 1\nproperty float x\nend_header\n\0\0\0\0")
                .is_err_and(|e| e.contains("missing"))
        );
        assert!(parse(b"ply\nelement vertex 18446744073709551615\nproperty float x\nend_header\n").is_err());
    }
}
