//! MATLAB's `.mat` of versions 5 to 7: a small reader in bounded memory (MathWorks, "MAT-File Format", level 5).
//!
//! A file is a 128-byte header and elements: a tag of type and size, then data padded to eight bytes; `miCOMPRESSED` wraps
//! one element in zlib. Arrays are visited one by one: numbers stream through a small buffer, text comes whole, cells,
//! structs and sparse arrays are named and passed over. Sizes are claims: nothing is allocated on their word.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::read::ZlibDecoder;

/// Element types.
const COMPRESSED: u32 = 15;
const MATRIX: u32 = 14;
/// Longest text and most numbers that are read whole; most dimensions.
const LONGEST_TEXT: usize = 1 << 16;
const MOST_NUMBERS: usize = 1 << 24;
const MOST_DIMENSIONS: usize = 32;
/// Values decoded at once.
const BATCH: usize = 1 << 13;

type Parsed<T> = Result<T, String>;

/// What an array holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Class {
    /// Characters.
    Text,
    /// 8-bit unsigned whole numbers.
    Bytes,
    /// Any other real numbers.
    Numbers,
    /// Cells, structs, objects, sparse or complex arrays: not read.
    Other,
}

/// An array's name, class and size.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Array {
    pub name: String,
    pub class: Class,
    pub dimensions: Vec<usize>,
}

impl Array {
    /// Number of elements; nothing when that is absurd.
    pub fn len(&self) -> Option<usize> {
        self.dimensions.iter().try_fold(1usize, |count, side| count.checked_mul(*side))
    }
}

/// Whether the first bytes of a file are such a file's.
pub(crate) fn is_mat(head: &[u8]) -> bool {
    head.len() >= 128 && matches!(&head[124..128], [0, 1, b'I', b'M'] | [1, 0, b'M', b'I'])
}

/// Visits every array of a file. What `visit` leaves unread is passed over.
pub(crate) fn each(path: &Path, visit: &mut dyn FnMut(&Array, &mut Values<'_>) -> Parsed<()>) -> Parsed<()> {
    let wrong = |error: std::io::Error| error.to_string();
    let file = File::open(path).map_err(wrong)?;
    let length = file.metadata().map_err(wrong)?.len();
    let mut reader = BufReader::with_capacity(1 << 16, file);
    let mut head = [0; 128];
    reader.read_exact(&mut head).map_err(|_| "the file is cut short")?;
    if !is_mat(&head) {
        return Err("it is no MATLAB file of version 5 to 7".into());
    }
    let swapped = &head[126..] == b"MI";
    let mut at = 128u64;
    while at + 8 <= length {
        reader.seek(SeekFrom::Start(at)).map_err(wrong)?;
        let tag = Tag::read(&mut reader, swapped)?;
        let end = at + 8 + u64::from(tag.bytes);
        if end > length {
            return Err(format!("the file is cut short: an array at byte {at} reaches to byte {end} of {length}"));
        }
        let content = reader.by_ref().take(u64::from(tag.bytes));
        match tag.kind {
            COMPRESSED => {
                let mut inflated = ZlibDecoder::new(content);
                let inner = Tag::read(&mut inflated, swapped)?;
                if inner.kind == MATRIX {
                    one(&mut inflated, swapped, visit)?;
                }
            }
            MATRIX => one(&mut { content }, swapped, visit)?,
            _ => {}
        }
        // Compressed elements are not padded, others are.
        at = if tag.kind == COMPRESSED { end } else { end.next_multiple_of(8) };
    }
    Ok(())
}

/// A tag: type and size. Small elements carry up to four bytes in the tag itself.
struct Tag {
    kind: u32,
    bytes: u32,
    small: Option<[u8; 4]>,
}

impl Tag {
    fn read(reader: &mut dyn Read, swapped: bool) -> Parsed<Self> {
        let mut head = [0; 8];
        reader.read_exact(&mut head).map_err(|error| format!("an array is cut short or damaged ({error})"))?;
        let (first, rest) = (word(&head[..4], swapped) as u32, [head[4], head[5], head[6], head[7]]);
        if first >> 16 == 0 {
            return Ok(Self { kind: first, bytes: word(&rest, swapped) as u32, small: None });
        }
        let bytes = first >> 16;
        if bytes > 4 {
            return Err("an array's tag is damaged".into());
        }
        Ok(Self { kind: first & 0xffff, bytes, small: Some(rest) })
    }
}

/// Up to eight bytes as a number.
fn word(bytes: &[u8], swapped: bool) -> u64 {
    let fold = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
    if swapped { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) }
}

/// A part of an array that is short by its nature, whole.
fn part(reader: &mut dyn Read, swapped: bool, most: usize) -> Parsed<Vec<u8>> {
    let tag = Tag::read(reader, swapped)?;
    let bytes = tag.bytes as usize;
    if let Some(small) = tag.small {
        return Ok(small[..bytes].to_vec());
    }
    if bytes > most {
        return Err(format!("a part of an array's header has {bytes} bytes"));
    }
    let mut content = vec![0; bytes.next_multiple_of(8)];
    reader.read_exact(&mut content).map_err(|_| "an array's header is cut short")?;
    content.truncate(bytes);
    Ok(content)
}

