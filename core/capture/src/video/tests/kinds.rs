//! Every kind of source by itself: picture formats, AVI variants, and what only ffmpeg decodes.

use super::*;

#[test]
fn the_golden_clip_decodes_as_ffmpeg_did() {
    let crc = std::fs::read_to_string(golden_path("tiny.framecrc")).unwrap();
    let told: Vec<u32> = crc
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| u32::from_str_radix(line.rsplit("0x").next().unwrap(), 16).unwrap())
        .collect();
    for name in ["tiny.mp4", "fragmented.mp4"] {
        let mut ours = mp4::Mp4::open(&golden_path(name), 0.0).unwrap().unwrap();
        for (frame, told) in told.iter().enumerate() {
            let (_, picture) = ours.next_picture().unwrap().unwrap();
            // ffmpeg's sum: Adler-32 from zero.
            let bytes = [&picture.y[..], &picture.u, &picture.v].concat();
            let (a, b) = bytes.iter().fold((0u32, 0u32), |(a, b), byte| {
                let a = (a + u32::from(*byte)) % 65521;
                (a, (b + a) % 65521)
            });
            assert_eq!(b << 16 | a, *told, "{name}, frame {frame}");
        }
        assert!(ours.next_picture().unwrap().is_none());
    }
    let frames = read_all(&golden_path("fragmented.mp4"), &VideoOptions::default(), 99).unwrap();
    assert!(frames.iter().enumerate().all(|(k, frame)| (frame.seconds - k as f64 / 24.0).abs() < 1e-6));
}

#[test]
fn pictures_of_every_kind_are_read() {
    let (ours, theirs) = ["pattern.jpg", "pattern.png"].map(|name| picture::read(&golden_path(name)).unwrap()).into();
    assert_eq!((ours.width, ours.height, theirs.width), (48, 32, 48));
    let apart = ours.data.iter().zip(&theirs.data).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>();
    assert!(apart / (ours.data.len() as f64) < 1.0, "{apart}");

    let folder = tempfile::tempdir().unwrap();
    for frame in 0..3 {
        write_exr(&folder.path().join(format!("f{frame}.EXR")), 9 + frame / 2, 7);
    }
    let read = read_all(folder.path(), &VideoOptions::default(), 2).unwrap();
    // Linear light 0.5 is the code 188; what is brighter than white is white.
    assert_eq!(read[1].image.pixel(4, 0), [188, 0, 255]);
    let all = read_all(folder.path(), &VideoOptions::default(), 9);
    assert!(matches!(all, Err(VideoError::FrameSize { expected: (9, 7), found: (10, 7), .. })));

    // A cover picture beside the frames is none of them; two kinds of frames are ambiguous.
    std::fs::copy(golden_path("pattern.jpg"), folder.path().join("cover.jpg")).unwrap();
    assert_eq!(read_all(folder.path(), &VideoOptions::default(), 2).unwrap().len(), 2);
    std::fs::copy(golden_path("pattern.jpg"), folder.path().join("cover2.jpeg")).unwrap();
    let both = open(folder.path(), &VideoOptions::default()).unwrap_err().to_string();
    assert!(both.contains("both JPG and EXR"), "{both}");
}

#[test]
fn a_picture_is_named_when_it_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let jpeg = std::fs::read(golden_path("pattern.jpg")).unwrap();
    let mut huge = std::fs::read(golden_path("pattern.png")).unwrap();
    huge[16..20].copy_from_slice(&0x7fff_ffffu32.to_be_bytes());
    for (name, bytes) in [("0.jpg", &jpeg[..jpeg.len() / 2]), ("0.png", &huge), ("0.bmp", b"BM"), ("0.exr", b"v/1\x01")]
    {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let said = read_all(folder.path(), &VideoOptions::default(), 9).unwrap_err().to_string();
        assert!(said.contains(name), "{said}");
        std::fs::remove_file(&path).unwrap();
    }
}

