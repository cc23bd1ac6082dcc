//! One picture file, recognised by its first bytes: PNG, JPEG, OpenEXR, Windows bitmap. 8-bit sRGB out.
//!
//! Grey is repeated, transparency dropped, 16 bits cut to 8; OpenEXR holds linear light and is encoded. A size is believed
//! only when it is sane, so a lying header costs no memory.

use std::io::{Cursor, Read};
use std::path::Path;

use heartian_space::Rgb8Image;
use heartian_space::color::{quantise, srgb_from_linear};
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::VideoError;
use super::bitmap::{self, LONGEST_SIDE, is_sane};
use crate::guard::guarded;

/// Largest picture file, bytes.
const LARGEST_FILE: u64 = 1 << 30;
const ABSURD: &str = "its picture size is absurd";

/// Endings of the files that a folder of frames may hold, lower case; those of one picture format in one entry.
pub(super) const ENDINGS: [&[&str]; 4] = [&["png"], &["jpg", "jpeg"], &["exr"], &["bmp"]];

/// Reads one picture.
pub(super) fn read(path: &Path) -> Result<Rgb8Image, VideoError> {
    let io = |error| VideoError::File { path: path.to_owned(), error };
    let mut bytes = Vec::new();
    std::fs::File::open(path).map_err(io)?.take(LARGEST_FILE).read_to_end(&mut bytes).map_err(io)?;
    parse(&bytes).map_err(|reason| VideoError::Picture { path: path.to_owned(), reason })
}

/// Reads a picture from its file's bytes; the error says what is wrong with it.
pub(super) fn parse(bytes: &[u8]) -> Result<Rgb8Image, String> {
    let decode = match bytes {
        [0x89, b'P', b'N', b'G', ..] => parse_png,
        [0xff, 0xd8, ..] => parse_jpeg,
        [0x76, 0x2f, 0x31, 0x01, ..] => parse_exr,
        [b'B', b'M', ..] => bitmap::parse_file,
        [] => return Err("the file is empty".into()),
        _ => return Err("it is no PNG, JPEG, OpenEXR or BMP file".into()),
    };
    guarded(|| decode(bytes)).unwrap_or_else(|| Err("the decoder gave up".into()))
}

fn parse_png(bytes: &[u8]) -> Result<Rgb8Image, String> {
    let damaged = |error: png::DecodingError| error.to_string();
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let size = reader.output_buffer_size().filter(|_| is_sane(width, height)).ok_or(ABSURD)?;
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(damaged)?;
    let channels = info.color_type.samples();
    let pixels = buffer[..info.buffer_size()].chunks_exact(channels);
    let data = pixels.flat_map(|p| if channels < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] }).collect();
    Rgb8Image::from_data(width, height, data).map_err(|error| error.to_string())
}

fn parse_jpeg(bytes: &[u8]) -> Result<Rgb8Image, String> {
    let options = DecoderOptions::default()
        .set_max_width(LONGEST_SIDE)
        .set_max_height(LONGEST_SIDE)
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions().filter(|(width, height)| is_sane(*width, *height)).ok_or(ABSURD)?;
    let data = decoder.decode().map_err(|error| error.to_string())?;
    Rgb8Image::from_data(width, height, data).map_err(|error| error.to_string())
}

fn parse_exr(bytes: &[u8]) -> Result<Rgb8Image, String> {
    use exr::prelude::{MetaData, ReadChannels, ReadLayers, read};
    let damaged = |error: exr::error::Error| format!("it is damaged or of an unsupported kind: {error}");
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    if !meta.headers.iter().all(|header| is_sane(header.layer_size.width(), header.layer_size.height())) {
        return Err(ABSURD.into());
    }
    let picture = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| Rgb8Image::filled(size.width(), size.height(), [0; 3]),
            |image: &mut Rgb8Image, at, (r, g, b): (f32, f32, f32)| {
                image.set_pixel(at.x(), at.y(), [r, g, b].map(|linear| quantise(srgb_from_linear(linear))));
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;
    Ok(picture.layer_data.channel_data.pixels)
}
