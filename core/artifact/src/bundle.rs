//! Tensors and JSON, to and from `safetensors` bytes.
//!
//! Holds at all times: tensor names are sorted, data are little-endian and contiguous, and there is one metadata key
//! (`heartian`), so equal bundles give equal bytes.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use safetensors::tensor::{Metadata, TensorInfo};
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;

use crate::ArtifactError;

const METADATA_KEY: &str = "heartian";
/// The length of the header stands before it, little-endian.
const LENGTH: usize = 8;
/// No reader of safetensors takes a larger header, bytes.
const LARGEST_HEADER: usize = 100_000_000;

/// Element types a tensor may hold.
pub trait Element: Copy + 'static {
    /// The safetensors type.
    const DTYPE: Dtype;
    /// The name used in errors.
    const NAME: &'static str;
    /// Little-endian bytes of a slice, borrowed where the machine's order allows.
    fn bytes_of(values: &[Self]) -> Cow<'_, [u8]>;
    /// Reads that many values of little-endian bytes, straight to where they stay.
    ///
    /// # Errors
    /// When there are fewer, or they cannot be read.
    fn read(count: usize, from: &mut dyn Read) -> std::io::Result<Vec<Self>>;
}

macro_rules! element {
    ($type:ty, $dtype:ident, $name:literal) => {
        impl Element for $type {
            const DTYPE: Dtype = Dtype::$dtype;
            const NAME: &'static str = $name;
            fn bytes_of(values: &[Self]) -> Cow<'_, [u8]> {
                if cfg!(target_endian = "little") {
                    Cow::Borrowed(bytemuck::cast_slice(values))
                } else {
                    Cow::Owned(values.iter().flat_map(|v| v.to_le_bytes()).collect())
                }
            }
            fn read(count: usize, from: &mut dyn Read) -> std::io::Result<Vec<Self>> {
                let mut values = vec![<$type>::default(); count];
                from.read_exact(bytemuck::cast_slice_mut(&mut values))?;
                if cfg!(target_endian = "big") {
                    values.iter_mut().for_each(|value| *value = <$type>::from_le_bytes(value.to_ne_bytes()));
                }
                Ok(values)
            }
        }
    };
}
element!(u8, U8, "u8");
element!(u16, U16, "u16");
element!(u32, U32, "u32");
element!(i32, I32, "i32");
element!(f32, F32, "f32");
element!(f64, F64, "f64");

/// One tensor, borrowed from the artifact where possible.
#[derive(Debug)]
pub struct Tensor<'a> {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Cow<'a, [u8]>,
}

/// An artifact taken apart: named tensors and one JSON object.
#[derive(Debug, Default)]
pub struct Bundle<'a> {
    tensors: BTreeMap<String, Tensor<'a>>,
    meta: serde_json::Map<String, Value>,
}

impl<'a> Bundle<'a> {
    /// An empty bundle.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a tensor borrowed from `values`.
    ///
    /// # Errors
    /// When `shape` does not multiply to the number of values.
    pub fn tensor<T: Element>(mut self, name: &str, shape: &[usize], values: &'a [T]) -> Result<Self, ArtifactError> {
        let count = shape.iter().try_fold(1usize, |product, size| product.checked_mul(*size));
        if count != Some(values.len()) {
            return Err(ArtifactError::Shape {
                name: name.to_owned(),
                expected: format!("{} values", values.len()),
                found: shape.to_vec(),
            });
        }
        let tensor = Tensor { dtype: T::DTYPE, shape: shape.to_vec(), bytes: T::bytes_of(values) };
        self.tensors.insert(name.to_owned(), tensor);
        Ok(self)
    }

    /// Adds a JSON value.
    ///
    /// # Errors
    /// When the value does not serialise.
    pub fn meta<T: serde::Serialize>(mut self, name: &str, value: &T) -> Result<Self, ArtifactError> {
        self.meta.insert(name.to_owned(), serde_json::to_value(value)?);
        Ok(self)
    }

