//! Columns of numbers from a CSV file: contact PPG, beats, intervals.
//!
//! Reading is bounded in memory and tolerant of what spreadsheets leave behind (blank lines, spaces, a byte-order mark,
//! CRLF, further columns, semicolons and tabs). It is not tolerant of numbers that are not numbers: a pulse with NaN in it
//! has no right answer, so the line is named and nothing is guessed.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Largest file read, bytes: a day at 1 kHz is below.
const MAX_BYTES: u64 = 1 << 31;
/// Longest line read, bytes.
const MAX_LINE: u64 = 1 << 16;
/// How much of a wrong text is shown, characters.
const SHOWN: usize = 40;

/// What can be wrong with a file of numbers.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CsvError {
    /// It cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A line does not hold the numbers it should.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// 1-based line.
        line: usize,
        /// What is wrong there, and what would be right.
        reason: String,
    },
}

/// A kind of table: the names its first columns must have, and what a value in each is called in an error.
#[derive(Clone, Copy, Debug)]
pub struct CsvKind {
    /// Header, lower case.
    pub header: &'static [&'static str],
    /// As in `the time`.
    pub values: &'static [&'static str],
}

/// Reads a file whose header is one of `kinds`: which one, and its columns.
///
/// # Errors
/// When the file cannot be read, its header is none of them, or a line does not hold finite numbers.
pub fn read_csv(path: &Path, kinds: &[CsvKind]) -> Result<(usize, Vec<Vec<f64>>), CsvError> {
    let read = |source| CsvError::Read { path: path.to_owned(), source };
    let mut reader = BufReader::new(std::fs::File::open(path).map_err(read)?.take(MAX_BYTES));
    let mut found: Option<(usize, char)> = None;
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for number in 1.. {
        let wrong = |reason: String| CsvError::Line { path: path.to_owned(), line: number, reason };
        let mut bytes = Vec::new();
        let taken = reader.by_ref().take(MAX_LINE).read_until(b'\n', &mut bytes).map_err(read)?;
        if taken == 0 && number > 1 {
            break;
        }
        if taken as u64 == MAX_LINE {
            return Err(wrong(format!("the line is longer than {MAX_LINE} bytes; this is no table of numbers")));
        }
        let text = String::from_utf8_lossy(&bytes);
        let line = text.trim_start_matches('\u{feff}').trim();
        match found {
            None => {
                let kind = find_kind(line, kinds).map_err(wrong)?;
                columns = vec![Vec::new(); kinds[kind.0].header.len()];
                found = Some(kind);
            }
            Some(_) if line.is_empty() => {}
            Some((kind, separator)) => {
                let mut cells = line.split(separator).map(str::trim);
                for (column, name) in columns.iter_mut().zip(kinds[kind].values) {
                    column.push(finite(name, cells.next().unwrap_or("")).map_err(wrong)?);
                }
            }
        }
    }
    Ok((found.map_or(0, |(kind, _)| kind), columns))
}

fn finite(name: &str, text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("{name} is `{}`, not a finite number; remove the line or interpolate", shown(text))),
    }
}

fn shown(text: &str) -> String {
    text.chars().take(SHOWN).collect()
}

/// Which kind a header line is, and its separator.
fn find_kind(line: &str, kinds: &[CsvKind]) -> Result<(usize, char), String> {
    let is = |kind: &CsvKind, separator: char| {
        let mut cells = line.split(separator).map(|cell| cell.trim().to_ascii_lowercase());
        kind.header.iter().all(|name| cells.next().as_deref() == Some(*name))
    };
    let kinds_and_separators =
        (0..kinds.len()).flat_map(|kind| [',', ';', '\t'].into_iter().map(move |separator| (kind, separator)));
    let found = kinds_and_separators.into_iter().find(|(kind, separator)| is(&kinds[*kind], *separator));
    found.ok_or_else(|| {
        let wanted: Vec<String> = kinds.iter().map(|kind| format!("`{}`", kind.header.join(","))).collect();
        format!("the first line is `{}`; it must be the header {}", shown(line), wanted.join(" or "))
    })
}
