//! Every network file of the reference vectors within its own tolerance. The set is that of `$HEARTIAN_GOLDEN`, else
//! `../shared/golden` beside the repository; without either the test says that it is skipped. Chunk lengths, batch sizes,
//! weights and options are all read from the set's manifests, so another set of the same form may stand in its place.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::nets::Trace;
use crate::{Architecture, Batch, Factorisation, Network, Options, SegmentEdge, standardised_batch};

struct Array {
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// The folder of the set, if there is one.
fn golden() -> Option<PathBuf> {
    let given = std::env::var_os("HEARTIAN_GOLDEN").map(PathBuf::from);
    let folder = given.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/golden"));
    folder.join("manifest.json").is_file().then_some(folder)
}

fn read_npz(path: &Path) -> BTreeMap<String, Array> {
    let mut archive = npyz::npz::NpzArchive::open(path).unwrap();
    let names: Vec<String> = archive.array_names().map(str::to_owned).collect();
    let read = |name: String| {
        let file = archive.by_name(&name).unwrap().unwrap();
        let shape = file.shape().iter().map(|n| *n as usize).collect();
        assert_eq!(file.order(), npyz::Order::C, "{name}");
        let values = match file.dtype().descr().trim_matches('\'') {
            "|u1" => file.data::<u8>().unwrap().map(|v| f32::from(v.unwrap())).collect(),
            _ => file.data::<f32>().unwrap().map(|v| v.unwrap()).collect(),
        };
        (name, Array { shape, values })
    };
    names.into_iter().map(read).collect()
}

/// `file` below the manifest's folder, or flat in it.
fn locate(folder: &Path, file: &str) -> Option<PathBuf> {
    let flat = folder.join(Path::new(file).file_name()?);
    [folder.join(file), flat].into_iter().find(|path| path.is_file())
}

/// The first whole number after `label` in a text.
fn number_after(text: &str, label: &str) -> Option<usize> {
    let rest = &text[text.find(label)? + label.len()..];
    let digits: String = rest.trim_start_matches([' ', '=']).chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok()
}

/// A file name in a text, as in "input is that of x.npz".
fn file_named(text: &str) -> Option<&str> {
    let end = text.rfind(".npz")? + 4;
    let start = text[..end].rfind(|c: char| c.is_whitespace() || c == '(').map_or(0, |i| i + 1);
    Some(&text[start..end])
}

/// One manifest entry about a network.
struct Item {
    folder: PathBuf,
    entry: Value,
    arrays: BTreeMap<String, Array>,
    weights: PathBuf,
    options: Options,
}

impl Item {
    fn text(&self, key: &str) -> &str {
        self.entry[key].as_str().unwrap_or_default()
    }

    /// `None` if the manifest lists more than the set holds and the folder is a supplement.
    fn new(folder: &Path, entry: Value, may_lack: bool) -> Option<Self> {
        let file = entry["file"].as_str().unwrap();
        let (Some(path), Some(weights)) = (locate(folder, file), locate(folder, entry["weights"].as_str().unwrap()))
        else {
            assert!(may_lack, "{file} or its weights are not in the set");
            println!("not in this set: {file}");
            return None;
        };
        let what = entry["what"].as_str().unwrap_or_default();
        let hyper = &entry["hyper"];
        let mut options = Options::default();
        if let Some(frames) = number_after(what, "frame_depth") {
            options.segment_frames = frames;
        }
        if let Some(heads) = hyper["num_heads"].as_u64() {
            options.heads = heads as usize;
            options.theta = hyper["theta"].as_f64().unwrap() as f32;
            options.sharpness = hyper["gra_sharp"].as_f64().unwrap() as f32;
        }
        let arrays = read_npz(&path);
        Some(Self { folder: folder.to_owned(), entry, arrays, weights, options })
    }

