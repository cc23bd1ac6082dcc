//! A bitmap to draw text and lines on, and its PNG.

use std::sync::Once;

use heartian_space::Rgb8Image;
use plotters::prelude::{BitMapBackend, Color, DrawingArea, IntoDrawingArea, IntoFont, RGBColor, Text};
use plotters::style::{FontStyle, register_font};

use crate::ReportError;

/// The one font family of every picture; it comes with the package `epaint_default_fonts`.
pub(crate) const FONT: &str = "sans-serif";

/// Area type the figures draw on.
pub(crate) type Area<'a> = DrawingArea<BitMapBackend<'a>, plotters::coord::Shift>;

/// Runs `draw` on a picture's pixels.
pub(crate) fn draw_on(
    image: &mut Rgb8Image,
    draw: impl FnOnce(&Area<'_>) -> Result<(), ReportError>,
) -> Result<(), ReportError> {
    register_font_once();
    let size = (image.width as u32, image.height as u32);
    let area = BitMapBackend::with_buffer(&mut image.data, size).into_drawing_area();
    draw(&area)?;
    area.present().map_err(drawing)
}

/// Writes one line of text with its top-left corner at `position`, pixels.
pub(crate) fn write_text(
    area: &Area<'_>,
    text: &str,
    position: (i32, i32),
    (size_px, color): (u32, RGBColor),
) -> Result<(), ReportError> {
    let font = (FONT, size_px).into_font().color(&color.to_rgba());
    area.draw(&Text::new(text.to_owned(), position, font)).map_err(drawing)
}

/// The picture as a PNG file.
///
/// # Errors
/// When the encoder refuses (a size of zero).
pub fn encode_png(image: &Rgb8Image) -> Result<Vec<u8>, ReportError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.write_header()?.write_image_data(&image.data)?;
    Ok(bytes)
}

/// Largest side of a picture that is read, pixels.
const MOST_SIDE: u32 = 8192;

/// An 8-bit RGB picture from the bytes of a PNG file; grey, palette and 16-bit files are converted, alpha is dropped.
///
/// # Errors
/// When it is no PNG, is damaged, or has a side of more than 8192 pixels.
pub fn decode_png(bytes: &[u8]) -> Result<Rgb8Image, ReportError> {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info()?;
    let (width, height) = (reader.info().width, reader.info().height);
    if width.max(height) > MOST_SIDE {
        return Err(ReportError::Size { width, height, most: MOST_SIDE });
    }
    let mut data = vec![0; reader.output_buffer_size().unwrap_or(0)];
    let info = reader.next_frame(&mut data)?;
    let samples = info.color_type.samples();
    let pixels = data[..info.buffer_size()].chunks_exact(samples);
    let rgb = |p: &[u8]| if samples < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] };
    let image = Rgb8Image { width: width as usize, height: height as usize, data: pixels.flat_map(rgb).collect() };
    Ok(image)
}

/// Any drawing error as ours.
pub(crate) fn drawing<E: std::error::Error + Send + Sync>(
    error: plotters::drawing::DrawingAreaErrorKind<E>,
) -> ReportError {
    ReportError::Drawing(error.to_string())
}

fn register_font_once() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // A font that does not parse leaves text out; every drawing call then reports it.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_back_and_damaged_ones_are_refused() -> Result<(), ReportError> {
        let image = Rgb8Image { width: 3, height: 2, data: (0..18).map(|k| k * 13).collect() };
        let bytes = encode_png(&image)?;
        assert_eq!(decode_png(&bytes)?, image);
        assert!(decode_png(b"no picture").is_err() && decode_png(&[]).is_err());
        for cut in 0..bytes.len() {
            // A file that ends early is refused or read; it never panics.
            let _ = decode_png(&bytes[..cut]);
            let mut flipped = bytes.clone();
            flipped[cut] ^= 0x5a;
            let _ = decode_png(&flipped);
        }
        let mut grey = Vec::new();
        let mut encoder = png::Encoder::new(&mut grey, 2, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header()?.write_image_data(&[7, 200])?;
        assert_eq!(decode_png(&grey)?.data, [7, 7, 7, 200, 200, 200]);
        Ok(())
    }
}
