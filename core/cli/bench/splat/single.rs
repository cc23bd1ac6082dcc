//! One scene from files: RGB, then the ten channels of a shaded avatar; image and gradients written on request.

use std::fmt::Write;
use std::path::Path;

use heartian_splat::reference::{Scene, tiled};
use heartian_splat::{
    Device, Environment, FrameGradient, Gaussians, RasterOptions, RawGaussians, SplatError, backward, floor, read_ply,
    render, shade, shade_backward,
};
use miette::{IntoDiagnostic, Result};
use serde_json::{Map, Value, json};

use super::device::{View, rasteriser};
use super::files::{read_camera, read_picture, write_gradients, write_picture};
use super::timing::Timing;
use super::{SplatBench, about};
use crate::summary::table;

/// The references put the near plane here, metres.
pub(super) const NEAR_METRES: f32 = 0.01;

/// Measures the scene; text and JSON of the report.
pub fn run(arguments: &SplatBench, ply: &Path, camera: &Path) -> Result<(String, Value)> {
    let raw = read_ply(ply).into_diagnostic()?;
    let camera = read_camera(camera)?;
    let weights = match &arguments.weights {
        Some(path) => read_picture(path, &camera)?,
        None => vec![1.0; 3 * camera.width * camera.height],
    };
    let view = View { camera, options: RasterOptions { near_metres: NEAR_METRES, ..RasterOptions::default() } };
    let activated = raw.activate();
    let scene = raw.view(&activated);
    let mut rasteriser = rasteriser(arguments.device)?;
    let forward = Timing::of(arguments.runs, || rasteriser.forward(&scene, &view))?;
    let both = Timing::of(arguments.runs, || rasteriser.both(&scene, &view, &weights))?;
    let (frame, mut gradients) = rasteriser.both(&scene, &view, &weights)?;
    RawGaussians::chain(&activated, &mut gradients);
    if let Some(path) = &arguments.image {
        write_picture(path, &frame.planes, &camera)?;
    }
    if let Some(path) = &arguments.grads {
        write_gradients(path, &raw, &gradients)?;
    }
    let exact = tiled::composite(&Scene::new(&scene), &view.camera, &view.options);
    let worst = frame.planes.iter().zip(&exact.planes).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
    let mut report = Report { text: String::new(), json: Map::new() };
    let size = format!("{}×{}", camera.width, camera.height);
    report.line(&format!("{}: {} Gaussians, {size}, {}", ply.display(), raw.means.len(), rasteriser.name()));
    report.line(&format!("{} (Gaussian, pixel) pairs composited", exact.pairs));
    report.value("gaussians", json!(raw.means.len()));
    report.value("device", json!(rasteriser.name()));
    report.value("pairs", json!(exact.pairs));
    report.value("image.max_error", json!(worst));
    let mut rows = vec![["", "forward, ms min / median", "forward + backward"].map(str::to_owned).to_vec()];
    rows.push(vec!["RGB".into(), forward.text(), both.text()]);
    if let Some([forward, both]) = rasteriser.resident(arguments.runs)? {
        let ms = |seconds: f64| format!("{:.2} mean", 1e3 * seconds);
        rows.push(vec!["RGB, all on the device".into(), ms(forward), ms(both)]);
        report.value("resident.forward_ms", json!(1e3 * forward));
        report.value("resident.forward_backward_ms", json!(1e3 * both));
    }
    report.value("rgb.forward", forward.json());
    report.value("rgb.forward_backward", both.json());
    if arguments.device != Device::Gpu {
        let [forward, both] = shaded(&raw, &scene, &view, arguments.runs)?;
        rows.push(vec!["ten channels, shaded".into(), forward.text(), both.text()]);
        report.value("shaded.forward", forward.json());
        report.value("shaded.forward_backward", both.json());
        let least = forward_backward(&report.json, "rgb");
        over_floor(&mut report, exact.pairs, (least, rayon::current_num_threads()));
    }
    let _ = write!(report.text, "\n{}", table(&rows, &[false, true, true]));
    report.line(&format!("largest difference to the f64 picture: {worst:.2e}"));
    if scene.is_empty() {
        return Err(about(ply, "it holds no Gaussian, so there is nothing to measure"));
    }
    Ok((report.text, Value::Object(report.json)))
}

