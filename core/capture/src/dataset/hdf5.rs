//! MATLAB's `.mat` of version 7.3, which is HDF5: a narrow door to the `hdf5-pure` crate.
//!
//! Axes come reversed (MATLAB's last is HDF5's first). Rows of the first axis are read one by one; a claim of a size that no
//! recording has is refused before anything is read, and a panic of the crate on a damaged file is an error.

use std::path::Path;

use hdf5_pure::{DType, File};

use crate::guard::guarded;

/// Most values of one row of the first axis (SCAMPS: 35 million), and of a trace.
const MOST_IN_ROW: usize = 1 << 26;
const MOST_IN_TRACE: usize = 1 << 22;
/// A real array is hardly a hundred times smaller than its values.
const MOST_COMPRESSION: u64 = 4096;

type Parsed<T> = Result<T, String>;

/// Whether the first bytes of a file are HDF5, MATLAB's block of 512 bytes before it or not.
pub(crate) fn is_hdf5(head: &[u8]) -> bool {
    const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
    [0, 512].iter().any(|at| head.get(*at..at + 8) == Some(SIGNATURE))
}

/// An open file.
pub(crate) struct Hdf5 {
    file: File,
    bytes: u64,
}

impl Hdf5 {
    pub fn open(path: &Path) -> Parsed<Self> {
        let bytes = std::fs::metadata(path).map_err(|error| error.to_string())?.len();
        let file = fenced(|| File::open_streaming(path))?;
        Ok(Self { file, bytes })
    }

    /// Names of the arrays at the top.
    pub fn names(&self) -> Parsed<Vec<String>> {
        fenced(|| self.file.root().datasets())
    }

    /// An array's axes in HDF5's order, checked against the file's size.
    pub fn shape(&self, name: &str) -> Parsed<Vec<usize>> {
        let shape = fenced(|| self.file.dataset(name)?.shape())?;
        let values = shape.iter().try_fold(1u64, |count, side| count.checked_mul(*side));
        if values.is_none_or(|values| values > self.bytes.saturating_mul(MOST_COMPRESSION)) {
            return Err(format!("`{name}` claims the absurd size {shape:?}"));
        }
        shape.iter().map(|side| usize::try_from(*side).map_err(|_| format!("`{name}` is absurdly long"))).collect()
    }

    /// Whether an array holds 8-bit whole numbers.
    pub fn is_bytes(&self, name: &str) -> Parsed<bool> {
        Ok(matches!(fenced(|| self.file.dataset(name)?.dtype())?, DType::U8))
    }

    /// A small array's numbers.
    pub fn numbers(&self, name: &str) -> Parsed<Vec<f64>> {
        if self.shape(name)?.iter().product::<usize>() > MOST_IN_TRACE {
            return Err(format!("`{name}` is absurdly long"));
        }
        fenced(|| self.file.dataset(name)?.read_f64())
    }

    /// Hands over one row of the first axis, some values at a time.
    pub fn row<E: From<String>>(
        &self,
        name: &str,
        row: usize,
        each: &mut dyn FnMut(&[f64]) -> Result<(), E>,
    ) -> Result<(), E> {
        let values: usize = self.shape(name)?.iter().skip(1).product();
        if values > MOST_IN_ROW {
            return Err(format!("`{name}` is too large: {values} values a channel").into());
        }
        let row = row as u64;
        let data = fenced(|| self.file.dataset(name))?;
        let mut hand = |numbers: &mut dyn Iterator<Item = f64>| {
            loop {
                let batch: Vec<f64> = std::iter::from_fn(|| numbers.next()).take(1 << 13).collect();
                if batch.is_empty() {
                    return Ok(());
                }
                each(&batch)?;
            }
        };
        match fenced(|| data.dtype())? {
            DType::U8 => hand(&mut fenced(|| data.read_u8_rows(row, 1))?.into_iter().map(f64::from)),
            DType::F32 => hand(&mut fenced(|| data.read_f32_rows(row, 1))?.into_iter().map(f64::from)),
            DType::F64 => hand(&mut fenced(|| data.read_f64_rows(row, 1))?.into_iter()),
            other => Err(format!("`{name}` holds values of another class ({other:?})").into()),
        }
    }
}

/// Runs the crate behind a wall.
fn fenced<T>(work: impl FnOnce() -> Result<T, hdf5_pure::Error>) -> Parsed<T> {
    match guarded(work) {
        Some(Ok(value)) => Ok(value),
        Some(Err(error)) => Err(error.to_string()),
        None => Err("the file is damaged".into()),
    }
}
