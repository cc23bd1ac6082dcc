//! A small animated PNG of clips side by side: lossless, and every browser plays it.

use heartian_space::Clip;

use crate::ReportError;
use crate::sheet::check_alike;

/// Frames a second of a preview; enough to see motion, few enough to mail.
const RATE_HERTZ: f64 = 10.0;

/// An animated PNG of `clips` side by side over black, each halved in size until at most `max_side_px`, over the first
/// `seconds` seconds.
///
/// # Errors
/// When there is no clip, the clips differ in size or length, or the encoder refuses.
pub fn encode_preview(clips: &[&Clip], max_side_px: usize, seconds: f64) -> Result<Vec<u8>, ReportError> {
    let first = *clips.first().ok_or(ReportError::Nothing("clip"))?;
    clips.iter().try_for_each(|clip| check_alike(first, clip))?;
    let mut factor = 1;
    while first.width.max(first.height) / factor > max_side_px.max(1) {
        factor *= 2;
    }
    let (width, height) = ((first.width / factor).max(1), (first.height / factor).max(1));
    let frames = frames_at_rate(first, seconds);

    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, (width * clips.len()) as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_animated(frames.len() as u32, 0)?;
    encoder.set_frame_delay(1, RATE_HERTZ as u16)?;
    let mut writer = encoder.write_header()?;
    for frame in frames {
        let mut canvas = vec![0u8; 3 * width * clips.len() * height];
        for (index, clip) in clips.iter().enumerate() {
            let small = shrunk(clip, frame, (factor, width, height));
            for (row, line) in small.chunks_exact(3 * width).enumerate() {
                let start = 3 * (row * width * clips.len() + index * width);
                canvas[start..start + 3 * width].copy_from_slice(line);
            }
        }
        writer.write_image_data(&canvas)?;
    }
    writer.finish()?;
    Ok(bytes)
}

/// Indices of the frames nearest to even times at the preview's rate, at least one.
fn frames_at_rate(clip: &Clip, seconds: f64) -> Vec<usize> {
    let start = clip.times_seconds[0];
    let count = (seconds.max(0.0) * RATE_HERTZ) as usize + 1;
    let nearest = |k: usize| clip.times_seconds.partition_point(|&time| time < start + k as f64 / RATE_HERTZ);
    (0..count).map(nearest).take_while(|&frame| frame < clip.len()).collect()
}

/// One frame over black, box-averaged by `factor`.
fn shrunk(clip: &Clip, frame: usize, (factor, width, height): (usize, usize, usize)) -> Vec<u8> {
    let image = clip.image_over_black(frame);
    let mut out = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            for channel in 0..3 {
                let block = (0..factor * factor).map(|k| (x * factor + k % factor, y * factor + k / factor));
                let sum: u32 = block.map(|(px, py)| u32::from(image.pixel(px, py)[channel])).sum();
                out.push((sum / (factor * factor) as u32) as u8);
            }
        }
    }
    out
}
