//! Reads the shared scenes' camera, `.npy` arrays and uncompressed `.npz` archives: just what the references use.

use heartian_space::Camera;
use std::path::Path;

/// What this file's functions return.
pub type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// The camera of a scene.
pub fn read_camera(path: &Path) -> Fallible<Camera> {
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(path)?)?;
    let number = |value: &serde_json::Value| value.as_f64().map(|v| v as f32).ok_or("the camera lacks a number");
    let mut camera = Camera::at_origin(number(&json["width"])? as usize, number(&json["height"])? as usize, 1.0);
    camera.focal_px = [number(&json["fx"])?, number(&json["fy"])?];
    camera.principal_px = [number(&json["cx"])?, number(&json["cy"])?];
    for row in 0..3 {
        for column in 0..3 {
            camera.rotation[column][row] = number(&json["w2c"][row][column])?;
        }
        camera.translation[row] = number(&json["w2c"][row][3])?;
    }
    Ok(camera)
}

/// All values of a little-endian f32 or f64 `.npy`.
pub fn read_npy(bytes: &[u8]) -> Fallible<Vec<f64>> {
    if !bytes.starts_with(b"\x93NUMPY\x01") || bytes.len() < 10 {
        return Err("this is not a version 1 .npy".into());
    }
    let end = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = std::str::from_utf8(bytes.get(10..end).ok_or("cut short")?)?;
    let shape = header.split("'shape': (").nth(1).and_then(|s| s.split(')').next()).ok_or("no shape")?;
    let count = shape.split(',').filter_map(|n| n.trim().parse::<usize>().ok()).product::<usize>();
    let body = &bytes[end..];
    if header.contains("'<f8'") {
        let body = body.get(..8 * count).ok_or("cut short")?;
        Ok(body.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect())
    } else if header.contains("'<f4'") {
        let body = body.get(..4 * count).ok_or("cut short")?;
        Ok(body.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect())
    } else {
        Err("only <f4 and <f8 are read".into())
    }
}

/// One array of an uncompressed `.npz`.
pub fn read_npz(bytes: &[u8], name: &str) -> Fallible<Vec<f64>> {
    let file = format!("{name}.npy");
    let find = |from: usize, what: &[u8]| bytes[from..].windows(what.len()).position(|w| w == what).map(|at| from + at);
    let at = find(0, file.as_bytes()).and_then(|at| find(at, b"\x93NUMPY")).ok_or("no such array")?;
    read_npy(&bytes[at..])
}

/// `height × width × channels` as planes.
pub fn planar(interleaved: &[f64], channels: usize) -> Vec<f64> {
    let pixels = interleaved.len() / channels;
    (0..interleaved.len()).map(|i| interleaved[channels * (i % pixels) + i / pixels]).collect()
}
