//! A checked cursor over the content of MP4 boxes: big-endian numbers, tables, children. Reading past the end is an error.

/// A result whose error says what is wrong with the file.
pub(super) type Parsed<T> = Result<T, &'static str>;

const CUT: &str = "a box ends before its content";

/// A cursor over one box's content.
#[derive(Clone, Copy)]
pub(in crate::video) struct Cursor<'a>(pub &'a [u8]);

impl<'a> Cursor<'a> {
    pub fn take(&mut self, count: usize) -> Parsed<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(count).ok_or(CUT)?;
        self.0 = tail;
        Ok(head)
    }

    pub fn array<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        self.take(N)?.try_into().map_err(|_| CUT)
    }

    pub fn u8(&mut self) -> Parsed<u8> {
        Ok(self.array::<1>()?[0])
    }

    pub fn u16(&mut self) -> Parsed<u16> {
        Ok(u16::from_be_bytes(self.array()?))
    }

    pub fn u32(&mut self) -> Parsed<u32> {
        Ok(u32::from_be_bytes(self.array()?))
    }

    pub fn i32(&mut self) -> Parsed<i32> {
        Ok(i32::from_be_bytes(self.array()?))
    }

    pub fn u64(&mut self) -> Parsed<u64> {
        Ok(u64::from_be_bytes(self.array()?))
    }

    /// A 32- or 64-bit number by the box's version.
    pub fn word(&mut self, version: u8) -> Parsed<u64> {
        if version == 1 { self.u64() } else { Ok(u64::from(self.u32()?)) }
    }

    /// Version and flags.
    pub fn full(&mut self) -> Parsed<(u8, u32)> {
        let word = self.u32()?;
        Ok(((word >> 24) as u8, word & 0xff_ffff))
    }

    /// The number of entries of a table, checked against the bytes left.
    pub fn count(&mut self, entry_bytes: usize) -> Parsed<usize> {
        let count = self.u32()? as usize;
        if count.checked_mul(entry_bytes).is_some_and(|bytes| bytes <= self.0.len()) { Ok(count) } else { Err(CUT) }
    }

    /// The next child box: kind and content.
    pub fn child(&mut self) -> Parsed<Option<([u8; 4], Cursor<'a>)>> {
        if self.0.len() < 8 {
            return Ok(None);
        }
        let (size, kind) = (self.u32()?, self.array::<4>()?);
        let content = match size {
            0 => self.take(self.0.len())?,
            1 => {
                let long = usize::try_from(self.u64()?).ok().and_then(|size| size.checked_sub(16)).ok_or(CUT)?;
                self.take(long)?
            }
            size => self.take((size as usize).checked_sub(8).ok_or(CUT)?)?,
        };
        Ok(Some((kind, Cursor(content))))
    }

    /// The first child of a kind.
    pub fn find(mut self, wanted: &[u8; 4]) -> Parsed<Option<Cursor<'a>>> {
        while let Some((kind, content)) = self.child()? {
            if kind == *wanted {
                return Ok(Some(content));
            }
        }
        Ok(None)
    }

    pub fn path(self, path: &[&[u8; 4]]) -> Parsed<Option<Cursor<'a>>> {
        let mut at = Some(self);
        for kind in path {
            at = match at {
                Some(content) => content.find(kind)?,
                None => None,
            };
        }
        Ok(at)
    }

    pub fn need(self, path: &[&[u8; 4]], what: &'static str) -> Parsed<Cursor<'a>> {
        self.path(path)?.ok_or(what)
    }
}
