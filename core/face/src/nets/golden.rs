//! The interpreter against the reference interpreter's stored outputs (`tests/golden/nets`, with the script that made
//! them) on one drawn person. Needs the installed networks; says so and passes where there are none.
#![expect(clippy::unwrap_used, reason = "tests")]

use super::Net;

/// What stored and found values may differ by.
const MOST: f32 = 3e-4;

/// The drawing of `make.py`, in the same whole numbers.
fn person(side: i64) -> Vec<[i64; 3]> {
    let ground = |x: i64, y: i64| [30 + (x * 7 + y * 3) % 40, 110 + (x * 5 + y * 11) % 30, 60 + x * y % 23];
    let mut blobs = vec![
        ([128, 250, 90, 70], [60, 60, 90]),
        ([128, 170, 30, 50], [190, 140, 115]),
        ([128, 105, 52, 70], [205, 155, 130]),
        ([128, 50, 56, 30], [50, 35, 25]),
    ];
    for eye in [106, 150] {
        blobs.push(([eye, 98, 10, 5], [235, 235, 230]));
        blobs.push(([eye, 98, 5, 5], [40, 25, 15]));
        blobs.push(([eye, 84, 14, 3], [50, 35, 25]));
    }
    blobs.push(([128, 122, 8, 12], [185, 130, 105]));
    blobs.push(([128, 145, 20, 6], [170, 80, 80]));
    let pixel = |i: i64| {
        let (x, y) = (i % side * 256 / side, i / side * 256 / side);
        let ground = ground(x, y);
        let inside = |[cx, cy, rx, ry]: [i64; 4]| ((x - cx) * ry).pow(2) + ((y - cy) * rx).pow(2) < (rx * ry).pow(2);
        let top = blobs.iter().rev().find(|(ellipse, _)| inside(*ellipse));
        top.map_or(ground, |(_, colour)| [0, 1, 2].map(|c| colour[c] + ground[c] % 13))
    };
    (0..side * side).map(pixel).collect()
}

fn compare(name: &str, side: i64, (scale, offset): (f32, f32), step: usize) {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/nets");
    let stored = std::fs::read(root.join(format!("{name}.f32"))).unwrap();
    let want: Vec<f32> = stored.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let folder = crate::models::directory().unwrap();
    let Ok(bytes) = std::fs::read(folder.join(format!("{name}.tflite"))) else {
        return println!("skipped: {name} is not installed");
    };
    let input = person(side).iter().flatten().map(|value| *value as f32 * scale + offset).collect();
    let found: Vec<f32> = Net::parse(&bytes)
        .unwrap()
        .run(input)
        .unwrap()
        .into_iter()
        .flat_map(|t| t.data.into_iter().step_by(step))
        .collect();
    assert_eq!(found.len(), want.len(), "{name}");
    let worst = found.iter().zip(&want).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("{name}: largest difference {worst:.1e} over {} values", want.len());
    assert!(worst <= MOST && found.iter().all(|value| value.is_finite()), "{name}: {worst}");
}

#[test]
fn the_detector_matches_the_reference() {
    compare("face_detection_short_range", 128, (2.0 / 255.0, -1.0), 1);
}

#[test]
fn the_landmarks_match_the_reference() {
    compare("face_landmark", 192, (1.0 / 255.0, 0.0), 1);
}

#[test]
fn the_segmentation_matches_the_reference() {
    compare("selfie_segmentation", 256, (1.0 / 255.0, 0.0), 16);
}

#[test]
fn the_irises_match_the_reference() {
    compare("iris_landmark", 64, (1.0 / 255.0, 0.0), 1);
}
