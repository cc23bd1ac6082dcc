//! The trait of a thing that travels on a wire, and its on-disk form.
//!
//! An artifact is immutable once made. On disk it is one `safetensors` file, so that Python opens every intermediate
//! result: arrays are tensors, everything else is one JSON object under the metadata key `heartian`. The bytes are a
//! pure function of the value (names sorted, one metadata key), because the cache addresses them by digest.

mod bundle;

pub use bundle::{Bundle, BundleReader, Element, Tensor};

/// The name under which a type travels, and the version of its on-disk form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ArtifactType {
    /// Short name for built-in types (`clip`), reverse-DNS for third-party ones (`org.example.mesh`).
    pub name: &'static str,
    /// Raised whenever the on-disk form changes incompatibly.
    pub version: u32,
}

/// A value that can travel on a wire and rest in the cache.
pub trait Artifact: Send + Sync + Sized + 'static {
    /// The type's name and version, as ports declare it.
    const TYPE: ArtifactType;

    /// Borrowed view of the value as tensors and JSON, in a form that [`Artifact::from_bundle`] reads back equal.
    ///
    /// # Errors
    /// When a part cannot be expressed, such as JSON that does not serialise.
    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError>;

    /// Rebuilds the value, checking every shape: the bytes may come from a foreign tool.
    ///
    /// # Errors
    /// Names the missing, extra or misshapen part.
    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError>;
}

/// What can be wrong with an artifact's on-disk form.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArtifactError {
    /// The bytes are not a safetensors file.
    #[error("not a safetensors file: {0}")]
    Format(String),
    /// A tensor or the metadata is absent.
    #[error("`{0}` is missing")]
    Missing(String),
    /// A tensor has another element type than expected.
    #[error("tensor `{name}` holds {found} where {expected} was expected")]
    Element {
        /// The tensor's name.
        name: String,
        /// Element type wanted.
        expected: &'static str,
        /// Element type found.
        found: String,
    },
    /// A tensor has another shape than expected.
    #[error("tensor `{name}` has shape {found:?}; expected {expected}")]
    Shape {
        /// The tensor's name.
        name: String,
        /// Shape wanted, with symbolic sizes.
        expected: String,
        /// Shape found.
        found: Vec<usize>,
    },
    /// The JSON metadata does not parse or does not serialise.
    #[error("metadata: {0}")]
    Json(#[from] serde_json::Error),
    /// The parts are readable but contradict one another.
    #[error("{0}")]
    Invalid(String),
}
