//! Readers against each other, against ffmpeg where there is one, and against damage.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::*;

mod fuzz;
mod kinds;

fn golden_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/video").join(name)
}

/// An OpenEXR picture of one linear colour: half grey, nothing, twice white.
fn write_exr(path: &Path, width: usize, height: usize) {
    exr::prelude::write_rgb_file(path, width, height, |_, _| (0.5f32, 0.0f32, 2.0f32)).unwrap();
}

/// The real clip, when the shared data are beside the repository.
fn real_clip() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/franck.mp4");
    if path.is_file() {
        return Some(path);
    }
    println!("skipped: ../shared/data/franck.mp4 is not there");
    None
}

fn have_ffmpeg() -> bool {
    let found = Command::new("ffmpeg").arg("-version").output().is_ok_and(|output| output.status.success());
    if !found {
        println!("skipped: ffmpeg is not on PATH");
    }
    found
}

fn read_all(path: &Path, options: &VideoOptions, most: usize) -> Result<Vec<TimedFrame>, VideoError> {
    let mut video = open(path, options)?;
    let mut frames = Vec::new();
    while frames.len() < most
        && let Some(frame) = video.next_frame()?
    {
        frames.push(frame);
    }
    Ok(frames)
}

/// A ramp with a moving square: every pixel of every frame is known.
fn drawn(width: usize, height: usize, frame: usize) -> Rgb8Image {
    let mut image = Rgb8Image::filled(width, height, [0; 3]);
    for y in 0..height {
        for x in 0..width {
            let square = x / 8 == frame % 4 && y / 8 == 1;
            image.set_pixel(x, y, if square { [250, 20, 30] } else { [(3 * x) as u8, (5 * y) as u8, (x + y) as u8] });
        }
    }
    image
}

fn write_png(path: &Path, image: &Rgb8Image) {
    let file = std::fs::File::create(path).unwrap();
    let mut encoder = png::Encoder::new(file, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&image.data).unwrap();
}

/// A RIFF chunk, padded.
fn avi_chunk(tag: &[u8; 4], body: &[u8]) -> Vec<u8> {
    let mut out = tag.to_vec();
    out.extend((body.len() as u32).to_le_bytes());
    out.extend(body);
    out.extend(vec![0; body.len() % 2]);
    out
}

/// An uncompressed AVI in memory, bottom-up, rows padded.
fn avi_bytes(width: usize, height: usize, frames: &[Rgb8Image]) -> Vec<u8> {
    let chunk = avi_chunk;
    let list = |name: &[u8; 4], body: &[u8]| chunk(b"LIST", &[name.as_slice(), body].concat());
    let words = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let strh = [b"vidsDIB ".as_slice(), &words(&[0, 0, 0, 1, 25, 0, frames.len() as u32, 0, 0, 0, 0, 0])].concat();
    let strf = words(&[40, width as u32, height as u32, 1 | 24 << 16, 0, 0, 0, 0, 0, 0]);
    let strl = list(b"strl", &[chunk(b"strh", &strh), chunk(b"strf", &strf)].concat());
    let hdrl = list(b"hdrl", &[chunk(b"avih", &words(&[40000; 14])), strl].concat());
    let mut movi = Vec::new();
    for frame in frames {
        let mut body = Vec::new();
        for y in (0..height).rev() {
            body.extend((0..width).flat_map(|x| {
                let [r, g, b] = frame.pixel(x, y);
                [b, g, r]
            }));
            body.resize(body.len().next_multiple_of(4), 0);
        }
        movi.extend(chunk(b"00db", &body));
    }
    let body = [b"AVI ".to_vec(), hdrl, list(b"movi", &movi)].concat();
    chunk(b"RIFF", &body)
}