/// 32 bits, top-down rows, a second segment (`AVIX`), a dropped frame, junk and sound between.
#[test]
fn avi_variants_are_read() {
    let pictures: Vec<Rgb8Image> = (0..4).map(|frame| drawn(35, 24, frame)).collect();
    let plain = avi_bytes(35, 24, &pictures);
    let list = |name: &[u8], body: &[u8]| avi_chunk(b"LIST", &[name, body].concat());
    let words = |values: &[u32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let strh = [b"vidsDIB ".as_slice(), &words(&[0, 0, 0, 1, 25, 0, 5, 0, 0, 0, 0, 0])].concat();
    let strf = words(&[40, 35, (-24i32) as u32, 1 | 32 << 16, 0, 0, 0, 0, 0, 0]);
    let strl = list(b"strl", &[avi_chunk(b"strh", &strh), avi_chunk(b"strf", &strf)].concat());
    let sound = [b"auds\0\0\0\0".as_slice(), &words(&[0; 12])].concat();
    let sound = list(b"strl", &[avi_chunk(b"strh", &sound), avi_chunk(b"strf", &[0; 18])].concat());
    let hdrl = list(b"hdrl", &[avi_chunk(b"avih", &words(&[40000; 14])), sound, strl].concat());
    let body = |frame: usize| -> Vec<u8> {
        pictures[frame].data.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0], 255]).collect()
    };
    let first = [
        avi_chunk(b"01db", &body(0)),
        avi_chunk(b"00wb", &[1; 7]),
        avi_chunk(b"01db", &[]),
        avi_chunk(b"01db", &body(1)),
    ];
    let second = [avi_chunk(b"ix01", &[0; 24]), avi_chunk(b"01db", &body(2)), avi_chunk(b"01db", &body(3))];
    let junk = avi_chunk(b"JUNK", &[7; 99]);
    let riff = avi_chunk(b"RIFF", &[b"AVI ".to_vec(), hdrl, junk, list(b"movi", &first.concat())].concat());
    let avix = avi_chunk(b"RIFF", &[b"AVIX".to_vec(), list(b"movi", &second.concat())].concat());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.avi");
    std::fs::write(&path, [riff, avix].concat()).unwrap();
    let read = read_all(&path, &VideoOptions::default(), 99).unwrap();
    assert!(read.iter().map(|frame| &frame.image).eq(&pictures));
    let times: Vec<f64> = read.iter().map(|frame| (frame.seconds * 25.0).round()).collect();
    assert_eq!(times, [0.0, 2.0, 3.0, 4.0], "the dropped frame leaves its time");
    // Evened out on request, the dropped frame lies between its neighbours.
    let even = VideoOptions { resample_hertz: Some(25.0), ..VideoOptions::default() };
    let read = read_all(&path, &even, 99).unwrap();
    assert_eq!(read.len(), 5);
    let mean = |k: usize| pictures.iter().map(|picture| f64::from(picture.data[k])).take(2).sum::<f64>() / 2.0;
    assert!((0..read[1].image.data.len()).all(|k| (f64::from(read[1].image.data[k]) - mean(k)).abs() <= 1.0));

    // Lies: other sizes than the chunks hold, absurd sizes and rates, frames that are not there.
    let at = |tag: &[u8]| plain.windows(4).position(|window| window == tag).unwrap() + 8;
    for (place, value, wanted) in [
        (at(b"strf") + 4, 33u32, "not what the header says"),
        (at(b"strf") + 8, 23, "not what the header says"),
        (at(b"strf") + 4, 0, "absurd"),
        (at(b"strf") + 8, 0, "absurd"),
        (at(b"strf") + 4, 0x7fff_ffff, "absurd"),
        (at(b"strh") + 24, 0, "frame rate is zero"),
        (at(b"strh") + 24, u32::MAX, "frame rate is absurd"),
        (at(b"strh") + 32, 900, "900 frames announced"),
    ] {
        let mut lying = plain.clone();
        lying[place..place + 4].copy_from_slice(&value.to_le_bytes());
        std::fs::write(&path, lying).unwrap();
        let said = read_all(&path, &VideoOptions::default(), 99).unwrap_err().to_string();
        assert!(said.contains(wanted), "{wanted}: {said}");
    }
}

/// A video of one frame, one without any, and times that go backwards.
#[test]
fn short_and_unordered_videos_have_an_answer() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.avi");
    std::fs::write(&path, avi_bytes(35, 24, &[drawn(35, 24, 0)])).unwrap();
    assert_eq!(read_all(&path, &VideoOptions::default(), 99).unwrap().len(), 1);
    let even = VideoOptions { resample_hertz: Some(30.0), ..VideoOptions::default() };
    assert_eq!(read_all(&path, &even, 99).unwrap().len(), 1);
    std::fs::write(&path, avi_bytes(35, 24, &[])).unwrap();
    assert!(matches!(read_all(&path, &VideoOptions::default(), 99), Err(VideoError::NoFrames { .. })));

    // Decoding times of the third and fourth sample: the same.
    let mut bytes = std::fs::read(golden_path("tiny.mp4")).unwrap();
    let stts = bytes.windows(4).position(|window| window == b"stts").unwrap() + 4;
    let delta = u32::from_be_bytes(bytes[stts + 12..stts + 16].try_into().unwrap());
    bytes[stts + 12..stts + 16].copy_from_slice(&0u32.to_be_bytes());
    let path = folder.path().join("x.mp4");
    std::fs::write(&path, &bytes).unwrap();
    let mut video = open(&path, &VideoOptions::default()).unwrap();
    let mut times = Vec::new();
    while let Ok(Some(frame)) = video.next_frame() {
        times.push(frame.seconds);
    }
    assert!(delta > 0 && times.len() > 1 && times.windows(2).all(|pair| pair[1] > pair[0]), "{times:?}");
    assert!(video.warnings()[0].contains("like another"), "{:?}", video.warnings());
}

