//! Tables as Parquet files, for pandas, DuckDB, Polars and Spark.
//!
//! One row group, one uncompressed `PLAIN` page a column, required columns of `DOUBLE` (a figure that could not be measured
//! is NaN) and UTF-8 `BYTE_ARRAY`. That subset of the format is two hundred lines; the `parquet` crate, with every feature
//! off, brings fifteen crates and a minute of build for the same bytes.

use heartian_space::{Cells, Table};

const MAGIC: &[u8; 4] = b"PAR1";
const CREATED_BY: &str = concat!("heartian version ", env!("CARGO_PKG_VERSION"));

/// Numbers of the format's enumerations.
mod code {
    pub const DOUBLE: i64 = 5;
    pub const BYTE_ARRAY: i64 = 6;
    pub const REQUIRED: i64 = 0;
    pub const UTF8: i64 = 0;
    pub const PLAIN: i64 = 0;
    pub const RLE: i64 = 3;
    pub const UNCOMPRESSED: i64 = 0;
    pub const DATA_PAGE: i64 = 0;
}

/// The table as a Parquet file.
pub fn table_parquet(table: &Table) -> Vec<u8> {
    let mut file = MAGIC.to_vec();
    let mut chunks = Vec::new();
    for (name, cells) in table.columns() {
        let (offset, page) = (file.len(), page(cells));
        let mut header = Compact::new();
        header.integer(1, code::DATA_PAGE).integer(2, page.len() as i64).integer(3, page.len() as i64);
        header.structure(5, |data| {
            data.integer(1, cells.len() as i64).integer(2, code::PLAIN).integer(3, code::RLE).integer(4, code::RLE);
        });
        file.extend(header.end());
        file.extend(page);
        chunks.push(Chunk { name, cells, offset, size: file.len() - offset });
    }
    let footer = footer(table, &chunks);
    let length = footer.len() as u32;
    file.extend(footer);
    file.extend(length.to_le_bytes());
    file.extend(MAGIC);
    file
}

/// A column as it lies in the file.
struct Chunk<'a> {
    name: &'a str,
    cells: &'a Cells,
    /// Where its page header begins.
    offset: usize,
    /// Bytes of header and page.
    size: usize,
}

