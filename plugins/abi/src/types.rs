//! The types of the C ABI, the same on both sides.
//!
//! A plugin is a shared library that exports [`HeartianEntry`] under the name [`ENTRY`]. The host calls it once with
//! [`HeartianHost`] and gets a [`HeartianPlugin`] that lives as long as the process; a library is never unloaded.
//! Always holds: every struct begins with its own size, is only ever appended to within a major version, and is read no
//! further than the size it states; what one side allocated only that side frees, so borrowed bytes are valid for the call
//! and what is handed to a callback is copied before it returns; no panic or exception crosses; text is UTF-8.
//! Optional features are suites, asked for by name and version. `plugins/sdk/include/heartian_plugin.h` is made from this
//! file.

use core::ffi::{CStr, c_void};

/// First field of [`HeartianPlugin`]: the bytes `HEARTIAN`, read as a little-endian number.
pub const HEARTIAN_MAGIC: u64 = 0x4e41_4954_5241_4548;
/// Raised when old plugins can no longer be loaded. The entry symbol carries it too.
pub const HEARTIAN_ABI_MAJOR: u32 = 1;
/// Raised when something is appended. A host loads plugins of its own minor version and of all before.
pub const HEARTIAN_ABI_MINOR: u32 = 0;
/// All went well.
pub const HEARTIAN_OK: i32 = 0;
/// Something went wrong; `fail` was told what.
pub const HEARTIAN_FAILED: i32 = 1;
/// The plugin stopped because it was asked to.
pub const HEARTIAN_CANCELLED: i32 = 2;

/// The exported symbol, [`HeartianEntry`].
pub const ENTRY: &CStr = c"heartian_plugin_v1";
/// Name of [`HeartianProgressSuite`].
pub const PROGRESS_SUITE: &str = "heartian.progress";
/// Name of [`HeartianLogSuite`].
pub const LOG_SUITE: &str = "heartian.log";

/// Bytes borrowed for the length of a call. Text is UTF-8 without a terminating zero. `data` may be null when `size` is 0.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct HeartianBytes {
    /// The first byte.
    pub data: *const u8,
    /// How many bytes.
    pub size: usize,
}

/// What the host offers.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct HeartianHost {
    /// Size of this struct in the host's build.
    pub size: u32,
    /// The host's `HEARTIAN_ABI_MAJOR`.
    pub abi_major: u32,
    /// The host's `HEARTIAN_ABI_MINOR`.
    pub abi_minor: u32,
    /// An optional feature by name and version; null when this host does not have it. Valid as long as the process.
    pub suite: Option<unsafe extern "C" fn(name: HeartianBytes, version: u32) -> *const c_void>,
}

/// What a plugin is. The first five fields stand at the same place in every version there will be.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct HeartianPlugin {
    /// `HEARTIAN_MAGIC`.
    pub magic: u64,
    /// Size of this struct in the plugin's build.
    pub size: u32,
    /// `HEARTIAN_ABI_MAJOR` of the plugin's build.
    pub abi_major: u32,
    /// `HEARTIAN_ABI_MINOR` of the plugin's build.
    pub abi_minor: u32,
    /// 0.
    pub reserved: u32,
    /// Hands a JSON document that describes all kinds of nodes to `call->write`, in one or more pieces. Does no work,
    /// reads no file, and says the same every time. Returns `HEARTIAN_OK` or `HEARTIAN_FAILED`.
    pub describe: Option<unsafe extern "C" fn(call: *const HeartianDescribe) -> i32>,
    /// Runs one node: a pure function of parameters, inputs and seed. May be called from several threads at once.
    /// Returns `HEARTIAN_OK`, `HEARTIAN_FAILED` or `HEARTIAN_CANCELLED`.
    pub run: Option<unsafe extern "C" fn(call: *const HeartianCall) -> i32>,
    /// What the plugin offers beyond this version, by name and version; may be null.
    pub suite: Option<unsafe extern "C" fn(name: HeartianBytes, version: u32) -> *const c_void>,
}

/// A request to describe.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct HeartianDescribe {
    /// Size of this struct in the host's build.
    pub size: u32,
    /// 0.
    pub reserved: u32,
    /// To be passed to the callbacks.
    pub context: *mut c_void,
    /// Takes a piece of the document.
    pub write: Option<unsafe extern "C" fn(context: *mut c_void, piece: HeartianBytes)>,
    /// Takes the reason of a failure: what is wrong and, where not empty, what can be done about it.
    pub fail: Option<unsafe extern "C" fn(context: *mut c_void, message: HeartianBytes, remedy: HeartianBytes)>,
}

