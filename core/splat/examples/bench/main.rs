//! Times the rasteriser, and a whole fitting step, on a scene in the form of a `.ply` and a `camera.json`, and holds the
//! picture and the gradients against f64 references where they lie beside them.
//!
//! `bench DIRECTORY TAG [CHANNELS]`, e.g. `bench ../shared/peers/splat 20k 3`; the number of threads is rayon's
//! (`RAYON_NUM_THREADS`), the number of runs `RUNS`. Wall times are the least and the median; CPU time is of all threads.

mod peers;
mod step;

use heartian_space::Camera;
use heartian_splat::{
    FrameGradient, Gaussians, RasterOptions, RawGaussians, backward, composite, prepare, read_ply, simd_level,
};
use peers::{Fallible, planar, read_camera, read_npy, read_npz};
use std::path::Path;
use std::time::Instant;

/// Compositing alone, every lane used, one thread of the reference machine: forward and backward, milliseconds.
const FLOOR_MS: [f64; 2] = [2.0, 2.2];

/// CPU time of all threads so far, milliseconds; 0 where the system does not tell.
fn cpu_ms() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let times = tasks.filter_map(|t| std::fs::read_to_string(t.path().join("schedstat")).ok());
    times.filter_map(|t| t.split(' ').next().and_then(|ns| ns.parse::<f64>().ok())).sum::<f64>() / 1e6
}

/// Prints the least and the median of `runs` timings and the CPU time of one run, milliseconds; gives the least.
fn timed(name: &str, runs: usize, mut f: impl FnMut()) -> f64 {
    let before = cpu_ms();
    let mut ms: Vec<f64> = (0..runs.max(1))
        .map(|_| {
            let start = Instant::now();
            f();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    ms.sort_by(f64::total_cmp);
    println!(
        "{name:18} {:7.2} {:7.2} ms   cpu {:7.2} ms",
        ms[0],
        ms[ms.len() / 2],
        (cpu_ms() - before) / ms.len() as f64
    );
    ms[0]
}

fn main() -> Fallible<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let directory = Path::new(arguments.first().map_or("../shared/peers/splat", String::as_str));
    let tag = arguments.get(1).map_or("20k", String::as_str);
    let channels: usize = arguments.get(2).map_or(Ok(3), |c| c.parse())?;
    let runs: usize = std::env::var("RUNS").map_or(Ok(40), |r| r.parse())?;
    let raw = read_ply(&directory.join(format!("head_{tag}.ply")))?;
    let camera = read_camera(&directory.join("camera.json"))?;
    println!("{tag}, {channels} channels, {:?}, {} threads", simd_level(), rayon::current_num_threads());
    raster(directory, tag, &raw, &camera, (channels, runs))?;
    step::time(&raw, &camera.scaled_to(256, 256), runs)
}

fn raster(
    directory: &Path,
    tag: &str,
    raw: &RawGaussians,
    camera: &Camera,
    (channels, runs): (usize, usize),
) -> Fallible<()> {
    let activated = raw.activate();
    let own = raw.view(&activated);
    let features: Vec<f32> = (0..own.len() * channels).map(|i| raw.colors[i / channels][i % channels % 3]).collect();
    let scene = Gaussians { features: &features, channels, ..own };
    let options = RasterOptions { near_metres: 0.01, ..RasterOptions::default() };
    let weights = planar(&read_npy(&std::fs::read(directory.join("weights.npy"))?)?, 3);
    let pixels = camera.width * camera.height;
    let upstream: Vec<f32> = (0..channels * pixels).map(|i| weights[i % weights.len()] as f32).collect();
    let gradient = FrameGradient { planes: &upstream, ..FrameGradient::default() };

    let prepared = prepare(&scene, camera, &options)?;
    let frame = composite(&prepared);
    println!("{} drawn, {} entries", prepared.drawn(), prepared.entries());
    timed("prepare", runs, || drop(prepare(&scene, camera, &options)));
    timed("composite", runs, || drop(composite(&prepared)));
    timed("backward", runs, || drop(backward(&scene, &prepared, &frame, &gradient)));
    let forward = timed("forward", runs, || drop(prepare(&scene, camera, &options).map(|p| composite(&p))));
    let both = timed("forward+backward", runs, || {
        let _ = prepare(&scene, camera, &options).and_then(|p| {
            let frame = composite(&p);
            backward(&scene, &p, &frame, &gradient)
        });
    });
    if tag == "20k" && channels == 3 {
        let threads = rayon::current_num_threads() as f64;
        let ratio = |ms: f64, floor: f64| ms * threads / floor;
        println!(
            "over the floor: forward {:.1}×, both {:.1}×",
            ratio(forward, FLOOR_MS[0]),
            ratio(both, FLOOR_MS[0] + FLOOR_MS[1])
        );
    }
    if channels == 3 {
        compare(directory, tag, raw, (&frame.planes, &upstream), (camera, &options))?;
    }
    Ok(())
}

/// Largest image error and relative L2 error of each gradient against the f64 references.
fn compare(
    directory: &Path,
    tag: &str,
    raw: &RawGaussians,
    (planes, weights): (&[f32], &[f32]),
    (camera, options): (&Camera, &RasterOptions),
) -> Fallible<()> {
    let reference = planar(&read_npy(&std::fs::read(directory.join(format!("ref_{tag}.npy")))?)?, 3);
    let worst = planes.iter().zip(&reference).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
    println!("image: largest error {worst:.2e}");
    let activated = raw.activate();
    let scene = raw.view(&activated);
    let (prepared, frame) = heartian_splat::render(&scene, camera, options)?;
    let mut gradients =
        backward(&scene, &prepared, &frame, &FrameGradient { planes: weights, ..FrameGradient::default() })?;
    RawGaussians::chain(&activated, &mut gradients);
    let archive = std::fs::read(directory.join(format!("ref_grad_{tag}.npz")))?;
    for (name, own) in [
        ("means", gradients.means.as_flattened()),
        ("log_scales", gradients.scales.as_flattened()),
        ("quats", gradients.rotations.as_flattened()),
        ("logit", &gradients.opacities[..]),
        ("rgb", &gradients.features[..]),
    ] {
        let reference = read_npz(&archive, name)?;
        let (mut off, mut whole) = (0.0, 0.0);
        for (a, b) in own.iter().zip(&reference) {
            off += (f64::from(*a) - b).powi(2);
            whole += b * b;
        }
        println!("gradient of {name:10} relative L2 error {:.2e}", (off / whole).sqrt());
    }
    Ok(())
}