    /// The safetensors file in pieces: its header, then every tensor's bytes where they lie, so that storing a bundle
    /// copies none of it. Equal bundles give equal bytes.
    ///
    /// # Errors
    /// When the names and shapes need a larger header than readers take.
    pub fn pieces(&self) -> Result<Vec<Cow<'_, [u8]>>, ArtifactError> {
        let format = |error: safetensors::SafeTensorError| ArtifactError::Format(error.to_string());
        // The order of the format's own writer: wider elements first, so that all are aligned.
        let mut order: Vec<(&String, &Tensor<'_>)> = self.tensors.iter().collect();
        order.sort_by(|(a, left), (b, right)| right.dtype.cmp(&left.dtype).then(a.cmp(b)));
        let mut end = 0;
        let info = |(name, tensor): &(&String, &Tensor<'_>)| {
            let start = end;
            end += tensor.bytes.len();
            let info = TensorInfo { dtype: tensor.dtype, shape: tensor.shape.clone(), data_offsets: (start, end) };
            ((*name).clone(), info)
        };
        let infos = order.iter().map(info).collect();
        let meta = HashMap::from([(METADATA_KEY.to_owned(), serde_json::to_string(&self.meta)?)]);
        let mut header = serde_json::to_vec(&Metadata::new(Some(meta), infos).map_err(format)?)?;
        header.resize(header.len().next_multiple_of(LENGTH), b' ');
        if header.len() > LARGEST_HEADER {
            return Err(ArtifactError::Format(format!("its header has {} bytes", header.len())));
        }
        let mut first = (header.len() as u64).to_le_bytes().to_vec();
        first.append(&mut header);
        let data = order.into_iter().map(|(_, tensor)| Cow::Borrowed(&*tensor.bytes));
        Ok(std::iter::once(Cow::Owned(first)).chain(data).collect())
    }

    /// The safetensors file: the pieces joined.
    ///
    /// # Errors
    /// As [`Bundle::pieces`].
    pub fn to_bytes(&self) -> Result<Vec<u8>, ArtifactError> {
        Ok(self.pieces()?.concat())
    }
}

/// Reads an artifact's parts back.
pub struct BundleReader<'a> {
    source: Source<'a>,
    meta: serde_json::Map<String, Value>,
}

/// Where tensors lie until asked for.
enum Source<'a> {
    Bytes(SafeTensors<'a>),
    /// Their offsets count from `data`.
    File {
        file: File,
        header: Metadata,
        data: u64,
    },
}

impl<'a> BundleReader<'a> {
    /// Parses the header; tensor data stay where they are until asked for.
    ///
    /// # Errors
    /// When the bytes are not a safetensors file or its metadata is not ours.
    pub fn new(bytes: &'a [u8]) -> Result<Self, ArtifactError> {
        let format = |error: safetensors::SafeTensorError| ArtifactError::Format(error.to_string());
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(format)?;
        Ok(Self { meta: meta(&header)?, source: Source::Bytes(SafeTensors::deserialize(bytes).map_err(format)?) })
    }