#[test]
fn folders_and_raw_avi_give_back_what_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let pictures: Vec<Rgb8Image> = (0..12).map(|frame| drawn(35, 24, frame)).collect();
    for (i, picture) in pictures.iter().enumerate() {
        write_png(&folder.path().join(format!("frame{i}.png")), picture);
    }
    let read = read_all(folder.path(), &VideoOptions::default(), 99).unwrap();
    assert!(read.iter().map(|frame| &frame.image).eq(&pictures));
    assert!((read[11].seconds - 11.0 / 30.0).abs() < 1e-12);
    std::fs::write(folder.path().join("times.txt"), (0..12).map(|i| format!("{}\n", i * i)).collect::<String>())
        .unwrap();
    assert_eq!(read_all(folder.path(), &VideoOptions::default(), 99).unwrap()[5].seconds, 25.0);
    std::fs::write(folder.path().join("times.txt"), "0\n1\n").unwrap();
    assert!(matches!(open(folder.path(), &VideoOptions::default()), Err(VideoError::Times { .. })));

    let avi = folder.path().join("raw.avi");
    let bytes = avi_bytes(35, 24, &pictures);
    std::fs::write(&avi, &bytes).unwrap();
    let read = read_all(&avi, &VideoOptions::default(), 99).unwrap();
    assert!(read.iter().map(|frame| &frame.image).eq(&pictures));
    assert_eq!(read[3].seconds, 0.12);
    std::fs::write(&avi, &bytes[..bytes.len() - 5000]).unwrap();
    assert!(matches!(read_all(&avi, &VideoOptions::default(), 99), Err(VideoError::Truncated { .. })));
    let from = VideoOptions { start_seconds: 0.4, ..VideoOptions::default() };
    std::fs::write(&avi, &bytes).unwrap();
    assert_eq!(read_all(&avi, &from, 99).unwrap().len(), 2);
    let late = VideoOptions { start_seconds: 40.0, ..VideoOptions::default() };
    assert!(matches!(read_all(&avi, &late, 99), Err(VideoError::NoFrames { .. })));
}

#[test]
fn what_is_no_video_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path| open(path, &VideoOptions::default()).map(drop);
    assert!(matches!(open(&folder.path().join("none.mp4")), Err(VideoError::Missing { .. })));
    assert!(matches!(open(folder.path()), Err(VideoError::NotVideo { .. })));
    let file = folder.path().join("file.mp4");
    for bytes in [&b""[..], b"\0\0\0\x18ftypisom", b"\0\0\0\x10ftypisom\0\0\0\0\0\0\0\x08moov"] {
        std::fs::write(&file, bytes).unwrap();
        assert!(matches!(open(&file), Err(VideoError::NotVideo { .. })), "{bytes:?}");
    }
    std::fs::write(&file, b"a letter to a friend, not a video").unwrap();
    assert!(matches!(open(&file), Err(VideoError::NotVideo { .. } | VideoError::NeedsFfmpeg { .. })));
}

#[test]
fn the_real_clip_decodes_in_order_and_seeks() {
    let Some(path) = real_clip() else { return };
    let frames = read_all(&path, &VideoOptions::default(), 300).unwrap();
    assert_eq!(frames.len(), 300);
    assert!(frames.iter().enumerate().all(|(i, frame)| (frame.seconds - i as f64 / 24.0).abs() < 1e-9));
    let from = VideoOptions { start_seconds: 250.0 / 24.0, ..VideoOptions::default() };
    let later = read_all(&path, &from, 50).unwrap();
    assert_eq!(later[..], frames[250..]);
}

/// The first few hundred frames; with `HEARTIAN_ALL_FRAMES=1` every one.
#[test]
fn planes_are_bit_identical_to_ffmpegs() {
    let (Some(path), true) = (real_clip(), have_ffmpeg()) else { return };
    let most = if std::env::var_os("HEARTIAN_ALL_FRAMES").is_some() { usize::MAX } else { 400 };
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-i"]).arg(&path).args(["-f", "rawvideo", "-pix_fmt", "yuv420p", "-"]);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut oracle = child.stdout.take().unwrap();
    let mut ours = mp4::Mp4::open(&path, 0.0).unwrap().unwrap();
    let mut theirs = vec![0; 360 * 288 * 3 / 2];
    let mut frames = 0;
    while frames < most && oracle.read_exact(&mut theirs).is_ok() {
        let (_, picture) = ours.next_picture().unwrap().unwrap();
        assert!([&picture.y[..], &picture.u, &picture.v].concat() == theirs, "frame {frames} differs");
        frames += 1;
    }
    child.kill().unwrap();
    child.wait().unwrap();
    if most == usize::MAX {
        assert!(ours.next_picture().unwrap().is_none());
        println!("{frames} frames");
    }
    assert!(frames == most || most == usize::MAX);
}

