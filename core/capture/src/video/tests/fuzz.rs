//! Damaged videos and pictures are errors, never panics of ours; sizes they claim cost nothing.

use super::*;
use crate::fuzz::rounds;

fn golden(name: &str) -> Vec<u8> {
    std::fs::read(golden_path(name)).unwrap()
}

#[test]
fn fuzz_mp4() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mp4");
    rounds("MP4", 300, &[golden("tiny.mp4"), golden("fragmented.mp4")], |bytes| {
        std::fs::write(&path, bytes).unwrap();
        if let Ok(Ok(mut source)) = mp4::Mp4::open(&path, 0.0) {
            for _ in 0..4 {
                if !matches!(source.next_frame(), Ok(Some(_))) {
                    break;
                }
            }
        }
    });
}

#[test]
fn fuzz_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.exr");
    write_exr(&path, 9, 7);
    let exr = std::fs::read(&path).unwrap();
    let bmp =
        [&b"BM"[..], &[0; 8], &[54, 0, 0, 0, 40, 0, 0, 0, 5, 0, 0, 0, 3, 0, 0, 0, 1, 0, 24, 0], &[0; 72]].concat();
    assert!(picture::parse(&bmp).is_ok() && picture::parse(&exr).is_ok());
    rounds("pictures", 1500, &[golden("pattern.png"), golden("pattern.jpg"), exr, bmp], |bytes| {
        let _ = picture::parse(bytes);
    });
}
