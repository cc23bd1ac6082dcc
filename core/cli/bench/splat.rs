//! `heartian bench splat`: a frame's milliseconds and errors. One scene from files, or a sweep over splats, resolution,
//! precision and device on scenes made here.

mod device;
mod files;
mod scene;
mod single;
mod sweep;
mod timing;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use heartian_splat::Device;
use miette::{IntoDiagnostic, Result, miette};

/// What is measured, and on what.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian bench splat                                     made scenes: splats × resolution × precision, with two plots
  heartian bench splat --ply head.ply --camera camera.json one scene, RGB, then ten channels with shading
  heartian bench splat --ply head.ply --camera camera.json --weights w.npy --image image.npy --grads grads.npz

The camera is JSON: width, height, fx, fy, cx, cy and w2c, the 4×4 matrix to the camera (x right, y down, z forward).
Gradients are those of the sum of image × weights (weights.npy, height × width × 3; ones without it) with respect to
means, log_scales, quats, logit and rgb, in arrays of those names. The image is height × width × 3, over black.
HEARTIAN_SIMD=baseline|avx2|avx512 holds the lanes back to that level.")]
pub struct SplatBench {
    /// The scene: a 3D Gaussian splatting .ply
    #[arg(long, value_name = "FILE", requires = "camera")]
    ply: Option<PathBuf>,
    /// Its camera, JSON
    #[arg(long, value_name = "FILE", requires = "ply")]
    camera: Option<PathBuf>,
    /// Weight of every value of the image in the loss, .npy
    #[arg(long, value_name = "FILE", requires = "ply")]
    weights: Option<PathBuf>,
    /// Threads [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// auto, cpu or gpu; auto takes a GPU only when it is a real one
    #[arg(long, value_name = "DEVICE", default_value_t = Device::Cpu)]
    device: Device,
    /// Write the image here, .npy
    #[arg(long, value_name = "FILE", requires = "ply")]
    image: Option<PathBuf>,
    /// Write the gradients here, .npz
    #[arg(long, value_name = "FILE", requires = "ply")]
    grads: Option<PathBuf>,
    /// Runs of each; the shortest and the middle one are told
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    runs: u16,
    /// Print one JSON object and nothing else
    #[arg(long)]
    json: bool,
    /// Folder of the sweep's plots
    #[arg(long, value_name = "DIR", default_value = "runs/bench-splat")]
    out: PathBuf,
}

/// Measures.
pub fn run(arguments: &SplatBench) -> Result<ExitCode> {
    let threads = arguments.threads.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().into_diagnostic()?;
    // Inside the pool, so that no call has to wake a thread from outside it.
    let (text, json) = pool.install(|| match (&arguments.ply, &arguments.camera) {
        (Some(ply), Some(camera)) => single::run(arguments, ply, camera),
        _ => sweep::run(arguments),
    })?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&json).into_diagnostic()?);
    } else {
        print!("{text}");
    }
    Ok(ExitCode::SUCCESS)
}

/// An error about a file, with its path.
fn about(path: &std::path::Path, reason: impl std::fmt::Display) -> miette::Report {
    miette!("{}: {reason}", path.display())
}
