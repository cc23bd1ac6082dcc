//! Tensors and JSON, to and from `safetensors` bytes.
//!
//! Holds at all times: tensor names are sorted, data are little-endian and contiguous, and there is one metadata key
//! (`heartian`), so equal bundles give equal bytes.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};

use safetensors::{Dtype, SafeTensors, View};
use serde_json::Value;

use crate::ArtifactError;

const METADATA_KEY: &str = "heartian";

/// Element types a tensor may hold.
pub trait Element: Copy + 'static {
    /// The safetensors type.
    const DTYPE: Dtype;
    /// The name used in errors.
    const NAME: &'static str;
    /// Little-endian bytes of a slice, borrowed where the machine's order allows.
    fn bytes_of(values: &[Self]) -> Cow<'_, [u8]>;
    /// Values from little-endian bytes; trailing partial elements do not occur (safetensors checks lengths).
    fn from_bytes(bytes: &[u8]) -> Vec<Self>;
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
            fn from_bytes(bytes: &[u8]) -> Vec<Self> {
                let (chunks, _) = bytes.as_chunks::<{ size_of::<$type>() }>();
                chunks.iter().map(|chunk| <$type>::from_le_bytes(*chunk)).collect()
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

    /// The safetensors file. Equal bundles give equal bytes.
    ///
    /// # Errors
    /// When the safetensors writer refuses a tensor.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ArtifactError> {
        let meta = serde_json::to_string(&self.meta)?;
        let metadata = HashMap::from([(METADATA_KEY.to_owned(), meta)]);
        safetensors::serialize(self.tensors.iter(), Some(metadata))
            .map_err(|error| ArtifactError::Format(error.to_string()))
    }
}

impl View for &Tensor<'_> {
    fn dtype(&self) -> Dtype {
        self.dtype
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }
    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

/// Reads an artifact's parts back from bytes.
pub struct BundleReader<'a> {
    tensors: SafeTensors<'a>,
    meta: serde_json::Map<String, Value>,
}

impl<'a> BundleReader<'a> {
    /// Parses the header; tensor data stay where they are until asked for.
    ///
    /// # Errors
    /// When the bytes are not a safetensors file or its metadata is not ours.
    pub fn new(bytes: &'a [u8]) -> Result<Self, ArtifactError> {
        let format = |error: safetensors::SafeTensorError| ArtifactError::Format(error.to_string());
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(format)?;
        let meta = match header.metadata().as_ref().and_then(|map| map.get(METADATA_KEY)) {
            Some(text) => serde_json::from_str(text)?,
            None => serde_json::Map::new(),
        };
        Ok(Self { tensors: SafeTensors::deserialize(bytes).map_err(format)?, meta })
    }

    /// Names of the tensors present, unsorted.
    pub fn tensor_names(&self) -> Vec<String> {
        self.tensors.names().into_iter().map(str::to_owned).collect()
    }

    /// A tensor's shape and values.
    ///
    /// # Errors
    /// When it is absent or holds another element type.
    pub fn tensor<T: Element>(&self, name: &str) -> Result<(Vec<usize>, Vec<T>), ArtifactError> {
        let view = self.tensors.tensor(name).map_err(|_| ArtifactError::Missing(name.to_owned()))?;
        if view.dtype() != T::DTYPE {
            return Err(ArtifactError::Element {
                name: name.to_owned(),
                expected: T::NAME,
                found: format!("{:?}", view.dtype()),
            });
        }
        Ok((view.shape().to_vec(), T::from_bytes(view.data())))
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
