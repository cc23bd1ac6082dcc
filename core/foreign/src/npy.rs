//! numpy's `.npy` and `.npz` files.
//!
//! A header is at most [`MOST_HEADER`] bytes; an array at most as many values as the caller allows, checked before its
//! bytes are unpacked. Arrays of objects are handed out as the pickle they are.

use std::io::{Read, Seek};

use crate::numpy::{Array, Form, count};
use crate::{Archive, Element, ForeignError};

/// Longest header read, bytes; numpy's own are 128.
const MOST_HEADER: usize = 1 << 16;

/// What a `.npy` file holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Content<'a> {
    /// Numbers.
    Numbers(Array),
    /// Objects, as a pickle.
    Pickled(&'a [u8]),
}

/// Reads a `.npy` file.
///
/// # Errors
/// A damaged header, texts or records, more than `most` values, or fewer or more bytes than the shape needs.
pub fn read(bytes: &[u8], most: usize) -> Result<Content<'_>, ForeignError> {
    let cut = || ForeignError::damaged("the .npy header is cut short");
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or_else(|| ForeignError::damaged("it is no .npy array"))?;
    let (version, rest) = rest.split_first_chunk::<2>().ok_or_else(cut)?;
    let (len, rest) = if version[0] == 1 {
        let (len, rest) = rest.split_first_chunk::<2>().ok_or_else(cut)?;
        (usize::from(u16::from_le_bytes(*len)), rest)
    } else {
        let (len, rest) = rest.split_first_chunk::<4>().ok_or_else(cut)?;
        (u32::from_le_bytes(*len) as usize, rest)
    };
    if len > MOST_HEADER {
        return Err(ForeignError::too_large(format!("the .npy header claims {len} bytes")));
    }
    let (header, data) = rest.split_at_checked(len).ok_or_else(cut)?;
    let header = std::str::from_utf8(header).map_err(|_| ForeignError::damaged("the .npy header is no text"))?;
    let Header { descr, column_major, shape } = Header::parse(header)?;
    let code = descr.trim_start_matches(['<', '>', '|', '=']);
    if code.starts_with('O') {
        return Ok(Content::Pickled(data));
    }
    let element = Element::of_numpy(code).ok_or_else(|| {
        let shown: String = descr.chars().take(40).collect();
        ForeignError::refused(format!("it is an array of `{}`, not of numbers", shown.escape_debug()))
    })?;
    count(&shape, most)?;
    let form = Form { element, big_endian: descr.starts_with('>'), column_major };
    Array::decode(shape, form, data, most).map(Content::Numbers)
}

/// Reads a `.npy` file of numbers.
///
/// # Errors
/// As [`read`], and for one of objects.
pub fn array(bytes: &[u8], most: usize) -> Result<Array, ForeignError> {
    match read(bytes, most)? {
        Content::Numbers(array) => Ok(array),
        Content::Pickled(_) => Err(ForeignError::refused("it is an array of objects, not of numbers")),
    }
}

/// An `.npz` file: named arrays in a zip.
pub struct Npz<R>(Archive<R>);

impl<R: Read + Seek> Npz<R> {
    /// Reads the directory.
    ///
    /// # Errors
    /// When it is no zip archive.
    pub fn open(source: R) -> Result<Self, ForeignError> {
        Archive::open(source).map(Self)
    }

    /// Names of the arrays, without `.npy`.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.names().filter_map(|name| name.strip_suffix(".npy"))
    }

    /// An array's `.npy` bytes, to be given to [`read`]; `None` when there is none of this name. Bytes are unpacked no
    /// further than `most` values of eight bytes need.
    ///
    /// # Errors
    /// When it is damaged or larger.
    pub fn member(&mut self, name: &str, most: usize) -> Result<Option<Vec<u8>>, ForeignError> {
        let file = format!("{name}.npy");
        if !self.0.contains(&file) {
            return Ok(None);
        }
        let most = (most as u64).saturating_mul(8).saturating_add(MOST_HEADER as u64);
        self.0.member(&file, most).map(Some)
    }

    /// An array of numbers; `None` when there is none of this name.
    ///
    /// # Errors
    /// As [`Self::member`] and [`array`].
    pub fn array(&mut self, name: &str, most: usize) -> Result<Option<Array>, ForeignError> {
        self.member(name, most)?.map(|bytes| array(&bytes, most)).transpose()
    }
}

/// The three entries of a header, a Python dictionary of literals.
struct Header<'a> {
    descr: &'a str,
    column_major: bool,
    shape: Vec<usize>,
}

impl<'a> Header<'a> {
    fn parse(text: &'a str) -> Result<Self, ForeignError> {
        let value = |key: &str| -> Option<&'a str> {
            let quoted = [format!("'{key}'"), format!("\"{key}\"")];
            let after = quoted.iter().find_map(|key| text.split_once(key.as_str()))?.1;
            Some(after.trim_start().strip_prefix(':')?.trim_start())
        };
        let parsed = || {
            let descr = value("descr")?;
            let quote = descr.chars().next().filter(|c| matches!(c, '\'' | '"'));
            // A record's list of fields is kept as it is: it is no number and will be told so.
            let descr = quote.map_or(Some(descr), |quote| descr[1..].split(quote).next())?;
            let order = value("fortran_order")?;
            let column_major = order.starts_with("True");
            if !column_major && !order.starts_with("False") {
                return None;
            }
            let inside = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
            let sizes = inside.split(',').map(str::trim).filter(|size| !size.is_empty());
            let shape: Option<Vec<usize>> = sizes.map(|size| size.trim_end_matches('L').parse().ok()).collect();
            Some(Header { descr, column_major, shape: shape? })
        };
        parsed().ok_or_else(|| ForeignError::damaged("the .npy header does not say type, order and shape"))
    }
}
