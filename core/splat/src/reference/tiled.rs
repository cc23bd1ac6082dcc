//! The compositing of `composite.rs` with each pixel looking only at the Gaussians whose region of alpha ≥ 1/255 may reach
//! its tile: the same values bit for bit, in reasonable time. The f64 row of the benchmark, and its reference.

use super::Scene;
use super::composite::{Picture, Visible, draw, visible};
use crate::project::RasterOptions;
use heartian_space::Camera;

/// Side of a tile, pixels.
const TILE: usize = 16;

/// The picture of a scene; [`super::composite::composite`] without the waste.
pub fn composite(scene: &Scene, camera: &Camera, options: &RasterOptions) -> Picture {
    let splats = visible(scene, camera, options);
    let (columns, rows) = (camera.width.div_ceil(TILE), camera.height.div_ceil(TILE));
    let mut tiles: Vec<Vec<Visible>> = vec![Vec::new(); columns * rows];
    for &(i, projected) in &splats {
        // Half-extents of the region of alpha ≥ 1/255, a pixel wider.
        let reach = 2.0 * (255.0 * scene.opacities[i].min(1.0)).max(1.0).ln();
        let half = [0, 2].map(|k| (reach * projected.covariance[k]).sqrt() + 1.0);
        let range = |k: usize, tiles: usize| {
            let tile = |at: f64| (at / TILE as f64).floor().clamp(-1.0, tiles as f64);
            let (from, to) = (tile(projected.mean[k] - half[k]), tile(projected.mean[k] + half[k]));
            from.max(0.0) as usize..(to + 1.0).clamp(0.0, tiles as f64) as usize
        };
        for row in range(1, rows) {
            for column in range(0, columns) {
                tiles[row * columns + column].push((i, projected));
            }
        }
    }
    let mut out = Picture::empty(scene.channels, camera);
    for at in 0..camera.width * camera.height {
        let (x, y) = (at % camera.width, at / camera.width);
        draw(scene, &tiles[y / TILE * columns + x / TILE], at, camera.width, &mut out);
    }
    out
}
