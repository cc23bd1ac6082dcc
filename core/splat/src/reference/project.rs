//! EWA projection in f64 with plain matrices: the specification of `project.rs`.

use super::Scene;
use crate::project::{FRUSTUM_MARGIN, RasterOptions};
use heartian_space::Camera;

/// A projected Gaussian: centre in pixels, 2-D covariance (xx, xy, yy) with the low-pass, camera-space z.
#[derive(Clone, Copy, Debug, Default)]
pub struct Projected {
    /// Centre, pixels.
    pub mean: [f64; 2],
    /// Covariance xx, xy, yy, square pixels.
    pub covariance: [f64; 3],
    /// Depth, metres.
    pub depth: f64,
}

type Matrix = [[f64; 3]; 3];

/// Camera-from-world rotation, row by row.
fn world_rows(camera: &Camera) -> Matrix {
    [0, 1, 2].map(|row| [0, 1, 2].map(|column| f64::from(camera.rotation[column][row])))
}

/// Rotation matrix (rows) of a quaternion that need not be of unit norm.
pub fn rotation_matrix(q: [f64; 4]) -> [[f64; 3]; 3] {
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = if norm > 0.0 { q.map(|v| v / norm) } else { [1.0, 0.0, 0.0, 0.0] };
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

/// The scene's Gaussian `i` in the picture; `None` where it is not in front of the near plane.
pub fn project(scene: &Scene, i: usize, camera: &Camera, options: &RasterOptions) -> Option<Projected> {
    let w = world_rows(camera);
    let mean = scene.means[i];
    let p = [0, 1, 2].map(|r| (0..3).map(|k| w[r][k] * mean[k]).sum::<f64>() + f64::from(camera.translation[r]));
    if p[2] <= f64::from(options.near_metres) {
        return None;
    }
    let size = [camera.width as f64, camera.height as f64];
    let (f, c) = (camera.focal_px.map(f64::from), camera.principal_px.map(f64::from));
    let slope = [0, 1].map(|k| {
        let margin = f64::from(FRUSTUM_MARGIN) * 0.5 * size[k] / f[k];
        (p[k] / p[2]).clamp(-c[k] / f[k] - margin, (size[k] - c[k]) / f[k] + margin)
    });
    // J·W·R·diag(s), three rows of which the last is zero.
    let j = [[f[0] / p[2], 0.0, -f[0] * slope[0] / p[2]], [0.0, f[1] / p[2], -f[1] * slope[1] / p[2]], [0.0; 3]];
    let r = rotation_matrix(scene.rotations[i]);
    let rs = r.map(|row| [0, 1, 2].map(|k| row[k] * scene.scales[i][k]));
    let a = multiply(&multiply(&j, &w), &rs);
    let dot = |m: usize, n: usize| (0..3).map(|k| a[m][k] * a[n][k]).sum::<f64>();
    let low_pass = f64::from(options.low_pass_px2);
    Some(Projected {
        mean: [0, 1].map(|k| f[k] * p[k] / p[2] + c[k]),
        covariance: [dot(0, 0) + low_pass, dot(0, 1), dot(1, 1) + low_pass],
        depth: p[2],
    })
}
