//! Artifacts of any type on their way between nodes. Immutable once made, shared by reference count.

use std::any::Any;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, BundleReader};

use crate::node::NodeError;

/// An artifact whose type is known by name.
#[derive(Clone)]
pub struct AnyArtifact {
    artifact: ArtifactType,
    form: Form,
}

/// Hands the on-disk form of a value over, in pieces.
type Encode = fn(&dyn Any, &mut dyn FnMut(&[&[u8]])) -> Result<(), ArtifactError>;

#[derive(Clone)]
enum Form {
    Value { value: Arc<dyn Any + Send + Sync>, encode: Encode },
    Encoded(Arc<Vec<u8>>),
}

impl AnyArtifact {
    /// Wraps a value.
    pub fn new<T: Artifact>(value: T) -> Self {
        Self { artifact: T::TYPE, form: Form::Value { value: Arc::new(value), encode: encode::<T> } }
    }

    /// An artifact in its on-disk form, of whatever type; who reads it as a value decodes it.
    pub fn encoded(artifact: ArtifactType, bytes: Vec<u8>) -> Self {
        Self { artifact, form: Form::Encoded(Arc::new(bytes)) }
    }

    /// Reads a value back from its on-disk form.
    ///
    /// # Errors
    /// When the bytes are not such an artifact.
    pub fn decode<T: Artifact>(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Ok(Self::new(T::from_bundle(reader)?))
    }

    /// The type's name and version.
    pub fn artifact_type(&self) -> ArtifactType {
        self.artifact
    }

    /// The value, if it is a `T`.
    pub fn downcast<T: Artifact>(&self) -> Option<Arc<T>> {
        self.read().ok()
    }

    /// The value, decoded if it is still in its on-disk form.
    fn read<T: Artifact>(&self) -> Result<Arc<T>, ArtifactError> {
        let other = || {
            let (found, wanted) = (self.artifact.name, T::TYPE.name);
            ArtifactError::Invalid(format!("it is `{found}` where the node reads `{wanted}`"))
        };
        match &self.form {
            Form::Value { value, .. } => value.clone().downcast().map_err(|_| other()),
            Form::Encoded(_) if self.artifact != T::TYPE => Err(other()),
            Form::Encoded(bytes) => Ok(Arc::new(T::from_bundle(BundleReader::new(bytes)?)?)),
        }
    }

    /// Hands over the on-disk form in pieces that lie where the value has them, so that storing copies nothing.
    ///
    /// # Errors
    /// When the value cannot be expressed.
    pub fn in_pieces(&self, take: &mut dyn FnMut(&[&[u8]])) -> Result<(), ArtifactError> {
        match &self.form {
            Form::Value { value, encode } => encode(&**value, take),
            Form::Encoded(bytes) => {
                take(&[bytes]);
                Ok(())
            }
        }
    }

    /// The on-disk form, joined.
    ///
    /// # Errors
    /// When the value cannot be expressed.
    pub fn to_bytes(&self) -> Result<Cow<'_, [u8]>, ArtifactError> {
        if let Form::Encoded(bytes) = &self.form {
            return Ok(Cow::Borrowed(bytes));
        }
        let mut joined = Vec::new();
        self.in_pieces(&mut |pieces| joined = pieces.concat())?;
        Ok(Cow::Owned(joined))
    }
}

fn encode<T: Artifact>(value: &dyn Any, take: &mut dyn FnMut(&[&[u8]])) -> Result<(), ArtifactError> {
    let Some(value) = value.downcast_ref::<T>() else {
        return Err(ArtifactError::Invalid(format!("the value is not a `{}`", T::TYPE.name)));
    };
    let bundle = value.to_bundle()?;
    let pieces = bundle.pieces()?;
    take(&pieces.iter().map(|piece| &**piece).collect::<Vec<&[u8]>>());
    Ok(())
}

/// What the wires bring to a running node, by port.
#[derive(Clone, Default)]
pub struct Inputs {
    ports: BTreeMap<String, Vec<AnyArtifact>>,
}

impl Inputs {
    /// No inputs.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a value to a port; twice to the same port makes a list.
    pub fn with(mut self, port: &str, artifact: AnyArtifact) -> Self {
        self.ports.entry(port.to_owned()).or_default().push(artifact);
        self
    }

    /// The value on a required port.
    ///
    /// # Errors
    /// When nothing is wired, or another type.
    pub fn get<T: Artifact>(&self, port: &str) -> Result<Arc<T>, NodeError> {
        let missing = || NodeError::new(format!("input `{port}` carries nothing")).remedy(format!("wire `{port}`"));
        self.optional(port)?.ok_or_else(missing)
    }

    /// The value on an optional port.
    ///
    /// # Errors
    /// When it carries another type.
    pub fn optional<T: Artifact>(&self, port: &str) -> Result<Option<Arc<T>>, NodeError> {
        Ok(self.many(port)?.into_iter().next())
    }

    /// All values on a port, in the order of the graph file.
    ///
    /// # Errors
    /// When one is of another type.
    pub fn many<T: Artifact>(&self, port: &str) -> Result<Vec<Arc<T>>, NodeError> {
        let read = |artifact: &AnyArtifact| {
            artifact.read().map_err(|error| NodeError::new(format!("input `{port}` cannot be read: {error}")))
        };
        self.ports.get(port).map_or(Ok(Vec::new()), |values| values.iter().map(read).collect())
    }

    /// Everything wired, by port, in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &[AnyArtifact])> {
        self.ports.iter().map(|(port, values)| (port.as_str(), values.as_slice()))
    }
}

/// What a node made, by port.
#[derive(Clone, Default)]
pub struct Outputs {
    ports: BTreeMap<&'static str, AnyArtifact>,
}

impl Outputs {
    /// Nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the value of a port; the last of equal names wins.
    pub fn put<T: Artifact>(self, port: &'static str, value: T) -> Self {
        self.put_any(port, AnyArtifact::new(value))
    }

    /// Adds a value whose type is known by name only.
    pub fn put_any(mut self, port: &'static str, artifact: AnyArtifact) -> Self {
        self.ports.insert(port, artifact);
        self
    }

    /// Adds the value of an optional port if there is one.
    pub fn put_some<T: Artifact>(self, port: &'static str, value: Option<T>) -> Self {
        match value {
            Some(value) => self.put(port, value),
            None => self,
        }
    }

    /// The value of a port.
    pub fn get(&self, port: &str) -> Option<&AnyArtifact> {
        self.ports.get(port)
    }

    /// Ports written, in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, &AnyArtifact)> {
        self.ports.iter().map(|(port, artifact)| (*port, artifact))
    }
}
