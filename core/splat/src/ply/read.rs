//! Reads a `.ply` point cloud of Gaussians as any program may have written it: binary of either byte order or text,
//! properties in any order and of any number type, others beside them.
//!
//! What always holds: a header is at most [`HEADER_MOST_BYTES`], a line of a text body at most [`LINE_MOST_BYTES`], and
//! memory grows with what was read, never with what the header claims.

use super::{NAMES, SH_CONSTANT};
use crate::gaussians::RawGaussians;
use std::io::{BufRead, Read};

const HEADER_MOST_BYTES: u64 = 65_536;
const LINE_MOST_BYTES: u64 = 1 << 20;
/// More Gaussians than this are refused.
const MOST: usize = 1 << 26;

/// How numbers are written.
#[derive(Clone, Copy, PartialEq)]
enum Form {
    Text,
    Little,
    Big,
}

/// A number type.
#[derive(Clone, Copy)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn named(name: &str) -> Result<Self, String> {
        Ok(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            other => return Err(format!("property type {} is not known", shown(other))),
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in `bytes`, of which there are [`Kind::bytes`].
    fn value(self, bytes: &[u8], form: Form) -> f32 {
        let mut little = [0u8; 8];
        let width = self.bytes().min(bytes.len());
        little[..width].copy_from_slice(&bytes[..width]);
        if form == Form::Big {
            little[..width].reverse();
        }
        let [a, b, c, d, ..] = little;
        match self {
            Self::I8 => f32::from(a as i8),
            Self::U8 => f32::from(a),
            Self::I16 => f32::from(i16::from_le_bytes([a, b])),
            Self::U16 => f32::from(u16::from_le_bytes([a, b])),
            Self::I32 => i32::from_le_bytes([a, b, c, d]) as f32,
            Self::U32 => u32::from_le_bytes([a, b, c, d]) as f32,
            Self::F32 => f32::from_le_bytes([a, b, c, d]),
            Self::F64 => f64::from_le_bytes(little) as f32,
        }
    }
}

/// A name from a file, fit to be shown.
fn shown(name: &str) -> String {
    name.chars().take(40).collect::<String>().escape_debug().to_string()
}

/// What the header says of the vertices.
struct Layout {
    form: Form,
    count: usize,
    /// Number type and place among [`NAMES`] of each property.
    properties: Vec<(Kind, Option<usize>)>,
}

/// Reads a scene.
pub fn parse(source: &mut impl BufRead) -> Result<RawGaussians, String> {
    let layout = parse_header(source)?;
    let mut scene = RawGaussians::default();
    match layout.form {
        Form::Text => read_text(source, &layout, &mut scene)?,
        _ => read_binary(source, &layout, &mut scene)?,
    }
    Ok(scene)
}

/// The next line without its end, of at most `most` bytes; `None` at the end of the file.
fn line(source: &mut impl BufRead, most: u64, what: &str) -> Result<Option<String>, String> {
    let mut bytes = Vec::new();
    let read = source.take(most).read_until(b'\n', &mut bytes).map_err(|e| e.to_string())?;
    if read == 0 {
        return Ok(None);
    }
    if bytes.last() != Some(&b'\n') && read as u64 == most {
        return Err(format!("a line of its {what} does not end"));
    }
    let text = String::from_utf8(bytes).map_err(|_| format!("its {what} is not text"))?;
    Ok(Some(text.trim_end().to_owned()))
}

