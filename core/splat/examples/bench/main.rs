//! Times the rasteriser on a scene in the form of a `.ply` and a `camera.json`, and holds it against f64 references
//! when they lie beside them: `bench DIRECTORY TAG [CHANNELS]`, e.g. `bench ../shared/peers/splat 20k 3`.

mod peers;

use heartian_space::Camera;
use heartian_splat::{
    FrameGradient, Gaussians, RasterOptions, RawGaussians, backward, composite, prepare, read_ply, simd_level,
};
use peers::{Fallible, planar, read_camera, read_npy, read_npz};
use std::path::Path;
use std::time::Instant;

/// CPU time of all threads so far, milliseconds; 0 where the system does not tell.
fn cpu_ms() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let times = tasks.filter_map(|t| std::fs::read_to_string(t.path().join("schedstat")).ok());
    times.filter_map(|t| t.split(' ').next().and_then(|ns| ns.parse::<f64>().ok())).sum::<f64>() / 1e6
}

/// Minimum and median of `runs` timings, and CPU time of one run, milliseconds.
fn timed(runs: usize, mut f: impl FnMut()) -> String {
    let before = cpu_ms();
    let mut ms: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            f();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    ms.sort_by(f64::total_cmp);
    format!("{:7.2} {:7.2} ms   cpu {:7.2} ms", ms[0], ms[runs / 2], (cpu_ms() - before) / runs as f64)
}

fn main() -> Fallible<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let directory = Path::new(arguments.first().map_or("../shared/peers/splat", String::as_str));
    let tag = arguments.get(1).map_or("20k", String::as_str);
    let channels: usize = arguments.get(2).map_or(Ok(3), |c| c.parse())?;
    let raw = read_ply(&directory.join(format!("head_{tag}.ply")))?;
    let camera = read_camera(&directory.join("camera.json"))?;
    let activated = raw.activate();
    let own = raw.view(&activated);
    let features: Vec<f32> =
        (0..own.len()).flat_map(|i| (0..channels).map(move |c| (i, c))).map(|(i, c)| raw.colors[i][c % 3]).collect();
    let scene = Gaussians { features: &features, channels, ..own };
    let options = RasterOptions { near_metres: 0.01, ..RasterOptions::default() };
    let weights = planar(&read_npy(&std::fs::read(directory.join("weights.npy"))?)?, 3);
    let pixels = camera.width * camera.height;
    let planar: Vec<f32> = (0..channels * pixels).map(|i| weights[i % weights.len()] as f32).collect();
    let gradient = FrameGradient { planes: &planar, ..FrameGradient::default() };

    let prepared = prepare(&scene, &camera, &options)?;
    let frame = composite(&prepared);
    println!(
        "{tag}, {channels} channels, {:?}, {} threads, {} drawn, {} entries",
        simd_level(),
        rayon::current_num_threads(),
        prepared.drawn(),
        prepared.entries()
    );
    let runs = 40;
    let t = timed(runs, || drop(prepare(&scene, &camera, &options)));
    println!("prepare           {t}");
    let t = timed(runs, || drop(composite(&prepared)));
    println!("composite         {t}");
    let t = timed(runs, || drop(backward(&scene, &prepared, &frame, &gradient)));
    println!("backward          {t}");
    let t = timed(runs, || drop(prepare(&scene, &camera, &options).map(|p| composite(&p))));
    println!("forward           {t}");
    let t = timed(runs, || {
        let _ = prepare(&scene, &camera, &options).and_then(|p| {
            let frame = composite(&p);
            backward(&scene, &p, &frame, &gradient)
        });
    });
    println!("forward+backward  {t}");
    if channels == 3 {
        compare(directory, tag, &raw, &frame.planes, &planar, &camera, &options)?;
    }
    Ok(())
}

/// Largest image error and relative L2 error of each gradient against the f64 references.
fn compare(
    directory: &Path,
    tag: &str,
    raw: &RawGaussians,
    planes: &[f32],
    weights: &[f32],
    camera: &Camera,
    options: &RasterOptions,
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