    /// The same of a file, from which every tensor is read when asked for and straight to where it stays.
    ///
    /// # Errors
    /// As [`BundleReader::new`]; or the file cannot be read.
    pub fn of_file(mut file: File) -> Result<BundleReader<'static>, ArtifactError> {
        let unreadable = |error: std::io::Error| ArtifactError::Format(error.to_string());
        let size = file.metadata().map_err(unreadable)?.len();
        let mut length = [0; LENGTH];
        file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        file.read_exact(&mut length).map_err(unreadable)?;
        let data = u64::from_le_bytes(length).saturating_add(LENGTH as u64);
        if data > size.min(LARGEST_HEADER as u64) {
            return Err(ArtifactError::Format("its header is longer than the file".into()));
        }
        let mut text = vec![0; data as usize - LENGTH];
        file.read_exact(&mut text).map_err(unreadable)?;
        let header: Metadata =
            serde_json::from_slice(&text).map_err(|error| ArtifactError::Format(error.to_string()))?;
        if header.data_len() as u64 != size - data {
            return Err(ArtifactError::Format("its header does not cover the file".into()));
        }
        Ok(BundleReader { meta: meta(&header)?, source: Source::File { file, header, data } })
    }

    /// Names of the tensors present, unsorted.
    pub fn tensor_names(&self) -> Vec<String> {
        match &self.source {
            Source::Bytes(tensors) => tensors.names().into_iter().map(str::to_owned).collect(),
            Source::File { header, .. } => header.offset_keys(),
        }
    }

    /// A tensor's shape and values.
    ///
    /// # Errors
    /// When it is absent, holds another element type, or cannot be read.
    pub fn tensor<T: Element>(&self, name: &str) -> Result<(Vec<usize>, Vec<T>), ArtifactError> {
        let missing = || ArtifactError::Missing(name.to_owned());
        let count = |dtype: Dtype, shape: &[usize]| {
            let found = || format!("{dtype:?}");
            if dtype == T::DTYPE {
                Ok(shape.iter().product())
            } else {
                Err(ArtifactError::Element { name: name.to_owned(), expected: T::NAME, found: found() })
            }
        };
        let unreadable = |error: std::io::Error| ArtifactError::Format(format!("tensor `{name}`: {error}"));
        match &self.source {
            Source::Bytes(tensors) => {
                let view = tensors.tensor(name).map_err(|_| missing())?;
                let values = T::read(count(view.dtype(), view.shape())?, &mut view.data()).map_err(unreadable)?;
                Ok((view.shape().to_vec(), values))
            }
            Source::File { file, header, data } => {
                let info = header.info(name).ok_or_else(missing)?;
                let count = count(info.dtype, &info.shape)?;
                let mut file = file;
                file.seek(SeekFrom::Start(data + info.data_offsets.0 as u64)).map_err(unreadable)?;
                Ok((info.shape.clone(), T::read(count, &mut file).map_err(unreadable)?))
            }
        }
    }

    /// A tensor of exactly `shape`; a `None` size matches anything.
    ///
    /// # Errors
    /// When it is absent, of another element type, or of another shape.
    pub fn shaped<T: Element>(&self, name: &str, shape: &[Option<usize>]) -> Result<Vec<T>, ArtifactError> {
        let (found, values) = self.tensor(name)?;
        let fits = found.len() == shape.len()
            && found.iter().zip(shape).all(|(size, wanted)| wanted.is_none_or(|wanted| wanted == *size));
        if fits {
            return Ok(values);
        }
        let sizes: Vec<String> = shape.iter().map(|s| s.map_or("any".into(), |s| s.to_string())).collect();
        Err(ArtifactError::Shape { name: name.to_owned(), expected: format!("[{}]", sizes.join(", ")), found })
    }

    /// A JSON value.
    ///
    /// # Errors
    /// When it is absent or of another form.
    pub fn meta<T: serde::de::DeserializeOwned>(&self, name: &str) -> Result<T, ArtifactError> {
        let value = self.meta.get(name).ok_or_else(|| ArtifactError::Missing(name.to_owned()))?;
        Ok(serde_json::from_value(value.clone())?)
    }
}