/// One value on one input port; a port that takes many has several, in the order of the graph.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct HeartianInput {
    /// The port's name.
    pub port: HeartianBytes,
    /// The type of what it carries, `name/version`.
    pub type_name: HeartianBytes,
    /// The value's on-disk form: a safetensors file for the house's own types.
    pub bytes: HeartianBytes,
}

/// A request to run a node. The callbacks may be called from any thread until `run` returns.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct HeartianCall {
    /// Size of this struct in the host's build.
    pub size: u32,
    /// Size of one element of `inputs` in the host's build: step through them by it.
    pub input_size: u32,
    /// To be passed to the callbacks.
    pub context: *mut c_void,
    /// Which kind of node.
    pub kind: HeartianBytes,
    /// All its parameters, as a JSON object; checked by the host against the description.
    pub params: HeartianBytes,
    /// The graph's seed.
    pub seed: u64,
    /// How many threads the node may use; must not change what it computes.
    pub threads: u32,
    /// 0.
    pub reserved: u32,
    /// The inputs.
    pub inputs: *const HeartianInput,
    /// How many inputs.
    pub input_count: usize,
    /// Takes the value of one output port. Returns `HEARTIAN_OK`, or `HEARTIAN_FAILED` when the host refuses it, which
    /// fails the node.
    pub emit: Option<
        unsafe extern "C" fn(
            context: *mut c_void,
            port: HeartianBytes,
            type_name: HeartianBytes,
            bytes: HeartianBytes,
        ) -> i32,
    >,
    /// Takes the reason of a failure: what is wrong, and, where not empty, what can be done about it and which parameter
    /// is at fault.
    pub fail: Option<
        unsafe extern "C" fn(
            context: *mut c_void,
            message: HeartianBytes,
            remedy: HeartianBytes,
            parameter: HeartianBytes,
        ),
    >,
}

/// Suite `heartian.progress`, version 1: for nodes that take longer than a blink.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct HeartianProgressSuite {
    /// Size of this struct in the host's build.
    pub size: u32,
    /// 0.
    pub reserved: u32,
    /// Reports `step` of `total` (0: unknown) and, where `metric` is not empty, a live figure. Returns 0, or 1 when the
    /// user asked to stop: return `HEARTIAN_CANCELLED` soon. A node that reports is not taken for one that hangs.
    pub report: Option<
        unsafe extern "C" fn(context: *mut c_void, step: u64, total: u64, metric: HeartianBytes, value: f64) -> i32,
    >,
}

/// Suite `heartian.log`, version 1: one line to the user.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct HeartianLogSuite {
    /// Size of this struct in the host's build.
    pub size: u32,
    /// 0.
    pub reserved: u32,
    /// Tells the user one line, such as a doubtful input that is used all the same. It is kept with the result.
    pub warn: Option<unsafe extern "C" fn(context: *mut c_void, text: HeartianBytes)>,
}

/// The exported function. Returns the plugin, which lives as long as the process, or null when it cannot serve this host.
pub type HeartianEntry = unsafe extern "C" fn(host: *const HeartianHost) -> *const HeartianPlugin;

// SAFETY: the pointers in it are to functions and to data that never change.
unsafe impl Sync for HeartianPlugin {}
// SAFETY: as above.
unsafe impl Sync for HeartianHost {}

impl HeartianBytes {
    /// No bytes.
    pub const EMPTY: Self = Self { data: core::ptr::null(), size: 0 };

    /// These bytes, for as long as they live.
    pub const fn of(bytes: &[u8]) -> Self {
        Self { data: bytes.as_ptr(), size: bytes.len() }
    }

    /// The bytes.
    ///
    /// # Safety
    /// `data` points to `size` readable bytes that do not change for `'a`, or `size` is 0.
    pub const unsafe fn get<'a>(self) -> &'a [u8] {
        if self.size == 0 || self.data.is_null() {
            return &[];
        }
        // SAFETY: the caller promises it.
        unsafe { core::slice::from_raw_parts(self.data, self.size) }
    }
}
