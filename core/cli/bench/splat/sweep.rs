//! Made scenes over splats × resolution × precision: milliseconds beside PSNR, and milliseconds against
//! (Gaussian, pixel) pairs, as a table and three plots.

use heartian_report::{CostPoint, ScalingLine, cost_figure, encode_png, scaling_figure};
use heartian_splat::RasterOptions;
use heartian_splat::reference::{Scene, tiled};
use miette::{IntoDiagnostic, Result};
use serde_json::{Value, json};

use super::SplatBench;
use super::device::{Rasteriser, View, rasteriser};
use super::scene::{camera, shell};
use super::single::NEAR_METRES;
use super::timing::Timing;
use crate::summary::table;

const SPLATS: [usize; 5] = [2_000, 10_000, 20_000, 50_000, 100_000];
const SIDES_PX: [usize; 3] = [128, 256, 512];

/// One point of the sweep.
struct Row {
    splats: usize,
    side_px: usize,
    precision: &'static str,
    device: String,
    pairs: usize,
    forward: Timing,
    both: Option<Timing>,
    /// Against the f64 picture; `None` for that picture itself.
    psnr_db: Option<f64>,
}

/// Measures the sweep; text and JSON of the report.
pub fn run(arguments: &SplatBench) -> Result<(String, Value)> {
    std::fs::create_dir_all(&arguments.out).into_diagnostic()?;
    let mut device = rasteriser(arguments.device)?;
    let mut rows = Vec::new();
    for splats in SPLATS {
        for side in SIDES_PX {
            eprintln!("  {splats} splats, {side}×{side}");
            point(arguments.runs, device.as_mut(), (splats, side), &mut rows)?;
        }
    }
    let write = |name: &str, figure: heartian_space::Rgb8Image| -> Result<()> {
        std::fs::write(arguments.out.join(name), encode_png(&figure).into_diagnostic()?).into_diagnostic()
    };
    let fast: Vec<&Row> = rows.iter().filter(|row| row.both.is_some()).collect();
    // Splats cost by themselves, so a line is drawn through the resolutions of each number of them.
    let mut fits = Vec::new();
    for (name, file) in [("forward", "cost_forward.png"), ("forward + backward", "cost_forward_backward.png")] {
        let point = |row: &&Row| CostPoint {
            group: format!("{name}, {}k splats", row.splats / 1000),
            work: row.pairs as f64 * 1e-6,
            cost: if name == "forward" { row.forward.min_ms } else { row.both.map_or(f64::NAN, |both| both.min_ms) },
        };
        let points: Vec<CostPoint> = fast.iter().map(point).collect();
        let (figure, lines) = cost_figure(&points, "million (Gaussian, pixel) pairs", "ms").into_diagnostic()?;
        write(file, figure)?;
        fits.extend(lines);
    }
    write("speed.png", scaling_figure(&scaling(&rows), "Gaussians").into_diagnostic()?)?;
    let mut text = text(&rows);
    for fit in &fits {
        text += &format!(
            "{}: {:.2} ms and {:.2} ms a million pairs; {:.1} % of the variance is not of that line\n",
            fit.group,
            fit.fixed,
            fit.slope,
            100.0 * (1.0 - fit.explained)
        );
    }
    text += &format!("plots in {}: cost_forward.png, cost_forward_backward.png, speed.png\n", arguments.out.display());
    let fits = fits.iter().map(|fit| {
        json!({"group": fit.group, "fixed_ms": fit.fixed, "ms_per_million_pairs": fit.slope, "r2": fit.explained})
    });
    let json = json!({"rows": rows.iter().map(Row::json).collect::<Vec<_>>(), "linear": fits.collect::<Vec<_>>()});
    Ok((text, json))
}

/// Measures one scene: the device's rasteriser, and the f64 text.
fn point(runs: u16, device: &mut dyn Rasteriser, (splats, side_px): (usize, usize), rows: &mut Vec<Row>) -> Result<()> {
    let raw = shell(splats);
    let activated = raw.activate();
    let scene = raw.view(&activated);
    let options = RasterOptions { near_metres: NEAR_METRES, ..RasterOptions::default() };
    let view = View { camera: camera(side_px), options };
    let exact_scene = Scene::new(&scene);
    let mut exact = tiled::composite(&exact_scene, &view.camera, &options);
    let exact_time = Timing::of(1, || {
        exact = tiled::composite(&exact_scene, &view.camera, &options);
        Ok(())
    })?;
    let on_planes = vec![1.0; 3 * side_px * side_px];
    let forward = Timing::of(runs, || device.forward(&scene, &view))?;
    let both = Timing::of(runs, || device.both(&scene, &view, &on_planes))?;
    let frame = device.forward(&scene, &view)?;
    let squares = frame.planes.iter().zip(&exact.planes).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>();
    let psnr_db = -10.0 * (squares / exact.planes.len() as f64).max(1e-30).log10();
    rows.push(Row {
        splats,
        side_px,
        precision: "f32",
        device: device.name(),
        pairs: exact.pairs,
        forward,
        both: Some(both),
        psnr_db: Some(psnr_db),
    });
    rows.push(Row {
        splats,
        side_px,
        precision: "f64",
        device: "CPU, plain, 1 thread".to_owned(),
        pairs: exact.pairs,
        forward: exact_time,
        both: None,
        psnr_db: None,
    });
    Ok(())
}

/// A line for each precision and resolution, with its least PSNR.
fn scaling(rows: &[Row]) -> Vec<ScalingLine> {
    let mut lines = Vec::new();
    for precision in ["f32", "f64"] {
        for side_px in SIDES_PX {
            let of_line = || rows.iter().filter(|row| row.precision == precision && row.side_px == side_px);
            let least = of_line().filter_map(|row| row.psnr_db).min_by(f64::total_cmp);
            let error = least.map_or_else(|| "the reference, 1 thread".to_owned(), |db| format!("{db:.0} dB"));
            let points = of_line().map(|row| (row.splats as f64, row.forward.min_ms)).collect();
            lines.push(ScalingLine { label: format!("{precision}, {side_px}²: {error}"), points });
        }
    }
    lines
}

impl Row {
    fn json(&self) -> Value {
        json!({
            "splats": self.splats, "side_px": self.side_px, "precision": self.precision, "device": self.device,
            "pairs": self.pairs, "forward": self.forward.json(), "forward_backward": self.both.map(Timing::json),
            "psnr_db": self.psnr_db,
        })
    }
}

fn text(rows: &[Row]) -> String {
    let heading = ["splats", "side", "precision", "device", "pairs", "forward ms", "+ backward ms", "PSNR dB"];
    let mut cells = vec![heading.map(str::to_owned).to_vec()];
    for row in rows {
        cells.push(vec![
            row.splats.to_string(),
            row.side_px.to_string(),
            row.precision.to_owned(),
            row.device.clone(),
            row.pairs.to_string(),
            row.forward.text(),
            row.both.map_or_else(String::new, Timing::text),
            row.psnr_db.map_or_else(|| "reference".to_owned(), |db| format!("{db:.1}")),
        ]);
    }
    format!("{}\n", table(&cells, &[true, true, false, false, true, true, true, true]))
}
