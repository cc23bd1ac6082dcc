//! Writers of each data set's layout, by its description and nothing of the readers'.

use std::path::Path;

use heartian_space::Rgb8Image;

use super::mat_writer;

/// Size of the written frames.
const SIZE: (usize, usize) = (10, 6);

/// The frame of a folder or AVI: every pixel known.
pub fn picture(frame: usize) -> Rgb8Image {
    let mut image = Rgb8Image::filled(SIZE.0, SIZE.1, [0; 3]);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            image.set_pixel(x, y, [(frame * 5 + x) as u8, (y * 30) as u8, (x * y + frame) as u8]);
        }
    }
    image
}

/// The frame of an array, the same as the golden files hold.
pub fn codes(t: usize) -> Rgb8Image {
    let mut image = Rgb8Image::filled(8, 6, [0; 3]);
    for y in 0..6 {
        for x in 0..8 {
            let code = [3 * t + 10 * y + 7 * x, 5 * t + 20 * y + 3 * x, 9 * t + y + 17 * x];
            image.set_pixel(x, y, code.map(|value| (value % 256) as u8));
        }
    }
    image
}

/// Rows bottom up, blue first, padded to four bytes.
fn bgr(image: &Rgb8Image) -> Vec<u8> {
    let mut out = Vec::new();
    for y in (0..image.height).rev() {
        (0..image.width).for_each(|x| out.extend(image.pixel(x, y).iter().rev()));
        out.resize(out.len().next_multiple_of(4), 0);
    }
    out
}