fn parse_header(source: &mut impl BufRead) -> Result<Layout, String> {
    let (mut form, mut count, mut properties) = (None, None, Vec::new());
    let (mut in_vertex, mut left) = (false, HEADER_MOST_BYTES);
    if line(source, left, "header").ok().flatten().as_deref() != Some("ply") {
        return Err("this is not a ply file".into());
    }
    loop {
        let text = line(source, left, "header")?.ok_or("its header does not end")?;
        left = left.checked_sub(text.len() as u64 + 1).filter(|left| *left > 0).ok_or("its header does not end")?;
        let words: Vec<&str> = text.split_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => break,
            ["format", "ascii", ..] => form = Some(Form::Text),
            ["format", "binary_little_endian", ..] => form = Some(Form::Little),
            ["format", "binary_big_endian", ..] => form = Some(Form::Big),
            ["format", other, ..] => return Err(format!("format {} is not known", shown(other))),
            ["element", "vertex", number] if count.is_none() => {
                let number: u64 = number.parse().map_err(|_| format!("{} is no count of vertices", shown(number)))?;
                count = Some(
                    usize::try_from(number)
                        .ok()
                        .filter(|n| *n <= MOST)
                        .ok_or_else(|| format!("it claims {number} vertices; at most {MOST} are read"))?,
                );
                in_vertex = true;
            }
            ["element", _, "0"] => in_vertex = false,
            ["element", ..] if count.is_none() => return Err("the vertices must be its first element".into()),
            ["element", ..] => in_vertex = false,
            ["property", "list", ..] if in_vertex => return Err("a vertex has a list; Gaussians have none".into()),
            ["property", kind, name] if in_vertex => {
                let place = NAMES.iter().position(|known| known == name);
                if properties.iter().any(|(_, other)| place.is_some() && *other == place) {
                    return Err(format!("property {name} comes twice"));
                }
                properties.push((Kind::named(kind)?, place));
            }
            _ => {}
        }
    }
    let form = form.ok_or("its header names no format")?;
    let count = count.ok_or("its header names no vertices")?;
    for (place, name) in NAMES.iter().enumerate().filter(|(place, _)| !(3..6).contains(place)) {
        if !properties.iter().any(|(_, known)| *known == Some(place)) {
            return Err(format!("property {name} is missing"));
        }
    }
    Ok(Layout { form, count, properties })
}

fn read_binary(source: &mut impl BufRead, layout: &Layout, scene: &mut RawGaussians) -> Result<(), String> {
    let stride: usize = layout.properties.iter().map(|(kind, _)| kind.bytes()).sum();
    let mut row = vec![0u8; stride];
    for read in 0..layout.count {
        source.read_exact(&mut row).map_err(|_| cut_short(read, layout.count))?;
        let (mut values, mut at) = ([0.0; NAMES.len()], 0);
        for (kind, place) in &layout.properties {
            if let Some(place) = place {
                values[*place] = kind.value(&row[at..], layout.form);
            }
            at += kind.bytes();
        }
        push(scene, &values);
    }
    Ok(())
}

fn read_text(source: &mut impl BufRead, layout: &Layout, scene: &mut RawGaussians) -> Result<(), String> {
    let mut read = 0;
    while read < layout.count {
        let text = line(source, LINE_MOST_BYTES, "body")?.ok_or_else(|| cut_short(read, layout.count))?;
        if text.is_empty() {
            continue;
        }
        let (mut values, mut words) = ([0.0; NAMES.len()], text.split_whitespace());
        for (_, place) in &layout.properties {
            let word = words.next().ok_or_else(|| format!("vertex {read} has too few numbers"))?;
            let value: f32 = word.parse().map_err(|_| format!("vertex {read}: {} is no number", shown(word)))?;
            if let Some(place) = place {
                values[*place] = value;
            }
        }
        push(scene, &values);
        read += 1;
    }
    Ok(())
}

fn cut_short(read: usize, count: usize) -> String {
    format!("it is cut short: it holds {read} of its {count} vertices; copy or export it again")
}

fn push(scene: &mut RawGaussians, values: &[f32; NAMES.len()]) {
    let three = |from: usize| [values[from], values[from + 1], values[from + 2]];
    scene.means.push(three(0));
    scene.colors.push(three(6).map(|c| 0.5 + SH_CONSTANT * c));
    scene.logits.push(values[9]);
    scene.log_scales.push(three(10));
    scene.rotations.push([values[13], values[14], values[15], values[16]]);
}