    /// The input as `chunks × channels × frames × side × side`, and its shape.
    fn input(&self) -> ([usize; 5], Vec<f32>) {
        if let Some(array) = self.arrays.get("input_ncdhw") {
            return (array.shape.clone().try_into().unwrap(), array.values.clone());
        }
        if let Some(array) = self.arrays.get("input_nchw") {
            return channels_first(&array.shape, &array.values);
        }
        if let Some(frames) = self.arrays.get("frames_u8") {
            let architecture = Architecture::of(&crate::Weights::load(&self.weights).unwrap()).unwrap();
            return if architecture == Architecture::TsCan {
                self.tscan_input(frames)
            } else {
                channel_standardised(frames)
            };
        }
        let other = file_named(self.text("what")).unwrap();
        let path = locate(&self.folder, &format!("nets/{other}")).unwrap();
        let array = read_npz(&path).remove("input_ncdhw").unwrap();
        (array.shape.try_into().unwrap(), array.values)
    }

    /// open-rppg's input: differences standardised per frame and channel, the last repeated; and the clip's mean frame.
    fn tscan_input(&self, frames: &Array) -> ([usize; 5], Vec<f32>) {
        let [t, h, w, _] = frames.shape[..] else { panic!("{:?}", frames.shape) };
        let area = h * w;
        let at = |f: usize, c: usize, p: usize| f64::from(frames.values[(f * area + p) * 3 + c]) / 255.0;
        let mut out = vec![0.0f32; 6 * t * area];
        for c in 0..3 {
            for f in 0..t {
                let first = f.min(t - 2);
                let moved: Vec<f64> = (0..area).map(|p| at(first + 1, c, p) - at(first, c, p)).collect();
                let (mean, deviation) = moments(&moved);
                for p in 0..area {
                    out[(c * t + f) * area + p] = ((moved[p] - mean) / (deviation + 1e-6)) as f32;
                }
            }
            for p in 0..area {
                let mean = (0..t).map(|f| at(f, c, p)).sum::<f64>() / t as f64;
                (0..t).for_each(|f| out[((3 + c) * t + f) * area + p] = mean as f32);
            }
        }
        let mut shape = [1, 6, t, h, w];
        if let Some(first) = self.arrays.get("input_nchw_first20") {
            shape[2] = first.shape[0];
            let mut worst = 0.0f32;
            let (_, want) = channels_first(&first.shape, &first.values);
            for (i, want) in want.iter().enumerate() {
                let (c, rest) = (i / (shape[2] * area), i % (shape[2] * area));
                worst = worst.max((out[c * t * area + rest] - want).abs());
            }
            println!("    its own pre-processing here: {worst:.2e}");
            assert!(worst < 1e-3, "the test prepares TS-CAN's input otherwise than the reference: {worst}");
            shape[2] = t;
        }
        (shape, out)
    }

    fn run(&self, options: &Options, trace: &mut Trace) -> Vec<f32> {
        let (shape, values) = self.input();
        let options = Options { side_px: Some(shape[4]), ..options.clone() };
        let network = Network::load(&self.weights, &options).unwrap();
        let frames = shape[2] - network.input().extra_frames;
        network.run_traced(&Batch { data: &values, chunks: shape[0], frames }, trace).unwrap()
    }

    /// All outputs under the names of the manifest's tolerances.
    fn outputs(&self) -> BTreeMap<String, Vec<f32>> {
        let mut out = BTreeMap::new();
        let mut trace = Trace::recording();
        let names: Vec<&String> = self.entry["tolerance"].as_object().unwrap().keys().collect();
        let wants = |name: &str| names.iter().any(|wanted| *wanted == name);
        let plain = self.run(&self.options, &mut trace);
        for name in ["rppg", "pred", "torch_raw", "pred_zero", "rppg_nofsam"] {
            out.insert(name.to_owned(), plain.clone());
        }
        out.insert("rppg_nofsam_batchnormed".to_owned(), standardised_batch(&plain));
        let deviations: Vec<f64> = plain.iter().map(|v| f64::from(*v)).collect();
        let (mean, deviation) = moments(&deviations);
        let zscored: Vec<f32> = deviations.iter().map(|v| ((v - mean) / deviation) as f32).collect();
        out.insert("zscored torch_raw vs pred_keras".to_owned(), zscored.clone());
        out.insert("zscored_vs_pred_keras".to_owned(), zscored);
        if wants("torch_raw_heads4") {
            let heads4 = Options { heads: 4, ..self.options.clone() };
            out.insert("torch_raw_heads4".to_owned(), self.run(&heads4, &mut Trace::default()));
        }
        if wants("pred_replicate") {
            let replicate = Options { segment_edge: SegmentEdge::Replicate, ..self.options.clone() };
            let values = self.run(&replicate, &mut Trace::default());
            out.insert("pred_keras".to_owned(), values.clone());
            out.insert("pred_replicate".to_owned(), values);
        }
        if wants("rppg_fsam") {
            let on = |factorisation| Options { factorisation, ..self.options.clone() };
            out.insert("rppg_fsam".to_owned(), self.run(&on(Factorisation::On), &mut trace));
            out.insert(
                "rppg_fsam_nores".to_owned(),
                self.run(&on(Factorisation::WithoutResidual), &mut Trace::default()),
            );
        }
        out.extend(trace.into_values());
        out
    }

