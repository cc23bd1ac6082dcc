//! Round trips, the forms that other programs write, lies, damage and seeded mutations.

use super::{NAMES, RawGaussians, SH_CONSTANT, read, write};

fn scene() -> RawGaussians {
    RawGaussians {
        means: vec![[1.0, -2.0, 3.5], [0.0; 3]],
        log_scales: vec![[-5.0, -6.0, -7.0]; 2],
        rotations: vec![[1.0, 0.1, 0.2, 0.3]; 2],
        logits: vec![0.3, -4.0],
        colors: vec![[0.5, 0.25, 0.75]; 2],
    }
}

fn bytes(scene: &RawGaussians) -> Vec<u8> {
    let mut out = Vec::new();
    write(scene, &mut out).unwrap_or_else(|e| panic!("{e}"));
    out
}

fn parse(bytes: &[u8]) -> Result<RawGaussians, String> {
    read::parse(&mut &bytes[..])
}

fn assert_same(a: &RawGaussians, b: &RawGaussians) {
    assert_eq!((&a.means, &a.logits, &a.rotations, &a.log_scales), (&b.means, &b.logits, &b.rotations, &b.log_scales));
    for (a, b) in a.colors.as_flattened().iter().zip(b.colors.as_flattened()) {
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }
}

#[test]
fn a_scene_survives_the_round_trip_in_the_order_that_viewers_expect() -> Result<(), String> {
    let bytes = bytes(&scene());
    assert_same(&parse(&bytes)?, &scene());
    let header = String::from_utf8_lossy(&bytes[..bytes.len() - 2 * 68]).into_owned();
    let wanted: String = NAMES.iter().map(|name| format!("property float {name}\n")).collect();
    assert_eq!(header, format!("ply\nformat binary_little_endian 1.0\nelement vertex 2\n{wanted}end_header\n"));
    Ok(())
}

/// Properties reversed, with others between them, as doubles in big-endian order, as text, with Windows line ends.
#[test]
fn other_programs_forms_are_read() -> Result<(), String> {
    let scene = scene();
    let value = |i: usize, name: &str| -> f64 {
        let of =
            |v: &[f32], prefix: &str| name.strip_prefix(prefix).and_then(|k| k.parse::<usize>().ok()).map(|k| v[k]);
        let dc = scene.colors[i].map(|c| (c - 0.5) / SH_CONSTANT);
        let known = ["x", "y", "z"].iter().position(|axis| *axis == name).map(|k| scene.means[i][k]);
        let known = known.or_else(|| of(&dc, "f_dc_")).or_else(|| of(&scene.log_scales[i], "scale_"));
        let known = known.or_else(|| of(&scene.rotations[i], "rot_"));
        f64::from(known.unwrap_or(if name == "opacity" { scene.logits[i] } else { 7.0 }))
    };
    let names: Vec<&str> = NAMES.iter().rev().flat_map(|name| [*name, "f_rest"]).collect();
    for (format, end) in [("binary_big_endian", "\n"), ("binary_little_endian", "\r\n"), ("ascii", "\r\n")] {
        let mut file = format!("ply{end}format {format} 1.0{end}comment by hand{end}element vertex 2{end}");
        for (k, name) in names.iter().enumerate() {
            file += &if *name == "f_rest" {
                format!("property uchar f_rest_{k}{end}")
            } else {
                format!("property double {name}{end}")
            };
        }
        file += &format!("element face 1{end}property list uchar int vertex_indices{end}end_header{end}");
        let mut file = file.into_bytes();
        for i in 0..2 {
            for name in &names {
                let number = value(i, name);
                match (format, *name) {
                    ("ascii", _) => file.extend(format!("{number} ").into_bytes()),
                    (_, "f_rest") => file.push(9),
                    ("binary_big_endian", _) => file.extend(number.to_be_bytes()),
                    _ => file.extend(number.to_le_bytes()),
                }
            }
            if format == "ascii" {
                file.extend(b"\r\n\r\n");
            }
        }
        assert_same(&parse(&file)?, &scene);
    }
    Ok(())
}

#[test]
fn lies_and_damage_are_named() {
    let whole = bytes(&scene());
    assert!(parse(&whole[..whole.len() - 1]).is_err_and(|e| e.contains("holds 1 of its 2")));
    let text = |text: &str| parse(text.as_bytes()).err().unwrap_or_default();
    let header = |count: &str| String::from_utf8_lossy(&whole[..whole.len() - 136]).replace("vertex 2", count);
    assert!(text("plx").contains("not a ply") && text("").contains("not a ply"));
    assert!(text(&header("vertex 18446744073709551615")).contains("at most"));
    assert!(text(&header("vertex 67108864")).contains("cut short"));
    assert!(text(&header("vertex -1")).contains("no count"));
    assert!(text(&header("vertex 0")).is_empty());
    assert!(text("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n").contains("missing"));
    assert!(text("ply\nformat base64 1.0\n").contains("base64"));
    assert!(text("ply\nformat ascii 1.0\nelement face 3\n").contains("first element"));
    assert!(text(&format!("ply\n{}", "comment x\n".repeat(20_000))).contains("does not end"));
    assert!(text(&format!("ply\ncomment {}", "x".repeat(100_000))).contains("does not end"));
    assert!(text(&header("vertex 2\nproperty float x")).contains("twice"));
    assert!(text(&header("vertex 2\nproperty list uchar int q")).contains("list"));
}

/// Mutated files give a scene or an error, never a panic, and never more Gaussians than bytes. `HEARTIAN_FUZZ_SECONDS`
/// runs longer.
#[test]
fn mutations_are_survived() {
    let seeds = [bytes(&scene()), {
        let header = String::from_utf8_lossy(&bytes(&scene())[..bytes(&scene()).len() - 136]).into_owned();
        (header.replace("binary_little_endian", "ascii") + &"1 2 3 0 0 0 0.1 0.2 0.3 0 -5 -5 -5 1 0 0 0\n".repeat(2))
            .into_bytes()
    }];
    let seconds = std::env::var("HEARTIAN_FUZZ_SECONDS").ok().and_then(|s| s.parse::<u64>().ok());
    let (start, mut random, mut count) = (std::time::Instant::now(), crate::tests::scenes::Random::new(77), 0u64);
    let going_on = |count: u64| seconds.map_or(count < 20_000, |s| start.elapsed().as_secs() < s);
    while going_on(count) {
        let mut file = seeds[count as usize % 2].clone();
        for _ in 0..1 + (random.unit() * 8.0) as usize {
            let at = (random.unit() * file.len() as f32) as usize % file.len().max(1);
            match (random.unit() * 5.0) as usize {
                0 => file[at] = (random.unit() * 256.0) as u8,
                1 => file[at] ^= 1 << ((random.unit() * 8.0) as u32 & 7),
                2 => file.truncate(at.max(1)),
                3 => file.insert(at, b"0 \n9-"[(random.unit() * 5.0) as usize % 5]),
                _ => {
                    let end = (at + (random.unit() * 60.0) as usize).min(file.len());
                    let copy = file[at..end].to_vec();
                    file.splice(at..at, copy);
                }
            }
        }
        if let Ok(scene) = parse(&file) {
            assert!(scene.means.len() <= file.len() && scene.logits.len() == scene.means.len());
        }
        count += 1;
    }
    println!("{count} mutated files");
}
