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