#[test]
fn colours_and_times_agree_with_ffmpegs() {
    let (Some(path), true) = (real_clip(), have_ffmpeg()) else { return };
    let mut oracle = ffmpeg::Ffmpeg::open(&path, "H.264").unwrap();
    let mut ours = open(&path, &VideoOptions::default()).unwrap();
    for _ in 0..100 {
        let (a, b) = (oracle.next_frame().unwrap().unwrap(), ours.next_frame().unwrap().unwrap());
        assert!((a.seconds - b.seconds).abs() < 1e-6);
        // ffmpeg repeats chroma samples where we interpolate, and rounds otherwise.
        let apart = a.image.data.iter().zip(&b.image.data).map(|(a, b)| f64::from(a.abs_diff(*b)));
        let mean = apart.sum::<f64>() / a.image.data.len() as f64;
        assert!(mean < 1.5, "mean difference {mean}");
    }
}

/// Phone recordings lie on their side with a display matrix; browsers write fragments: both must read as ffmpeg does.
#[test]
fn turned_and_fragmented_files_read_like_the_plain_one() {
    let (Some(path), true) = (real_clip(), have_ffmpeg()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let plain = read_all(&path, &VideoOptions::default(), 30).unwrap();
    let remux = |name: &str, before: &[&str], after: &[&str]| {
        let out = folder.path().join(name);
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error"]).args(before).arg("-i").arg(&path).args(["-t", "2", "-c", "copy"]).args(after);
        command.arg(&out).status().unwrap().success().then_some(out)
    };
    let fragmented = remux("f.mp4", &[], &["-movflags", "frag_keyframe+empty_moov"]).unwrap();
    let read = read_all(&fragmented, &VideoOptions::default(), 30).unwrap();
    assert!(read.iter().map(|f| &f.image).eq(plain.iter().map(|f| &f.image)));
    assert!(read.iter().zip(&plain).all(|(a, b)| (a.seconds - b.seconds).abs() < 1e-3));
    // Older ffmpegs cannot write the matrix this way.
    if let Some(side) = remux("r.mp4", &["-display_rotation", "90"], &[]) {
        let read = read_all(&side, &VideoOptions::default(), 5).unwrap();
        let mut oracle = ffmpeg::Ffmpeg::open(&side, "H.264").unwrap();
        for frame in read {
            let theirs = oracle.next_frame().unwrap().unwrap().image;
            assert_eq!((frame.image.width, frame.image.height), (theirs.width, theirs.height));
            let apart = theirs.data.iter().zip(&frame.image.data).map(|(a, b)| f64::from(a.abs_diff(*b)));
            assert!(apart.sum::<f64>() / (theirs.data.len() as f64) < 1.5);
        }
    }
}

/// What we do not decode ourselves goes through ffmpeg.
#[test]
fn other_codings_go_through_ffmpeg() {
    let (Some(path), true) = (real_clip(), have_ffmpeg()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("motion_jpeg.avi");
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-i"]).arg(&path).args(["-t", "1", "-c:v", "mjpeg", "-q:v", "2"]).arg(&out);
    assert!(command.status().unwrap().success());
    let read = read_all(&out, &VideoOptions::default(), 99).unwrap();
    assert_eq!((read.len(), read[0].image.width), (24, 360));
    assert!((read[12].seconds - 0.5).abs() < 1e-3);
}

#[test]
fn damaged_files_are_errors_not_panics() {
    let Some(path) = real_clip() else { return };
    let bytes = std::fs::read(&path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("damaged.mp4");
    // Cut short: whatever the layout, frames are missing and it must say so.
    std::fs::write(&file, &bytes[..bytes.len() / 3]).unwrap();
    let cut = read_all(&file, &VideoOptions::default(), 10_000);
    assert!(matches!(cut, Err(VideoError::Truncated { .. } | VideoError::NotVideo { .. })), "{cut:?}");
    let header = bytes.windows(4).position(|window| window == b"moov").unwrap();
    for seed in 0..60usize {
        let mut broken = bytes.clone();
        for k in 0..6 {
            let at = header + (seed * 7919 + k * 104_729) % (bytes.len() - header).min(60_000);
            broken[at] = (seed * 31 + k * 17) as u8;
        }
        std::fs::write(&file, &broken).unwrap();
        let _ = read_all(&file, &VideoOptions::default(), 3);
    }
}