fn words(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn chunk(tag: &[u8], body: &[u8]) -> Vec<u8> {
    let mut out = [tag, &(body.len() as u32).to_le_bytes(), body].concat();
    out.resize(out.len().next_multiple_of(2), 0);
    out
}

/// A raw AVI at 25 frames a second.
pub fn avi(frames: &[Rgb8Image]) -> Vec<u8> {
    let list = |name: &[u8], body: &[u8]| chunk(b"LIST", &[name, body].concat());
    let (width, height) = (frames[0].width as u32, frames[0].height as u32);
    let strh = [&b"vidsDIB "[..], &words(&[0, 0, 0, 1, 25, 0, frames.len() as u32, 0, 0, 0, 0, 0])].concat();
    let strf = words(&[40, width, height, 1 | 24 << 16, 0, 0, 0, 0, 0, 0]);
    let strl = list(b"strl", &[chunk(b"strh", &strh), chunk(b"strf", &strf)].concat());
    let hdrl = list(b"hdrl", &[chunk(b"avih", &words(&[40000; 14])), strl].concat());
    let movi: Vec<u8> = frames.iter().flat_map(|frame| chunk(b"00db", &bgr(frame))).collect();
    chunk(b"RIFF", &[b"AVI ".to_vec(), hdrl, list(b"movi", &movi)].concat())
}

/// A Windows bitmap.
fn bmp(image: &Rgb8Image) -> Vec<u8> {
    let pixels = bgr(image);
    let size = 54 + pixels.len() as u32;
    let info = words(&[40, image.width as u32, image.height as u32, 1 | 24 << 16, 0, 0, 0, 0, 0, 0]);
    [b"BM".to_vec(), words(&[size, 0, 54]), info, pixels].concat()
}

fn line(numbers: &[f64]) -> String {
    numbers.iter().map(|number| format!("   {number:.7e}")).collect::<String>() + "\n"
}

/// `subjectN/vid.avi` and `ground_truth.txt`: pulse, heart rate, times.
pub fn ubfc(folder: &Path, frames: usize, lines: [&[f64]; 3]) {
    std::fs::create_dir_all(folder).unwrap();
    let pictures: Vec<Rgb8Image> = (0..frames).map(picture).collect();
    std::fs::write(folder.join("vid.avi"), avi(&pictures)).unwrap();
    std::fs::write(folder.join("ground_truth.txt"), lines.map(line).concat()).unwrap();
}

/// `SS-TT/SS-TT/Image<ns>.png` and `SS-TT.json`; without clocks frames are numbered and samples bare.
pub fn pure(folder: &Path, frames: usize, clocks: bool) {
    let name = folder.file_name().unwrap().to_str().unwrap();
    std::fs::create_dir_all(folder.join(name)).unwrap();
    let start = 1_392_643_993_642_815_000u64;
    let seconds = |count: f64| start + (count * 1e9) as u64;
    let mut images = Vec::new();
    for frame in 0..frames {
        let stamp = seconds((frame + usize::from(frame >= 10)) as f64 / 30.0);
        let file = if clocks { format!("Image{stamp}.png") } else { format!("Image{frame}.png") };
        let file = std::fs::File::create(folder.join(name).join(file)).unwrap();
        let mut encoder = png::Encoder::new(file, SIZE.0 as u32, SIZE.1 as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&picture(frame).data).unwrap();
        images.push(format!("{{\"Timestamp\": {stamp}, \"Value\": {{\"imageID\": {frame}}}}}"));
    }
    let sample = |k: usize| {
        let value = format!("\"Value\": {{\"waveform\": {}, \"pulseRate\": 72, \"o2saturation\": 98}}", 40 + k % 13);
        let stamp = format!("\"Timestamp\": {}, ", start - 250_000_000 + k as u64 * 16_666_667);
        format!("{{{}{value}}}", if clocks { stamp } else { String::new() })
    };
    let samples: Vec<String> = (0..75).map(sample).collect();
    let images = if clocks { images.join(",") } else { String::new() };
    let text = format!("{{\"/FullPackage\": [{}], \"/Image\": [{images}]}}", samples.join(","));
    std::fs::write(folder.join(format!("{name}.json")), text).unwrap();
}

/// `subjectN/pN_k.mat` with single-precision video by columns.
pub fn mmpd(path: &Path, light: &str) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut video = Vec::new();
    for channel in 0..3 {
        for x in 0..8 {
            for y in 0..6 {
                let value = |t: usize| f32::from(codes(t).pixel(x, y)[channel]) / 255.0;
                video.extend((0..12).flat_map(|t| value(t).to_le_bytes()));
            }
        }
    }
    let pulse: Vec<u8> = (0..24).flat_map(|k| (f64::from(k) / 3.0).sin().to_le_bytes()).collect();
    let text = |name: &str, value: &str| mat_writer::text(name, value, false);
    let elements = [
        mat_writer::array("video", 7, &[12, 6, 8, 3], (7, &video), false),
        mat_writer::array("GT_ppg", 6, &[1, 24], (9, &pulse), false),
        text("light", light),
        text("motion", "Stationary (after exercise)"),
        text("exercise", "True"),
        mat_writer::array("skin_color", 6, &[1, 1], (2, &[5]), false),
        text("gender", "male"),
        text("glasser", "False"),
        text("hair_cover", "False"),
        text("makeup", "False"),
    ];
    std::fs::write(path, mat_writer::file(&elements, false)).unwrap();
}

/// `pXX_y/pXX_y_rgb/*.bmp` and `pXX_y_bvp.csv`, two samples a frame, a quarter of them bad.
pub fn ibvp(folder: &Path, frames: usize) {
    let name = folder.file_name().unwrap().to_str().unwrap();
    let pictures = folder.join(format!("{name}_rgb"));
    std::fs::create_dir_all(&pictures).unwrap();
    for frame in 0..frames {
        std::fs::write(pictures.join(format!("{name}_{frame}.bmp")), bmp(&picture(frame))).unwrap();
    }
    let line =
        |k: usize| format!("{},{k},1,{}\n", (k as f64 / 5.0).sin(), if (20..35).contains(&k) { 0.3 } else { 0.9 });
    let lines: String = (0..2 * frames).map(line).collect();
    std::fs::write(folder.join(format!("{name}_bvp.csv")), format!("BVP,Time,SQ1,SQ2\n{lines}")).unwrap();
}