    /// The trace's name of an array: without the part that says how much of it is kept.
    fn traced_name(&self, name: &str) -> String {
        let cut = ["_first", "_row"].iter().filter_map(|part| name.find(part)).min().unwrap_or(name.len());
        name[..cut].replace("lasthead", &format!("head{}", self.options.heads - 1))
    }

    /// Compares every array that has a tolerance; says what is out of it.
    fn check(&self) -> Vec<String> {
        let outputs = self.outputs();
        let mut wrong = Vec::new();
        for (name, tolerance) in self.entry["tolerance"].as_object().unwrap() {
            let tolerance = tolerance["atol"].as_f64().unwrap() as f32;
            let array = name.rsplit(' ').next().unwrap().trim_start_matches("zscored_vs_");
            let want = &self.arrays.get(array).unwrap_or_else(|| panic!("no array {array}")).values;
            let Some(got) = outputs.get(name).or_else(|| outputs.get(&self.traced_name(name))) else {
                wrong.push(format!("{}: nothing here computes {name}", self.text("file")));
                continue;
            };
            let worst = got.iter().zip(want).map(|(got, want)| (got - want).abs()).fold(0.0, f32::max);
            println!("  {:44} {name:32} deviation {worst:.2e} of {tolerance:.2e}", self.text("file"));
            if got.len() < want.len() || !(worst <= tolerance) {
                wrong.push(format!("{} {name}: {worst:e} > {tolerance:e}", self.text("file")));
            }
        }
        wrong
    }
}

fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt())
}

/// `frames × channels × …` to `1 × channels × frames × …`.
fn channels_first(shape: &[usize], values: &[f32]) -> ([usize; 5], Vec<f32>) {
    let [t, c, h, w] = shape[..] else { panic!("{shape:?}") };
    let area = h * w;
    let planes = (0..c * t).flat_map(|i| &values[((i % t) * c + i / t) * area..][..area]).copied().collect();
    ([1, c, t, h, w], planes)
}

/// open-rppg's input: each channel of the clip less its mean, over its deviation + 10⁻⁶.
fn channel_standardised(frames: &Array) -> ([usize; 5], Vec<f32>) {
    let [t, h, w, 3] = frames.shape[..] else { panic!("{:?}", frames.shape) };
    let channel = |c: usize| {
        let values: Vec<f64> = frames.values.iter().skip(c).step_by(3).map(|v| f64::from(*v) / 255.0).collect();
        let (mean, deviation) = moments(&values);
        values.into_iter().map(move |v| ((v - mean) / (deviation + 1e-6)) as f32)
    };
    ([1, 3, t, h, w], (0..3).flat_map(channel).collect())
}

#[test]
fn every_network_file_is_within_its_tolerance() {
    let Some(golden) = golden() else {
        println!("skipped: no ../shared/golden and no $HEARTIAN_GOLDEN");
        return;
    };
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for (folder, may_lack) in [(golden.clone(), false), (golden.join("extra"), true)] {
        let mut text = String::new();
        let Ok(mut file) = std::fs::File::open(folder.join("manifest.json")) else { continue };
        file.read_to_string(&mut text).unwrap();
        let manifest: Value = serde_json::from_str(&text).unwrap();
        for entry in manifest["items"].as_array().unwrap() {
            if !entry["file"].as_str().is_some_and(|file| file.starts_with("nets/")) {
                continue;
            }
            if let Some(item) = Item::new(&folder, entry.clone(), may_lack) {
                wrong.extend(item.check());
                seen += 1;
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(seen > 0, "the manifest lists no network");
}