/// A column's values in `PLAIN` encoding. Words longer than 4 GiB do not occur in tables.
fn page(cells: &Cells) -> Vec<u8> {
    match cells {
        Cells::Numbers(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Cells::Text(words) => {
            let word = |word: &String| [&(word.len() as u32).to_le_bytes()[..], word.as_bytes()].concat();
            words.iter().flat_map(word).collect()
        }
    }
}

fn kind(cells: &Cells) -> i64 {
    match cells {
        Cells::Numbers(_) => code::DOUBLE,
        Cells::Text(_) => code::BYTE_ARRAY,
    }
}

/// The file's metadata.
fn footer(table: &Table, chunks: &[Chunk<'_>]) -> Vec<u8> {
    let (rows, size) = (table.rows() as i64, chunks.iter().map(|chunk| chunk.size as i64).sum());
    let mut meta = Compact::new();
    meta.integer(1, 1);
    meta.list(2, chunks.len() + 1, |index, element| match index.checked_sub(1).map(|column| &chunks[column]) {
        None => {
            element.text(4, "table").integer(5, chunks.len() as i64);
        }
        Some(chunk) => {
            element.integer(1, kind(chunk.cells)).integer(3, code::REQUIRED).text(4, chunk.name);
            if matches!(chunk.cells, Cells::Text(_)) {
                element.integer(6, code::UTF8);
            }
        }
    });
    meta.long(3, rows);
    meta.list(4, usize::from(!chunks.is_empty()), |_, group| {
        group.list(1, chunks.len(), |index, column| {
            let chunk = &chunks[index];
            column.long(2, chunk.offset as i64).structure(3, |data| {
                data.integer(1, kind(chunk.cells));
                data.integers(2, &[code::PLAIN]).texts(3, &[chunk.name]).integer(4, code::UNCOMPRESSED);
                data.long(5, rows).long(6, chunk.size as i64).long(7, chunk.size as i64).long(9, chunk.offset as i64);
            });
        });
        group.long(2, size).long(3, rows);
    });
    meta.text(6, CREATED_BY);
    meta.end()
}

/// A Thrift structure in the compact protocol, written field by field in the order of their numbers (apart by at most 15).
struct Compact {
    bytes: Vec<u8>,
    field: u8,
}

/// Wire types of the compact protocol.
mod wire {
    pub const I32: u8 = 5;
    pub const I64: u8 = 6;
    pub const BINARY: u8 = 8;
    pub const LIST: u8 = 9;
    pub const STRUCT: u8 = 12;
}

impl Compact {
    fn new() -> Self {
        Self { bytes: Vec::new(), field: 0 }
    }

    fn head(&mut self, field: u8, wire: u8) {
        self.bytes.push(((field - self.field) << 4) | wire);
        self.field = field;
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    fn zigzag(&mut self, value: i64) {
        self.varint(((value << 1) ^ (value >> 63)) as u64);
    }

    fn integer(&mut self, field: u8, value: i64) -> &mut Self {
        self.head(field, wire::I32);
        self.zigzag(value);
        self
    }

    fn long(&mut self, field: u8, value: i64) -> &mut Self {
        self.head(field, wire::I64);
        self.zigzag(value);
        self
    }

    fn raw_text(&mut self, text: &str) {
        self.varint(text.len() as u64);
        self.bytes.extend(text.as_bytes());
    }

    fn text(&mut self, field: u8, text: &str) -> &mut Self {
        self.head(field, wire::BINARY);
        self.raw_text(text);
        self
    }

    fn structure(&mut self, field: u8, fill: impl FnOnce(&mut Self)) -> &mut Self {
        self.head(field, wire::STRUCT);
        self.nested(fill);
        self
    }

    fn nested(&mut self, fill: impl FnOnce(&mut Self)) {
        let mut inner = Self::new();
        fill(&mut inner);
        self.bytes.extend(inner.end());
    }

    fn list_head(&mut self, field: u8, count: usize, wire: u8) {
        self.head(field, wire::LIST);
        if count < 15 {
            self.bytes.push(((count as u8) << 4) | wire);
        } else {
            self.bytes.push(0xf0 | wire);
            self.varint(count as u64);
        }
    }

    /// A list of structures, each filled by its index.
    fn list(&mut self, field: u8, count: usize, mut fill: impl FnMut(usize, &mut Self)) -> &mut Self {
        self.list_head(field, count, wire::STRUCT);
        (0..count).for_each(|index| self.nested(|inner| fill(index, inner)));
        self
    }

    fn integers(&mut self, field: u8, values: &[i64]) -> &mut Self {
        self.list_head(field, values.len(), wire::I32);
        values.iter().for_each(|value| self.zigzag(*value));
        self
    }

    fn texts(&mut self, field: u8, texts: &[&str]) -> &mut Self {
        self.list_head(field, texts.len(), wire::BINARY);
        texts.iter().for_each(|text| self.raw_text(text));
        self
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_space::SpaceError;

    fn table(columns: usize, rows: usize) -> Result<Table, SpaceError> {
        let column = |index: usize| match index % 2 {
            0 => (format!("words {index}"), Cells::Text((0..rows).map(|row| format!("ä{row}")).collect())),
            _ => (format!("figures {index}"), Cells::Numbers((0..rows).map(|row| 0.5 * row as f64).collect())),
        };
        Table::new((0..columns).map(column).collect())
    }

    /// Every page lies where the footer's length says it ends, in the table's order, value by value.
    #[test]
    fn pages_hold_the_values_and_the_footer_its_length() -> Result<(), SpaceError> {
        let bytes = table_parquet(&table(20, 3)?);
        let n = bytes.len();
        assert_eq!((&bytes[..4], &bytes[n - 4..]), (&MAGIC[..], &MAGIC[..]));
        let footer = n - 8 - u32::from_le_bytes([bytes[n - 8], bytes[n - 7], bytes[n - 6], bytes[n - 5]]) as usize;
        let pages = &bytes[4..footer];
        let figures: Vec<u8> = [0.0f64, 0.5, 1.0].into_iter().flat_map(f64::to_le_bytes).collect();
        let found = |wanted: &[u8]| pages.windows(wanted.len()).filter(|window| *window == wanted).count();
        assert_eq!(found(&figures), 10);
        assert_eq!(found(&[3, 0, 0, 0, 0xc3, 0xa4, b'0', 3, 0, 0, 0, 0xc3, 0xa4, b'1']), 10);
        let names = String::from_utf8_lossy(&bytes[footer..]);
        assert!((0..20).all(|index| names.matches(&format!(" {index}")).count() >= 2), "schema and chunk name each");
        Ok(())
    }

    #[test]
    fn small_numbers_are_written_as_thrift_writes_them() {
        let mut compact = Compact::new();
        compact.integer(1, -1).long(3, 300).text(4, "hi").integers(5, &[0, 3]);
        assert_eq!(compact.end(), [0x15, 1, 0x26, 0xd8, 4, 0x18, 2, b'h', b'i', 0x19, 0x25, 0, 6, 0]);
    }

    /// Kept for other readers: `HEARTIAN_KEEP_PICTURES=DIR cargo test -p heartian-report` leaves tables there.
    #[test]
    fn tables_of_any_size_are_written() -> Result<(), SpaceError> {
        for (columns, rows) in [(0, 0), (1, 0), (2, 1), (33, 200)] {
            let bytes = table_parquet(&table(columns, rows)?);
            assert!(bytes.len() > 12);
            if let Some(folder) = std::env::var_os("HEARTIAN_KEEP_PICTURES") {
                let path = std::path::Path::new(&folder).join(format!("table_{columns}x{rows}.parquet"));
                std::fs::write(path, bytes).expect("writable");
            }
        }
        Ok(())
    }
}
