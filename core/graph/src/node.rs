//! What a node is: parameters, typed ports, and one pure function.

use std::fs::File;
use std::io::Read;
use std::path::PathBuf;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, BundleReader};

use crate::artifacts::{AnyArtifact, Inputs, Outputs};
use crate::context::Context;
use crate::params::Params;

/// A kind of node. The struct's fields are its parameters; write it with [`crate::params!`].
///
/// `run` is a pure function of the parameters, the inputs, the source files and `context.seed()`: equal ones give equal
/// bytes at any thread count. The cache relies on it.
pub trait Node: Params {
    /// The name graphs use; unique among all nodes. UpperCamelCase.
    const KIND: &'static str;
    /// Raised whenever `run` gives other outputs than before for the same inputs.
    const REVISION: u32;
    /// Ports read.
    const INPUTS: &'static [Port];
    /// Ports written; never empty.
    const OUTPUTS: &'static [Port];

    /// Files or folders named by parameters. Their content, not their path, enters the cache key; a missing one is an
    /// error before anything runs.
    fn sources(&self) -> Vec<SourceFile> {
        Vec::new()
    }

    /// What is wrong with the parameters beyond the ranges and choices they declare.
    fn validate(&self) -> Vec<ParamError> {
        Vec::new()
    }

    /// Optional outputs that these parameters leave unwritten, as far as they alone can tell.
    fn leaves_empty(&self) -> Vec<&'static str> {
        Vec::new()
    }

    /// Optional inputs that these parameters cannot do without. One that nothing will fill is reported before anything
    /// runs.
    fn needs(&self) -> Vec<Need> {
        Vec::new()
    }

    /// What this machine decides about the bits of the outputs, such as the device that a parameter comes to here. It
    /// enters the cache key, so that results of two devices never share one. Nothing where the node's bits are the CPU's.
    fn numerics(&self) -> Option<String> {
        None
    }

    /// What the node needs of the machine while it runs, so that the scheduler knows what fits beside it. Must not
    /// change what it computes.
    fn resources(&self) -> Resources {
        Resources::default()
    }

    /// Does the work.
    ///
    /// # Errors
    /// Says what is wrong and what the user can do; the scheduler adds the node's id.
    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError>;
}

/// What a node needs of the machine while it runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    /// Threads of its own that it keeps busy; work on the shared pool of the program does not count. At least 1.
    pub threads: usize,
    /// Most memory it takes beyond its inputs, as well as it can tell; 0 when that is little.
    pub memory_bytes: u64,
    /// It needs the GPU to itself.
    pub gpu: bool,
}

impl Default for Resources {
    fn default() -> Self {
        Self { threads: 1, memory_bytes: 0, gpu: false }
    }
}

/// A typed connection point. An optional input may be left unwired; an optional output may be left unwritten, which a
/// required input that it feeds reports when the run gets there.
#[derive(Clone, Copy, Debug)]
pub struct Port {
    /// Name, unique among the node's inputs or outputs.
    pub name: &'static str,
    /// What travels.
    pub artifact: ArtifactType,
    /// One line for the manual.
    pub doc: &'static str,
    /// Takes a list of wires.
    pub many: bool,
    /// Must be wired (inputs) or written (outputs).
    pub required: bool,
    /// Reads the on-disk form; without it the bytes travel as they are.
    decode: Option<Decode>,
}

type Decode = fn(BundleReader<'_>) -> Result<AnyArtifact, ArtifactError>;

impl Port {
    /// One value.
    pub const fn one<T: Artifact>(name: &'static str, doc: &'static str) -> Self {
        Self { name, artifact: T::TYPE, doc, many: false, required: true, decode: Some(AnyArtifact::decode::<T>) }
    }

    /// One value of a type that this program knows by name only: it travels as its on-disk bytes.
    pub const fn encoded(name: &'static str, artifact: ArtifactType, doc: &'static str) -> Self {
        Self { name, artifact, doc, many: false, required: true, decode: None }
    }

    /// A port of the same type under another name, for a library that names the type in words.
    pub(crate) fn alike(&self, name: &'static str, doc: &'static str) -> Self {
        Self { name, doc, many: false, required: true, ..*self }
    }

    /// Reads what travels here from its on-disk form.
    pub(crate) fn decode(&self, bytes: Vec<u8>) -> Result<AnyArtifact, ArtifactError> {
        match self.decode {
            Some(decode) => decode(BundleReader::new(&bytes)?),
            None => Ok(AnyArtifact::encoded(self.artifact, bytes)),
        }
    }

    /// The same from a file, which is never held beside what is read from it.
    pub(crate) fn decode_file(&self, mut file: File) -> Result<AnyArtifact, ArtifactError> {
        if let Some(decode) = self.decode {
            return decode(BundleReader::of_file(file)?);
        }
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(|error| ArtifactError::Format(error.to_string()))?;
        Ok(AnyArtifact::encoded(self.artifact, bytes))
    }

    /// A list of one or more values, in the order of the graph file.
    pub const fn many<T: Artifact>(name: &'static str, doc: &'static str) -> Self {
        Self { many: true, ..Self::one::<T>(name, doc) }
    }

    /// May be absent (for a list: empty).
    pub const fn optional(self) -> Self {
        Self { required: false, ..self }
    }
}

/// A file or folder that a parameter names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceFile {
    /// The parameter that names it, for the error when it is missing.
    pub parameter: &'static str,
    /// Where it is; relative to the current directory.
    pub path: PathBuf,
    /// What to do when it is missing.
    pub remedy: Option<String>,
}

impl SourceFile {
    /// The file that `parameter` names.
    pub fn new(parameter: &'static str, path: impl Into<PathBuf>) -> Self {
        Self { parameter, path: path.into(), remedy: None }
    }

    /// Adds what to do when it is missing.
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }
}

/// An optional input that a node's parameters cannot do without.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Need {
    /// The input.
    pub input: &'static str,
    /// What is wrong when nothing fills it.
    pub message: String,
    /// What to do then.
    pub remedy: String,
}

/// What is wrong with one parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamError {
    /// The parameter.
    pub parameter: &'static str,
    /// What is wrong, and what would be right.
    pub message: String,
}

impl ParamError {
    /// `message` about `parameter`.
    pub fn new(parameter: &'static str, message: impl Into<String>) -> Self {
        Self { parameter, message: message.into() }
    }
}

/// Why a node failed, for a person to read. Any `std::error::Error` converts into it by `?`.
///
/// It does not implement `std::error::Error` itself, so that the blanket conversion can exist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeError {
    /// What went wrong, and where.
    pub message: String,
    /// What the user can do about it.
    pub remedy: Option<String>,
    /// The parameter at fault, when one is.
    pub parameter: Option<&'static str>,
    /// Stopped because the user asked.
    pub cancelled: bool,
}

impl NodeError {
    /// A failure with its message.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), remedy: None, parameter: None, cancelled: false }
    }

    /// Stopped because the user asked.
    pub fn cancelled() -> Self {
        Self { cancelled: true, ..Self::new("cancelled") }
    }

    /// Adds what the user can do.
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }

    /// Names the parameter at fault.
    pub fn parameter(mut self, parameter: &'static str) -> Self {
        self.parameter = Some(parameter);
        self
    }
}

impl<E: std::error::Error + Send + Sync + 'static> From<E> for NodeError {
    fn from(error: E) -> Self {
        let mut message = error.to_string();
        let mut source = error.source();
        while let Some(cause) = source {
            let text = cause.to_string();
            if !message.contains(&text) {
                message = format!("{message}: {text}");
            }
            source = cause.source();
        }
        Self::new(message)
    }
}