/// Visits the array whose content the reader is at.
fn one(
    reader: &mut dyn Read,
    swapped: bool,
    visit: &mut dyn FnMut(&Array, &mut Values<'_>) -> Parsed<()>,
) -> Parsed<()> {
    let flags = part(reader, swapped, 8)?;
    let flags = word(flags.get(..4).ok_or("an array's flags are cut short")?, swapped);
    let sides = part(reader, swapped, 4 * MOST_DIMENSIONS)?;
    let dimensions = sides.chunks_exact(4).map(|side| word(side, swapped) as u32 as usize).collect();
    let name = String::from_utf8_lossy(&part(reader, swapped, 256)?).into_owned();
    let complex = flags & 0x800 != 0;
    let class = match flags & 0xff {
        4 => Class::Text,
        9 => Class::Bytes,
        6..=15 if !complex => Class::Numbers,
        _ => Class::Other,
    };
    let array = Array { name, class, dimensions };
    let tag = if class == Class::Other { None } else { Some(Tag::read(reader, swapped)?) };
    let mut values = Values { tag, reader, swapped, name: &array.name, count: array.len() };
    visit(&array, &mut values)
}

/// An array's values, not read yet.
pub(crate) struct Values<'a> {
    tag: Option<Tag>,
    reader: &'a mut dyn Read,
    swapped: bool,
    name: &'a str,
    count: Option<usize>,
}

impl Values<'_> {
    /// Hands all numbers over in the file's order (columns first), some at a time.
    pub fn stream(&mut self, each: &mut dyn FnMut(&[f64]) -> Parsed<()>) -> Parsed<()> {
        let name = self.name;
        let tag = self.tag.take().ok_or_else(|| format!("`{name}` holds no plain numbers or text"))?;
        let width = width(tag.kind).ok_or_else(|| format!("`{name}` has values of unknown type {}", tag.kind))?;
        let count = tag.bytes as usize / width;
        if self.count != Some(count) {
            return Err(format!("`{name}` has {count} values, which its size contradicts"));
        }
        let small = tag.small;
        let mut inline = small.as_ref().map(|bytes| &bytes[..]);
        let mut bytes = vec![0; width * BATCH.min(count)];
        let mut numbers = Vec::with_capacity(BATCH.min(count));
        let mut left = count;
        while left > 0 {
            let batch = &mut bytes[..width * BATCH.min(left)];
            let read = match &mut inline {
                Some(inline) => inline.read_exact(batch),
                None => self.reader.read_exact(batch),
            };
            read.map_err(|error| format!("`{name}` is cut short or damaged ({error})"))?;
            numbers.clear();
            numbers.extend(batch.chunks_exact(width).map(|value| number(tag.kind, word(value, self.swapped))));
            left -= numbers.len();
            each(&numbers)?;
        }
        Ok(())
    }

    /// All numbers, of an array that is small by its nature.
    pub fn numbers(&mut self) -> Parsed<Vec<f64>> {
        if self.count.is_none_or(|count| count > MOST_NUMBERS) {
            return Err(format!("`{}` is absurdly long", self.name));
        }
        let mut all = Vec::new();
        self.stream(&mut |numbers| {
            all.extend_from_slice(numbers);
            Ok(())
        })?;
        Ok(all)
    }

    /// The text of an array of characters; rows of a character matrix follow one another.
    pub fn text(&mut self, rows: usize) -> Parsed<String> {
        if self.count.is_none_or(|count| count > LONGEST_TEXT) {
            return Err(format!("`{}` is absurdly long", self.name));
        }
        let mut characters = Vec::new();
        if self.tag.as_ref().is_some_and(|tag| tag.kind == UTF8) {
            return self.utf8();
        }
        self.stream(&mut |numbers| {
            characters.extend(numbers.iter().map(|number| *number as u16));
            Ok(())
        })?;
        let rows = rows.max(1);
        let by_row = (0..rows).flat_map(|row| characters.iter().skip(row).step_by(rows).copied());
        let text: Vec<u16> = by_row.collect();
        Ok(String::from_utf16_lossy(&text).trim().to_owned())
    }

    /// Text of characters of one to four bytes: the size counts characters, the tag bytes.
    fn utf8(&mut self) -> Parsed<String> {
        let Some(tag) = self.tag.take() else { return Ok(String::new()) };
        let bytes = tag.bytes as usize;
        if bytes > 4 * LONGEST_TEXT {
            return Err(format!("`{}` is absurdly long", self.name));
        }
        let mut content = vec![0; bytes];
        match tag.small {
            Some(small) => content.copy_from_slice(&small[..bytes]),
            None => self.reader.read_exact(&mut content).map_err(|_| format!("`{}` is cut short", self.name))?,
        }
        Ok(String::from_utf8_lossy(&content).trim().to_owned())
    }
}

const UTF8: u32 = 16;

/// Bytes of a value.
fn width(kind: u32) -> Option<usize> {
    match kind {
        1 | 2 | UTF8 => Some(1),
        3 | 4 | 17 => Some(2),
        5 | 6 | 7 | 18 => Some(4),
        9 | 12 | 13 => Some(8),
        _ => None,
    }
}

/// A value from its bits.
fn number(kind: u32, bits: u64) -> f64 {
    match kind {
        1 => f64::from(bits as u8 as i8),
        3 => f64::from(bits as u16 as i16),
        5 => f64::from(bits as u32 as i32),
        7 => f64::from(f32::from_bits(bits as u32)),
        9 => f64::from_bits(bits),
        12 => bits as i64 as f64,
        _ => bits as f64,
    }
}

#[cfg(test)]
pub(super) mod tests;
