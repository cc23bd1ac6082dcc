//! Named tensors from a foreign file: `.pth` (PyTorch's zip form) or `.safetensors`, told apart by content.
//!
//! Values become f32 whatever the file stores; integer tensors (batch counters) are remembered by name only. A common
//! `module.` prefix is dropped. Bounds: [`MOST_BYTES`] of file, [`MOST_VALUES`] values in all tensors together.

mod archive;
mod torch;

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::Path;

use heartian_foreign::Element;

use crate::DecoderError;

/// Largest weight file read, bytes; the largest published one is 30 MB.
pub const MOST_BYTES: u64 = 1 << 29;
/// Most values of all tensors together.
pub(crate) const MOST_VALUES: usize = 1 << 26;

/// A tensor in row-major order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensor {
    /// Sizes, slowest axis first; empty for a single number.
    pub shape: Vec<usize>,
    /// As many values as the sizes multiply to.
    pub data: Vec<f32>,
}

/// The tensors of a weight file by name; all values are finite.
#[derive(Clone, Debug, Default)]
pub struct Weights {
    tensors: BTreeMap<String, Tensor>,
    integers: BTreeSet<String>,
}

impl Weights {
    /// Reads a weight file.
    ///
    /// # Errors
    /// When the file cannot be read, is too large, damaged, of another form, or names anything but tensors.
    pub fn load(path: &Path) -> Result<Self, DecoderError> {
        let fail = |source| DecoderError::File { path: path.to_owned(), source };
        let mut bytes = Vec::new();
        std::fs::File::open(path).and_then(|file| file.take(MOST_BYTES + 1).read_to_end(&mut bytes)).map_err(fail)?;
        Self::from_bytes(&bytes)
    }

    /// As [`Self::load`], from the file's content.
    ///
    /// # Errors
    /// As there.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DecoderError> {
        if bytes.len() as u64 > MOST_BYTES {
            return Err(damaged(
                "it is larger than 512 MiB",
                "decoder weights are a few megabytes; give the right file",
            ));
        }
        if bytes.starts_with(b"PK\x03\x04") {
            archive::read(bytes)
        } else if bytes.starts_with(&[0x80, 0x02, 0x8a, 0x0a]) || bytes.starts_with(b"\x80\x02") {
            Err(damaged(
                "it is a bare pickle, the form PyTorch wrote before 1.6",
                "load it with torch.load and write it again with torch.save, or convert it to .safetensors",
            ))
        } else if bytes.len() > 9 && bytes[8] == b'{' {
            Self::from_safetensors(bytes)
        } else {
            Err(damaged(
                "it is neither a zip archive (.pth) nor a .safetensors file",
                "give a .pth file written by torch.save or a .safetensors file",
            ))
        }
    }

    fn from_safetensors(bytes: &[u8]) -> Result<Self, DecoderError> {
        let file = safetensors::SafeTensors::deserialize(bytes).map_err(|error| {
            damaged(&format!("its safetensors header is wrong: {error}"), "copy or download it again")
        })?;
        let mut weights = Self::default();
        let mut left = MOST_VALUES;
        for (name, view) in file.iter() {
            let shape = view.shape().to_vec();
            let Some(element) = floating(view.dtype()) else {
                weights.integers.insert(name.to_owned());
                continue;
            };
            let count = shape.iter().try_fold(1usize, |n, size| n.checked_mul(*size)).filter(|n| *n <= left);
            let count = count.ok_or_else(|| damaged("its tensors are too large", "give the right file"))?;
            left -= count;
            let data = element.decode(view.data());
            weights.insert(name.to_owned(), Tensor { shape, data })?;
        }
        weights.without_prefix()
    }

    /// Builds weights in memory, as for a benchmark.
    ///
    /// # Errors
    /// When a tensor's values do not fit its shape or are not finite.
    pub fn from_tensors(tensors: impl IntoIterator<Item = (String, Tensor)>) -> Result<Self, DecoderError> {
        let mut weights = Self::default();
        for (name, tensor) in tensors {
            weights.insert(name, tensor)?;
        }
        Ok(weights)
    }

    fn insert(&mut self, name: String, tensor: Tensor) -> Result<(), DecoderError> {
        let count = tensor.shape.iter().try_fold(1usize, |n, size| n.checked_mul(*size));
        if count != Some(tensor.data.len()) {
            let what = format!("`{name}` holds {} values for the shape {:?}", tensor.data.len(), tensor.shape);
            return Err(damaged(&what, "copy or download it again"));
        }
        if let Some(index) = tensor.data.iter().position(|value| !value.is_finite()) {
            return Err(DecoderError::WeightNotFinite { name, index, value: f64::from(tensor.data[index]) });
        }
        self.tensors.insert(name, tensor);
        Ok(())
    }

    /// Drops the prefix that saving a network wrapped for several GPUs leaves on every name.
    fn without_prefix(self) -> Result<Self, DecoderError> {
        const PREFIX: &str = "module.";
        if self.is_empty() {
            return Err(damaged("it holds no tensor", "give a file that holds a network's state dictionary"));
        }
        if !self.names().chain(self.integers.iter().map(String::as_str)).all(|name| name.starts_with(PREFIX)) {
            return Ok(self);
        }
        let cut = |name: String| name[PREFIX.len()..].to_owned();
        Ok(Self {
            tensors: self.tensors.into_iter().map(|(name, tensor)| (cut(name), tensor)).collect(),
            integers: self.integers.into_iter().map(cut).collect(),
        })
    }

    /// Number of tensors that hold numbers with a fraction.
    pub fn len(&self) -> usize {
        self.tensors.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.tensors.is_empty()
    }

    /// Whether there is a tensor of this name.
    pub fn contains(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Names in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// A tensor by name.
    pub fn get(&self, name: &str) -> Option<&Tensor> {
        self.tensors.get(name)
    }
}

/// The form of a safetensors type; `None` for integers and forms no network here uses.
fn floating(dtype: safetensors::Dtype) -> Option<Element> {
    match dtype {
        safetensors::Dtype::F16 => Some(Element::Half),
        safetensors::Dtype::BF16 => Some(Element::Brain),
        safetensors::Dtype::F32 => Some(Element::Single),
        safetensors::Dtype::F64 => Some(Element::Double),
        _ => None,
    }
}

/// An error about the file's form.
pub(crate) fn damaged(what: &str, remedy: &'static str) -> DecoderError {
    DecoderError::Format { what: what.to_owned(), remedy }
}
