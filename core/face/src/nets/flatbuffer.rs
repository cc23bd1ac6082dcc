//! A bounds-checked walker over FlatBuffer tables.
//!
//! A table starts with a signed offset back to its vtable; the vtable holds, per field, the field's offset in the table
//! (0 = absent, the default applies). Vectors and sub-tables are reached by unsigned offsets relative to their own place.

use super::NetError;

/// A position inside the buffer, always checked on use.
#[derive(Clone, Copy, Debug)]
pub(super) struct Table<'a> {
    bytes: &'a [u8],
    at: usize,
}

const CUT: NetError = NetError::Malformed("an offset points outside the file");

fn read<const N: usize>(bytes: &[u8], at: usize) -> Result<[u8; N], NetError> {
    let end = at.checked_add(N).ok_or(CUT)?;
    bytes.get(at..end).and_then(|slice| slice.try_into().ok()).ok_or(CUT)
}

fn follow(bytes: &[u8], at: usize) -> Result<usize, NetError> {
    at.checked_add(u32::from_le_bytes(read(bytes, at)?) as usize).ok_or(CUT)
}

impl<'a> Table<'a> {
    /// The root table.
    pub fn root(bytes: &'a [u8]) -> Result<Self, NetError> {
        Ok(Self { bytes, at: follow(bytes, 0)? })
    }

    fn field(&self, id: usize) -> Result<Option<usize>, NetError> {
        let back = i32::from_le_bytes(read(self.bytes, self.at)?);
        let vtable =
            (self.at as i64).checked_sub(i64::from(back)).and_then(|at| usize::try_from(at).ok()).ok_or(CUT)?;
        let length = usize::from(u16::from_le_bytes(read(self.bytes, vtable)?));
        let slot = 4 + 2 * id;
        if slot + 2 > length {
            return Ok(None);
        }
        let offset = usize::from(u16::from_le_bytes(read(self.bytes, vtable.checked_add(slot).ok_or(CUT)?)?));
        Ok((offset != 0).then_some(self.at.checked_add(offset).ok_or(CUT)?))
    }

    /// A one-byte field, as a signed number.
    pub fn byte(&self, id: usize, default: i8) -> Result<i8, NetError> {
        self.field(id)?.map_or(Ok(default), |at| Ok(i8::from_le_bytes(read(self.bytes, at)?)))
    }

    /// A four-byte signed field.
    pub fn int(&self, id: usize, default: i32) -> Result<i32, NetError> {
        self.field(id)?.map_or(Ok(default), |at| Ok(i32::from_le_bytes(read(self.bytes, at)?)))
    }

    /// A table field.
    pub fn table(&self, id: usize) -> Result<Option<Self>, NetError> {
        self.field(id)?.map(|at| Ok(Self { bytes: self.bytes, at: follow(self.bytes, at)? })).transpose()
    }

    /// A vector of bytes; empty when absent.
    pub fn bytes(&self, id: usize) -> Result<&'a [u8], NetError> {
        self.elements(id, 1)
    }

    /// A string; empty when absent.
    pub fn text(&self, id: usize) -> Result<&'a str, NetError> {
        std::str::from_utf8(self.bytes(id)?).map_err(|_| NetError::Malformed("a name is not UTF-8"))
    }

    /// A vector of four-byte signed numbers; empty when absent.
    pub fn ints(&self, id: usize) -> Result<Vec<i32>, NetError> {
        Ok(self.elements(id, 4)?.as_chunks::<4>().0.iter().map(|bytes| i32::from_le_bytes(*bytes)).collect())
    }

    /// A vector of two-byte unsigned numbers; empty when absent.
    pub fn shorts(&self, id: usize) -> Result<Vec<i32>, NetError> {
        Ok(self.elements(id, 2)?.as_chunks::<2>().0.iter().map(|b| i32::from(u16::from_le_bytes(*b))).collect())
    }

    /// A vector of tables; empty when absent.
    pub fn tables(&self, id: usize) -> Result<Vec<Self>, NetError> {
        let Some(start) = self.field(id)?.map(|at| follow(self.bytes, at)).transpose()? else { return Ok(Vec::new()) };
        let count = self.elements(id, 4)?.len() / 4;
        (0..count).map(|i| Ok(Self { bytes: self.bytes, at: follow(self.bytes, start + 4 + 4 * i)? })).collect()
    }

    fn elements(&self, id: usize, size: usize) -> Result<&'a [u8], NetError> {
        let Some(at) = self.field(id)? else { return Ok(&[]) };
        let start = follow(self.bytes, at)?;
        let count = u32::from_le_bytes(read(self.bytes, start)?) as usize;
        let from = start.checked_add(4).ok_or(CUT)?;
        let to = count.checked_mul(size).and_then(|length| from.checked_add(length)).ok_or(CUT)?;
        self.bytes.get(from..to).ok_or(CUT)
    }
}
