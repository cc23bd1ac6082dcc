//! Scenes that the sweep makes: a head-like shell of flat Gaussians, the same for the same number, in front of a camera
//! with a field of view of 20°. World metres, x right, y up, z towards the viewer.

use heartian_space::Camera;
use heartian_splat::RawGaussians;

/// Semi-axes of the shell, metres.
const AXES: [f32; 3] = [0.09, 0.12, 0.10];
/// Share of the picture's height that it fills.
const FILLED: f32 = 0.7;

/// A camera `side × side` that looks at the origin.
pub fn camera(side: usize) -> Camera {
    let focal = 0.5 * side as f32 / 10f32.to_radians().tan();
    let mut camera = Camera::at_origin(side, side, focal);
    // The camera looks along −z; the shell is put in front of it by `shell`.
    camera.principal_px = [0.5 * side as f32; 2];
    camera
}

/// `n` Gaussians whose size shrinks as their number grows, so that they cover the shell alike.
pub fn shell(n: usize) -> RawGaussians {
    let mut state = 0x9E37_79B9_7F4A_7C15u64 ^ n as u64;
    let mut unit = move || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f32 / 16_777_216.0
    };
    let distance = 2.0 * AXES[1] / FILLED / (2.0 * 10f32.to_radians().tan());
    let size = 0.002 * (20_000.0 / n.max(1) as f32).sqrt();
    let mut scene = RawGaussians::default();
    for _ in 0..n {
        let (z, turn) = (2.0 * unit() - 1.0, std::f32::consts::TAU * unit());
        let side = (1.0 - z * z).max(0.0).sqrt();
        let d = [side * turn.cos(), side * turn.sin(), z];
        let bump = 1.0 + 0.03 * (5.0 * d[0] + 1.0).sin() * (4.0 * d[1]).cos() + 0.01 * (unit() - 0.5);
        let mean = [0, 1, 2].map(|k| d[k] * AXES[k] * bump);
        scene.means.push([mean[0], mean[1], mean[2] - distance]);
        let spread = |u: f32| (size * (1.4 * (u - 0.5)).exp()).ln();
        scene.log_scales.push([spread(unit()), spread(unit()), spread(unit()) - 1.4]);
        // The turn that takes z to the shell's normal, of no particular length.
        let normal = [0, 1, 2].map(|k| d[k] / AXES[k]);
        let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-9);
        let [nx, ny, nz] = normal.map(|v| v / length);
        scene.rotations.push([1.0 + nz + 1e-4, -ny, nx, 0.3 * (unit() - 0.5)]);
        scene.logits.push(8.0 * unit() - 2.0);
        let shade = 0.85 + 0.15 * (40.0 * (mean[0] + 0.4 * mean[1])).sin();
        scene
            .colors
            .push([0.78 * shade, 0.58 * shade, 0.48 * shade].map(|c| (c + 0.1 * (unit() - 0.5)).clamp(0.02, 0.98)));
    }
    scene
}