/// The JSON object under our key; empty without.
fn meta(header: &Metadata) -> Result<serde_json::Map<String, Value>, ArtifactError> {
    let text = header.metadata().as_ref().and_then(|map| map.get(METADATA_KEY));
    Ok(text.map_or_else(|| Ok(serde_json::Map::new()), |text| serde_json::from_str(text))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_bundles_give_equal_bytes_and_read_back() -> Result<(), ArtifactError> {
        let (pixels, times) = ([1u8, 2, 3, 4, 5, 6], [0.0f64, f64::NAN]);
        let make = || -> Result<Vec<u8>, ArtifactError> {
            Bundle::new().tensor("b", &[2, 3], &pixels)?.tensor("a", &[2], &times)?.meta("label", &"input")?.to_bytes()
        };
        let bytes = make()?;
        assert_eq!(bytes, make()?);
        let reader = BundleReader::new(&bytes)?;
        assert_eq!(reader.shaped::<u8>("b", &[None, Some(3)])?, pixels);
        assert_eq!(reader.meta::<String>("label")?, "input");
        assert_eq!(reader.tensor::<f64>("a")?.1[1].to_bits(), f64::NAN.to_bits());
        Ok(())
    }

    #[test]
    fn the_pieces_are_the_file_that_the_formats_own_writer_makes() -> Result<(), ArtifactError> {
        let (bytes, words, halves) = ([1u8, 2, 3], [0.5f64], [7u16, 9]);
        let bundle =
            Bundle::new().tensor("z", &[3], &bytes)?.tensor("b", &[1], &words)?.tensor("a", &[1, 2], &halves)?;
        let bundle = bundle.meta("label", &"two words")?;
        let theirs: BTreeMap<&str, safetensors::tensor::TensorView<'_>> = bundle
            .tensors
            .iter()
            .filter_map(|(name, t)| {
                let view = safetensors::tensor::TensorView::new(t.dtype, t.shape.clone(), &t.bytes).ok()?;
                Some((name.as_str(), view))
            })
            .collect();
        let meta = HashMap::from([(METADATA_KEY.to_owned(), "{\"label\":\"two words\"}".to_owned())]);
        let want = safetensors::serialize(theirs.iter(), Some(meta)).unwrap_or_default();
        assert_eq!(bundle.to_bytes()?, want);
        assert!(bundle.pieces()?[1..].iter().all(|piece| matches!(piece, Cow::Borrowed(_))), "nothing is copied");
        Ok(())
    }

    #[test]
    fn a_file_reads_as_its_bytes_do_and_cut_short_it_is_refused() -> Result<(), Box<dyn std::error::Error>> {
        let (pixels, times) = ([1u8, 2, 3, 4, 5, 6], [0.25f64, -1.0]);
        let bundle = Bundle::new().tensor("pixels", &[2, 3], &pixels)?.tensor("times", &[2], &times)?;
        let bytes = bundle.meta("label", &"input")?.to_bytes()?;
        let path = std::env::temp_dir().join(format!("heartian-bundle-{}", std::process::id()));
        let open = |bytes: &[u8]| {
            std::fs::write(&path, bytes)?;
            File::open(&path)
        };
        let reader = BundleReader::of_file(open(&bytes)?)?;
        assert_eq!(reader.shaped::<u8>("pixels", &[None, Some(3)])?, pixels);
        assert_eq!(
            (reader.tensor::<f64>("times")?.1, reader.meta::<String>("label")?),
            (times.to_vec(), "input".into())
        );
        assert!(matches!(reader.tensor::<f32>("times"), Err(ArtifactError::Element { .. })));
        assert!(matches!(reader.tensor::<f32>("none"), Err(ArtifactError::Missing(_))));
        assert_eq!(reader.tensor_names(), ["times", "pixels"]);
        for cut in [0, 7, 8, 40, bytes.len() - 1] {
            assert!(BundleReader::of_file(open(&bytes[..cut])?).is_err(), "{cut} bytes");
        }
        assert!(BundleReader::of_file(open(&u64::MAX.to_le_bytes())?).is_err());
        std::fs::remove_file(&path)?;
        Ok(())
    }

    #[test]
    fn wrong_parts_are_named() -> Result<(), ArtifactError> {
        assert!(Bundle::new().tensor("x", &[usize::MAX, 2], &[0u8]).is_err());
        let bytes = Bundle::new().tensor("x", &[1, 2], &[0f32, 1.0])?.to_bytes()?;
        let reader = BundleReader::new(&bytes)?;
        assert!(matches!(reader.tensor::<u8>("x"), Err(ArtifactError::Element { .. })));
        assert!(matches!(reader.shaped::<f32>("x", &[Some(2)]), Err(ArtifactError::Shape { .. })));
        assert!(matches!(reader.tensor::<f32>("y"), Err(ArtifactError::Missing(_))));
        assert!(BundleReader::new(&bytes[..7]).is_err());
        Ok(())
    }
}
