//! What a running node gets, may ask of its host, and gives back.

use std::ffi::c_void;
use std::ops::ControlFlow;

use heartian_artifact::{ArtifactError, Bundle, BundleReader};
use heartian_plugin_abi::{HeartianBytes, HeartianLogSuite, HeartianProgressSuite};

/// One value on an input port.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// The port it came in by.
    pub port: &'a str,
    /// The type, `name/version`.
    pub type_name: &'a str,
    /// The on-disk form: a safetensors file for the house's own types, anything for others.
    pub bytes: &'a [u8],
}

impl<'a> Input<'a> {
    /// The value as named tensors and JSON.
    ///
    /// # Errors
    /// When it is not a safetensors file.
    pub fn bundle(&self) -> Result<BundleReader<'a>, ArtifactError> {
        BundleReader::new(self.bytes)
    }
}

/// What the wires bring to a running node.
#[derive(Clone, Debug, Default)]
pub struct Inputs<'a>(Vec<Input<'a>>);

impl<'a> Inputs<'a> {
    /// These values, for a test of your own node.
    pub fn of(values: Vec<Input<'a>>) -> Self {
        Self(values)
    }

    /// The value on a required port.
    ///
    /// # Errors
    /// When it carries nothing, which the host does not let happen for ports that the node declares.
    pub fn get(&self, port: &str) -> Result<Input<'a>, Error> {
        self.many(port).next().ok_or_else(|| Error::new(format!("input `{port}` carries nothing")))
    }

    /// All values on a port, in the order of the graph file; none when nothing is wired.
    pub fn many(&self, port: &str) -> impl Iterator<Item = Input<'a>> {
        self.0.iter().filter(move |input| input.port == port).copied()
    }
}

/// What a node made.
#[derive(Clone, Debug, Default)]
pub struct Outputs(pub(crate) Vec<(&'static str, Vec<u8>)>);

impl Outputs {
    /// Nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the on-disk form of a port's value; the port's declared type says what it is.
    pub fn put(mut self, port: &'static str, bytes: Vec<u8>) -> Self {
        self.0.push((port, bytes));
        self
    }

    /// Adds named tensors and JSON as the value of a port.
    ///
    /// # Errors
    /// When a part cannot be written.
    pub fn put_bundle(self, port: &'static str, bundle: &Bundle<'_>) -> Result<Self, ArtifactError> {
        Ok(self.put(port, bundle.to_bytes()?))
    }

    /// The bytes of a port, for a test of your own node.
    pub fn get(&self, port: &str) -> Option<&[u8]> {
        self.0.iter().find(|(name, _)| *name == port).map(|(_, bytes)| bytes.as_slice())
    }
}

/// Why a node failed, for a person to read. Any `std::error::Error` converts into it by `?`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Error {
    pub(crate) message: String,
    pub(crate) remedy: String,
    pub(crate) parameter: &'static str,
    pub(crate) cancelled: bool,
}

impl Error {
    /// A failure with its message.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), ..Self::default() }
    }

    /// Stopped because the user asked.
    pub fn cancelled() -> Self {
        Self { cancelled: true, ..Self::new("cancelled") }
    }

    /// Adds what the user can do.
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = remedy.into();
        self
    }

    /// Names the parameter at fault.
    pub fn parameter(mut self, parameter: &'static str) -> Self {
        self.parameter = parameter;
        self
    }
}

impl<E: std::error::Error> From<E> for Error {
    fn from(error: E) -> Self {
        Self::new(error.to_string())
    }
}

/// A running node's view of its host.
pub struct Call {
    pub(crate) context: *mut c_void,
    pub(crate) seed: u64,
    pub(crate) threads: usize,
    pub(crate) progress: Option<HeartianProgressSuite>,
    pub(crate) log: Option<HeartianLogSuite>,
}

// SAFETY: the ABI lets every thread call back until `run` returns, and a `Call` is lent to a node for no longer.
unsafe impl Send for Call {}
// SAFETY: as above.
unsafe impl Sync for Call {}

impl Call {
    /// A call that nobody watches, for a test of your own node.
    pub fn silent() -> Self {
        Self { context: std::ptr::null_mut(), seed: 0, threads: 1, progress: None, log: None }
    }

    /// The graph's seed. It is in the cache key.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// How many threads the node may use; must not change what it computes.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Reports `step` of `total` (0: unknown) and perhaps a live figure. `Break` means the user asked to stop: return
    /// [`Error::cancelled`] soon. A node that takes long must report now and then, or it is taken for one that hangs.
    pub fn progress(&self, step: u64, total: u64, metric: Option<(&str, f64)>) -> ControlFlow<()> {
        let Some(report) = self.progress.and_then(|suite| suite.report) else { return ControlFlow::Continue(()) };
        let (name, value) = metric.unwrap_or(("", 0.0));
        // SAFETY: the context is the host's own, and the bytes live for the call.
        let stop = unsafe { report(self.context, step, total, HeartianBytes::of(name.as_bytes()), value) };
        if stop == 0 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    }

    /// Tells the user one line, such as a doubtful input that is used all the same.
    pub fn warn(&self, text: &str) {
        if let Some(warn) = self.log.and_then(|suite| suite.warn) {
            // SAFETY: as above.
            unsafe { warn(self.context, HeartianBytes::of(text.as_bytes())) };
        }
    }
}
