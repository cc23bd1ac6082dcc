//! The zip archive that `torch.save` writes: one pickle and one member per storage.
//!
//! A member is read no further than the size the pickle gives it, so a compressed bomb unfolds to nothing; a storage shared
//! by several tensors is read once; views (offset, strides) are copied out row-major.

use std::collections::HashMap;
use std::io::Cursor;

use heartian_foreign::Archive;

use super::torch::{self, Kind, TensorRecord};
use super::{MOST_VALUES, Tensor, Weights, damaged};
use crate::DecoderError;

/// Largest pickle read, bytes; that of a 483-tensor network is 60 kB.
const MOST_PICKLE_BYTES: u64 = 8 << 20;
const AGAIN: &str = "copy or download it again";

/// Reads all tensors of the archive.
pub fn read(bytes: &[u8]) -> Result<Weights, DecoderError> {
    let mut zip = Archive::open(Cursor::new(bytes))?;
    let pickle_name = zip.names().find(|name| *name == "data.pkl" || name.ends_with("/data.pkl")).map(str::to_owned);
    let pickle_name = pickle_name.ok_or_else(|| {
        damaged("it is a zip archive without `data.pkl`", "give a .pth file written by torch.save, not another archive")
    })?;
    let prefix = pickle_name.strip_suffix("data.pkl").unwrap_or_default().to_owned();
    if zip.member(&format!("{prefix}byteorder"), 16).is_ok_and(|order| order == b"big") {
        return Err(damaged("it was written on a big-endian machine", "write it again on a little-endian one"));
    }
    let pickle = zip.member(&pickle_name, MOST_PICKLE_BYTES)?;
    let mut storages = Storages { zip, prefix, read: HashMap::new(), values_left: MOST_VALUES };
    let mut weights = Weights::default();
    let mut values_left = MOST_VALUES;
    for (name, record) in torch::read(&pickle)? {
        if record.kind == Kind::Integer {
            weights.integers.insert(name);
            continue;
        }
        let count = span(&record).map(|(count, _)| count).filter(|count| *count <= values_left);
        let count =
            count.ok_or_else(|| damaged(&format!("`{name}` is too large or reaches outside its storage"), AGAIN))?;
        values_left -= count;
        let data = gather(storages.get(&name, &record)?, &record, count);
        weights.insert(name, Tensor { shape: record.shape, data })?;
    }
    weights.without_prefix()
}

/// Number of values of a view and one past the last index it touches; `None` if that leaves the storage or overflows.
fn span(record: &TensorRecord) -> Option<(usize, usize)> {
    let count = record.shape.iter().try_fold(1usize, |n, size| n.checked_mul(*size))?;
    if count == 0 {
        return Some((0, 0));
    }
    let mut last = record.offset;
    for (size, stride) in record.shape.iter().zip(&record.strides) {
        last = last.checked_add((size - 1).checked_mul(*stride)?)?;
    }
    (last < record.storage_len).then_some((count, last + 1))
}

/// Copies a view out of its storage in row-major order; [`span`] has bounded every index.
fn gather(storage: &[f32], record: &TensorRecord, count: usize) -> Vec<f32> {
    let mut index = vec![0usize; record.shape.len()];
    let mut at = record.offset;
    let mut data = Vec::with_capacity(count);
    for _ in 0..count {
        data.push(storage[at]);
        for axis in (0..index.len()).rev() {
            index[axis] += 1;
            at += record.strides[axis];
            if index[axis] < record.shape[axis] {
                break;
            }
            at -= record.strides[axis] * record.shape[axis];
            index[axis] = 0;
        }
    }
    data
}

/// Storages by key, each read once.
struct Storages<'a> {
    zip: Archive<Cursor<&'a [u8]>>,
    prefix: String,
    read: HashMap<String, Vec<f32>>,
    values_left: usize,
}

impl Storages<'_> {
    /// The storage of a tensor, as long as the record says.
    fn get(&mut self, name: &str, record: &TensorRecord) -> Result<&[f32], DecoderError> {
        let Kind::Floating(element) = record.kind else { return Ok(&[]) };
        if !self.read.contains_key(&record.storage) {
            if record.storage_len > self.values_left {
                return Err(damaged(
                    &format!("the storage of `{name}` is too large"),
                    "decoder weights are a few megabytes",
                ));
            }
            let path = format!("{}data/{}", self.prefix, record.storage);
            let most = (record.storage_len * element.bytes()) as u64;
            let values = element.decode(&self.zip.member(&path, most)?);
            self.values_left -= values.len();
            self.read.insert(record.storage.clone(), values);
        }
        let storage = self.read.get(&record.storage).map(Vec::as_slice).unwrap_or_default();
        if storage.len() == record.storage_len {
            Ok(storage)
        } else {
            let what =
                format!("the storage of `{name}` holds {} values instead of {}", storage.len(), record.storage_len);
            Err(damaged(&what, AGAIN))
        }
    }
}