struct Told(std::vec::IntoIter<f64>);

impl FrameSource for Told {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        Ok(self.0.next().map(|seconds| TimedFrame { seconds, image: drawn(8, 8, 0) }))
    }

    fn frame_count(&self) -> Option<usize> {
        None
    }
}

#[test]
fn frames_that_go_back_in_time_are_left_out_and_named() {
    let source = Box::new(Told(vec![0.0, 0.1, 0.05, 0.1, 0.2, f64::NAN, 0.3].into_iter()));
    let path = PathBuf::from("x");
    let mut frames =
        Increasing { path, source, start_seconds: 0.0, last: None, count: 0, backward: 0, notes: Vec::new() };
    let mut times = Vec::new();
    while let Some(frame) = frames.next_frame().unwrap() {
        times.push(frame.seconds);
    }
    assert_eq!(times, [0.0, 0.1, 0.2, 0.3]);
    let wanted = "the frame after frame 1 is timed 0.050 s, not after its 0.100 s; left out, and 2 more so";
    assert_eq!(frames.notes, [wanted]);
}

/// Makes a file with ffmpeg.
fn make(path: &Path, arguments: &[&str]) {
    let mut command = Command::new("ffmpeg");
    let output = command.args(["-v", "error", "-y", "-f", "lavfi", "-i"]).args(arguments).arg(path).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// A known colour comes out whatever matrix, range and depth carried it, by our decoder or ffmpeg's.
#[test]
fn colour_matrix_range_and_depth_are_respected() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (matrix, named) in [("bt601", "smpte170m"), ("bt709", "bt709"), ("bt2020", "bt2020nc")] {
        for range in ["tv", "pc"] {
            for (name, coder, depth) in [("a.mp4", "libx264", "yuv420p"), ("b.mkv", "ffv1", "yuv420p10le")] {
                let path = folder.path().join(format!("{matrix}{range}{name}"));
                let filter = format!("scale=out_color_matrix={matrix}:out_range={range},format={depth}");
                let tags = ["-vf", &filter, "-c:v", coder, "-colorspace", named, "-color_range", range];
                make(&path, &[&["color=c=0xC86432:size=64x48:rate=10:duration=0.3"], &tags[..]].concat());
                let read = read_all(&path, &VideoOptions::default(), 9).unwrap();
                let found = read[1].image.pixel(30, 20);
                let apart = found.iter().zip([200u8, 100, 50]).map(|(a, b)| a.abs_diff(b)).max().unwrap();
                assert!(read.len() == 3 && apart <= 3, "{matrix} {range} {name}: {found:?}");
            }
        }
    }
}

/// Through ffmpeg, uneven frames keep their times, none is doubled or dropped; evened out only on request.
#[test]
fn variable_rates_keep_their_times_through_ffmpeg() {
    if !have_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("uneven.mkv");
    let [option, value] = ffmpeg::as_coded().unwrap();
    let uneven = "settb=1/1000,setpts=(N+0.4*mod(N\\,3)+5*gte(N\\,20))/(10*TB)";
    make(
        &path,
        &[
            "testsrc2=size=64x48:rate=10:duration=3",
            "-vf",
            uneven,
            option,
            value,
            "-enc_time_base",
            "1:1000",
            "-c:v",
            "ffv1",
        ],
    );
    let wanted = |n: usize| (n as f64 + 0.4 * (n % 3) as f64 + if n >= 20 { 5.0 } else { 0.0 }) / 10.0;
    let read = read_all(&path, &VideoOptions::default(), 99).unwrap();
    assert_eq!(read.len(), 30);
    assert!(read.iter().enumerate().all(|(n, frame)| (frame.seconds - wanted(n)).abs() < 2e-3));
    let even = VideoOptions { resample_hertz: Some(10.0), ..VideoOptions::default() };
    let mut video = open(&path, &even).unwrap();
    let mut times = Vec::new();
    while let Some(frame) = video.next_frame().unwrap() {
        times.push((frame.seconds * 10.0).round() as i32);
    }
    let hole = |tenth: &i32| !(20..25).contains(tenth);
    assert!(times.iter().all(|tenth| hole(tenth) || *tenth == 20), "{times:?}");
    assert!(times.len() >= 29 && video.warnings()[0].contains("no frame from"), "{:?}", video.warnings());

    // A film cut short: what is there is read, and ffmpeg's complaint is passed on, or it is an error.
    let bytes = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mkv");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let mut video = open(&cut, &VideoOptions::default()).unwrap();
    let mut count = 0;
    while let Ok(Some(_)) = video.next_frame() {
        count += 1;
    }
    assert!((5..30).contains(&count), "{count}");
    std::fs::write(&cut, &bytes[..300]).unwrap();
    let said = open(&cut, &VideoOptions::default()).unwrap_err().to_string();
    assert!(said.contains("not a video (ffmpeg finds no video in it"), "{said}");
}