/// Text and JSON, made side by side.
struct Report {
    text: String,
    json: Map<String, Value>,
}

impl Report {
    fn line(&mut self, line: &str) {
        let _ = writeln!(self.text, "{line}");
    }
    fn value(&mut self, key: &str, value: Value) {
        self.json.insert(key.to_owned(), value);
    }
}

/// Least times of a row that was put into the JSON.
fn forward_backward(json: &Map<String, Value>, row: &str) -> [f64; 2] {
    ["forward", "forward_backward"].map(|what| json[&format!("{row}.{what}")]["min_ms"].as_f64().unwrap_or(f64::NAN))
}

/// The floor on this machine, and how far above it the times are.
fn over_floor(report: &mut Report, pairs: usize, ([forward, both], threads): ([f64; 2], usize)) {
    let floor = floor();
    let ms = |ns: f64| pairs as f64 * ns * 1e-6 / threads as f64;
    let floors = [ms(floor.forward_ns), ms(floor.forward_ns + floor.backward_ns)];
    let vector = floor.lanes as f64;
    report.line(&format!(
        "floor here: {:.2} ns forward, {:.2} ns backward a vector of {} pixels in cache; every lane used, {threads} threads: \
         {:.2} ms and {:.2} ms",
        vector * floor.forward_ns,
        vector * floor.backward_ns,
        floor.lanes,
        floors[0],
        floors[1],
    ));
    report.line(&format!("over it: forward {:.2}×, forward + backward {:.2}×", forward / floors[0], both / floors[1]));
    report.value("floor.lanes", json!(floor.lanes));
    report.value("floor.forward_ns_per_vector", json!(vector * floor.forward_ns));
    report.value("floor.backward_ns_per_vector", json!(vector * floor.backward_ns));
    report.value("floor.forward_ms", json!(floors[0]));
    report.value("floor.forward_backward_ms", json!(floors[1]));
    report.value("floor.forward_ratio", json!(forward / floors[0]));
    report.value("floor.forward_backward_ratio", json!(both / floors[1]));
}

/// The scene with the channels of a shaded avatar (albedo, normal, roughness, reflectance; depth and alpha come of
/// themselves), and every frame shaded under one light.
fn shaded(raw: &RawGaussians, scene: &Gaussians, view: &View, runs: u16) -> Result<[Timing; 2]> {
    let centre = [0, 1, 2].map(|k| raw.means.iter().map(|m| m[k]).sum::<f32>() / raw.means.len().max(1) as f32);
    let features: Vec<f32> = raw
        .means
        .iter()
        .zip(&raw.colors)
        .flat_map(|(mean, [r, g, b])| {
            let out = [0, 1, 2].map(|k| mean[k] - centre[k]);
            let length = out.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-9);
            [*r, *g, *b, out[0] / length, out[1] / length, out[2] / length, 0.6, 0.04]
        })
        .collect();
    let scene = Gaussians { features: &features, channels: 8, ..*scene };
    let (camera, options) = (&view.camera, RasterOptions { depth: true, ..view.options });
    let light = Environment::warm();
    let pixels = camera.width * camera.height;
    let on_rgb: Vec<f32> = (0..3 * pixels).map(|i| if i % 3 == 0 { 1.0 } else { -0.5 }).collect();
    let on_depth = vec![0.1; pixels];
    let forward = Timing::of(runs, || {
        let forward = || -> Result<_, SplatError> {
            let (prepared, frame) = render(&scene, camera, &options)?;
            let rgb = shade(&frame, camera, &light)?;
            Ok((prepared, frame, rgb))
        };
        forward().into_diagnostic()
    })?;
    let both = Timing::of(runs, || {
        let both = || -> Result<_, SplatError> {
            let (prepared, frame) = render(&scene, camera, &options)?;
            let rgb = shade(&frame, camera, &light)?;
            let on_frame = shade_backward(&frame, camera, &light, &on_rgb)?;
            let gradient =
                FrameGradient { planes: &on_frame.planes, depth: &on_depth, transmittance: &on_frame.transmittance };
            let gradients = backward(&scene, &prepared, &frame, &gradient)?;
            Ok((rgb, gradients, on_frame.radiance))
        };
        both().into_diagnostic()
    })?;
    Ok([forward, both])
}
