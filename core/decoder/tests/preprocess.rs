//! Parity of preprocessing with rPPG-Toolbox and OpenCV: every `preprocess/` file of the golden manifest, at the tolerance
//! the manifest states. The folder is `$HEARTIAN_GOLDEN`, or `../shared/golden` beside the repository; without it the test
//! says "skipped" and passes. Each file reports its largest deviation in units of its tolerance (must be ≤ 1).

#[path = "../../signal/tests/golden/file.rs"]
mod file;

use file::{Bound, Checks, Golden, Outcome};
use heartian_decoder::Normalisation;
use heartian_decoder::preprocess::{
    FaceBox, Pixels, chunk_count, label_difference, label_standardised, normalised, resampled_to_frames, resize_area,
};

/// What checks one golden file.
type Comparer = fn(&Golden, &mut Checks) -> Outcome<()>;

#[test]
fn every_golden_file_agrees() -> Outcome<()> {
    let Some(folder) = file::folder() else {
        println!("skipped: no golden folder; set HEARTIAN_GOLDEN to one");
        return Ok(());
    };
    let mut failures = Vec::new();
    for entry in file::manifest(&folder)?.iter().filter(|entry| entry.file.starts_with("preprocess/")) {
        let compare: Comparer = match entry.file.as_str() {
            "preprocess/normalise.npz" => normalise,
            "preprocess/resize_area.npz" => resize,
            "preprocess/box_logic.npz" => boxes,
            other => return Err(format!("{other}: nothing checks it").into()),
        };
        let mut checks = Checks::default();
        compare(&Golden::open(&folder, entry)?, &mut checks)?;
        println!("{:32} {checks}", entry.file);
        failures.extend(checks.failures().map(|failure| format!("{}: {failure}", entry.file)));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    Ok(())
}

/// The last tolerance a line of the manifest names: `float32 data: atol 2e-6` → 2e-6.
fn stated(golden: &Golden, pointer: &str) -> Outcome<f64> {
    let text = golden.words(pointer)?;
    let number = text.split_whitespace().filter_map(|word| word.parse().ok()).next_back();
    Ok(number.ok_or_else(|| format!("`{text}` states no tolerance"))?)
}

fn normalise(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    let frames: Vec<u8> = golden.array("frames_u8")?.iter().map(|&code| code as u8).collect();
    let frame_bytes: usize = golden.shape("frames_u8")?[1..].iter().product();
    for (name, kind) in
        [("diff_normalized", Normalisation::DiffNormalized), ("standardized", Normalisation::Standardized)]
    {
        let got: Vec<f64> = normalised(&frames, frame_bytes, kind).into_iter().map(f64::from).collect();
        checks.close(name, &got, golden.array(name)?, Bound::absolute(stated(golden, &format!("/{name}"))?));
    }
    let raw: Vec<f64> = normalised(&frames, frame_bytes, Normalisation::Raw).into_iter().map(f64::from).collect();
    checks.close("raw", &raw, golden.array("frames_u8")?, Bound::absolute(0.0));

    // A zero is exact up to rounding of the values around it.
    let labels = Bound { absolute: 1e-15, relative: stated(golden, "/labels")? };
    let label = golden.array("label")?;
    checks.close("label_diff", &label_difference(label), golden.array("label_diff")?, labels);
    checks.close("label_std", &label_standardised(label), golden.array("label_std")?, labels);
    let constant = golden.array("const_label_diff")?;
    checks.close("const_label_diff", &label_difference(&vec![3.0; constant.len()]), constant, labels);
    let wave = golden.array("wave")?;
    for name in golden.names("resample_") {
        let want = golden.array(name)?;
        checks.close(name, &resampled_to_frames(wave, want.len()), want, labels);
    }
    let want = golden.shape("chunk7_label")?.to_vec();
    let (count, length) = (chunk_count(label.len(), want[1]), want[1]);
    checks.close("chunks", &[count as f64], &[want[0] as f64], Bound::absolute(0.0));
    checks.close("chunk7_label", &label[..count * length], golden.array("chunk7_label")?, Bound::absolute(0.0));
    let frame: Vec<f64> = golden.shape("frames_u8")?[1..].iter().map(|size| *size as f64).collect();
    let shape = [&[count as f64, length as f64][..], &frame].concat();
    checks.close("chunk7_shape", &shape, golden.array("chunk7_shape")?, Bound::absolute(0.0));
    Ok(())
}

fn resize(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    let source: Vec<u8> = golden.array("src_u8")?.iter().map(|&code| code as u8).collect();
    let frame_width = golden.shape("src_u8")?[1];
    let (most, least) = (golden.tolerance("/abs")?, golden.tolerance("/fraction_exact_min")?);
    for k in 0..golden.count("box") {
        let values: Vec<usize> = golden.array(&format!("box{k}"))?.iter().map(|&value| value as usize).collect();
        let [x, y, w, h, out_w, out_h] = values[..] else { return Err("a box has six values".into()) };
        let part = Pixels::of(&source, frame_width, y..y + h, x..x + w).ok_or("the box lies outside")?;
        let got: Vec<f64> = resize_area(&part, (out_w, out_h)).into_iter().map(f64::from).collect();
        let want = golden.array(&format!("out{k}"))?;
        checks.close(&format!("out{k} {w}×{h}→{out_w}×{out_h}"), &got, want, Bound::absolute(most));
        let exact = got.iter().zip(want).filter(|(got, want)| got == want).count() as f64 / want.len() as f64;
        checks.at_least(&format!("share of exact codes {k}"), exact, least);
    }
    Ok(())
}

fn boxes(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    let [height, width] = golden.array("frame_hw")? else { return Err("frame_hw has two values".into()) };
    let (width, height) = (*width as usize, *height as usize);
    let columns = golden.shape("rows")?[1];
    for row in golden.array("rows")?.chunks_exact(columns) {
        let detection = |at: usize| FaceBox {
            x: row[at] as i32,
            y: row[at + 1] as i32,
            width: row[at + 2] as i32,
            height: row[at + 3] as i32,
        };
        let found = &[detection(0), detection(4)][..row[8] as usize];
        let face = FaceBox::widest(found).unwrap_or(FaceBox::whole_frame(width, height));
        let face = if row[9] == 1.0 { face } else { face.enlarged(row[9]) };
        let (rows, columns) = face.crop(width, height);
        let got = [
            f64::from(face.x),
            f64::from(face.y),
            f64::from(face.width),
            f64::from(face.height),
            rows.start as f64,
            rows.end as f64,
            columns.start as f64,
            columns.end as f64,
        ];
        checks.close("box and crop", &got, &row[10..18], Bound::absolute(0.0));
    }
    Ok(())
}
