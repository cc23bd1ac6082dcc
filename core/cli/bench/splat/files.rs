//! The camera and the arrays of a scene in files, read and written. Arrays are height × width × channels on disk, planar here.

use std::io::Write;
use std::path::Path;

use heartian_foreign::npy;
use heartian_space::Camera;
use heartian_splat::{RawGaussians, SceneGradients};
use miette::Result;
use zip::CompressionMethod;
use zip::write::{SimpleFileOptions, ZipWriter};

use super::about;

/// Most values of an array that is read: 8192² pixels in three channels.
const MOST_VALUES: usize = 3 << 26;

/// Reads a camera; see the command's help for the form.
pub fn read_camera(path: &Path) -> Result<Camera> {
    let bytes = std::fs::read(path).map_err(|error| about(path, error))?;
    let json: serde_json::Value = serde_json::from_slice(&bytes).map_err(|error| about(path, error))?;
    let number = |value: &serde_json::Value, what: &str| {
        value.as_f64().map(|v| v as f32).ok_or_else(|| about(path, format!("the camera's {what} is no number")))
    };
    let side = |what: &str| match json[what].as_u64() {
        Some(side @ 1..=32_768) => Ok(side as usize),
        _ => Err(about(path, format!("the camera's {what} is no whole number from 1 to 32768"))),
    };
    let mut camera = Camera::at_origin(side("width")?, side("height")?, 1.0);
    camera.focal_px = [number(&json["fx"], "fx")?, number(&json["fy"], "fy")?];
    camera.principal_px = [number(&json["cx"], "cx")?, number(&json["cy"], "cy")?];
    for row in 0..3 {
        for column in 0..3 {
            camera.rotation[column][row] = number(&json["w2c"][row][column], "w2c")?;
        }
        camera.translation[row] = number(&json["w2c"][row][3], "w2c")?;
    }
    Ok(camera)
}

/// Reads a `.npy` of `height × width × 3` values as planes.
pub fn read_picture(path: &Path, camera: &Camera) -> Result<Vec<f32>> {
    let bytes = std::fs::read(path).map_err(|error| about(path, error))?;
    let array = npy::array(&bytes, MOST_VALUES).map_err(|error| about(path, error))?;
    let wanted = [camera.height, camera.width, 3];
    if array.shape != wanted {
        return Err(about(path, format!("its shape is {:?}; the camera's picture is {wanted:?}", array.shape)));
    }
    let pixels = camera.height * camera.width;
    Ok((0..3 * pixels).map(|i| array.values[3 * (i % pixels) + i / pixels] as f32).collect())
}

/// Writes planes as a `.npy` of `height × width × channels`.
pub fn write_picture(path: &Path, planes: &[f32], camera: &Camera) -> Result<()> {
    let pixels = camera.width * camera.height;
    let channels = planes.len() / pixels;
    let values = (0..planes.len()).map(|i| planes[i % channels * pixels + i / channels]);
    let bytes = npy_bytes(&[camera.height, camera.width, channels], values);
    std::fs::write(path, bytes).map_err(|error| about(path, error))
}

/// A `.npy` file (version 1) of f32, rows first.
fn npy_bytes(shape: &[usize], values: impl Iterator<Item = f32>) -> Vec<u8> {
    let shape: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", shape.trim_end());
    // The header ends with a line feed on a multiple of 64 bytes.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.flat_map(f32::to_le_bytes));
    bytes
}

/// Gradients by name, with the number of values a Gaussian.
pub fn named(gradients: &SceneGradients) -> [(&'static str, &[f32], usize); 5] {
    [
        ("means", gradients.means.as_flattened(), 3),
        ("log_scales", gradients.scales.as_flattened(), 3),
        ("quats", gradients.rotations.as_flattened(), 4),
        ("logit", &gradients.opacities, 1),
        ("rgb", &gradients.features, 3),
    ]
}

/// Writes gradients (already those of log scales and logits) as an `.npz`.
pub fn write_gradients(path: &Path, scene: &RawGaussians, gradients: &SceneGradients) -> Result<()> {
    let n = scene.means.len();
    let write = || -> zip::result::ZipResult<()> {
        let mut archive = ZipWriter::new(std::io::BufWriter::new(std::fs::File::create(path)?));
        for (name, values, width) in named(gradients) {
            let shape = if width == 1 { vec![n] } else { vec![n, width] };
            let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
            archive.start_file(format!("{name}.npy"), options)?;
            archive.write_all(&npy_bytes(&shape, values.iter().copied()))?;
        }
        archive.finish()?.flush()?;
        Ok(())
    };
    write().map_err(|error| about(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back() {
        let camera = Camera::at_origin(3, 2, 4.0);
        let planes: Vec<f32> = (0..18).map(|i| i as f32 * 0.5).collect();
        let path = std::env::temp_dir().join(format!("heartian-picture-{}.npy", std::process::id()));
        write_picture(&path, &planes, &camera).unwrap_or_else(|e| panic!("{e}"));
        let back = read_picture(&path, &camera);
        let turned = read_picture(&path, &Camera::at_origin(2, 3, 4.0));
        std::fs::remove_file(&path).ok();
        assert_eq!(back.unwrap_or_default(), planes);
        assert!(turned.is_err_and(|e| e.to_string().contains("shape")));
        let bytes = npy_bytes(&[2], [1.0, f32::NAN].into_iter());
        assert!(bytes.len() == 128 + 8 && bytes[..128].ends_with(b"\n"));
    }
}
