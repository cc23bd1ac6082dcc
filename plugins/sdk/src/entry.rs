//! The C side of a plugin: what [`crate::export!`] exports, with a net under every call so that no panic crosses.
//!
//! The only place with raw pointers. Everything the host passes is borrowed for the call; everything handed back is copied
//! by the host before its callback returns.

use std::any::Any;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;

use heartian_plugin_abi::{
    HEARTIAN_ABI_MAJOR, HEARTIAN_ABI_MINOR, HEARTIAN_CANCELLED, HEARTIAN_FAILED, HEARTIAN_MAGIC, HEARTIAN_OK,
    HeartianBytes, HeartianCall, HeartianDescribe, HeartianHost, HeartianInput, HeartianLogSuite, HeartianPlugin,
    HeartianProgressSuite, LOG_SUITE, PROGRESS_SUITE,
};
use serde_json::json;

use crate::call::{Call, Error, Input, Inputs, Outputs};
use crate::node::Kind;

/// Optional features of the host.
#[derive(Clone, Copy, Default)]
struct Suites {
    progress: Option<HeartianProgressSuite>,
    log: Option<HeartianLogSuite>,
}

static SUITES: OnceLock<Suites> = OnceLock::new();

/// What the entry symbol returns.
pub const fn plugin(
    describe: unsafe extern "C" fn(*const HeartianDescribe) -> i32,
    run: unsafe extern "C" fn(*const HeartianCall) -> i32,
) -> HeartianPlugin {
    HeartianPlugin {
        magic: HEARTIAN_MAGIC,
        size: size_of::<HeartianPlugin>() as u32,
        abi_major: HEARTIAN_ABI_MAJOR,
        abi_minor: HEARTIAN_ABI_MINOR,
        reserved: 0,
        describe: Some(describe),
        run: Some(run),
        suite: None,
    }
}

/// A copy of a suite, if the host has it in full.
///
/// # Safety
/// `S` is the suite's struct, which starts with its size.
unsafe fn suite<S: Copy>(host: &HeartianHost, name: &str) -> Option<S> {
    // SAFETY: a host's callback takes any name and version.
    let found = unsafe { host.suite?(HeartianBytes::of(name.as_bytes()), 1) };
    if found.is_null() {
        return None;
    }
    // SAFETY: every suite starts with its size, which says how much may be read.
    let size = unsafe { found.cast::<u32>().read() };
    // SAFETY: as above, and the caller names the right type.
    (size as usize >= size_of::<S>()).then(|| unsafe { found.cast::<S>().read() })
}

/// Takes note of what the host offers.
///
/// # Safety
/// `host` is null or points to the host's struct.
pub unsafe fn open(host: *const HeartianHost) {
    // SAFETY: promised by the caller.
    let Some(host) = (unsafe { host.as_ref() }) else { return };
    if (host.size as usize) < size_of::<HeartianHost>() {
        return;
    }
    SUITES.get_or_init(|| {
        // SAFETY: the names and the structs belong together.
        unsafe { Suites { progress: suite(host, PROGRESS_SUITE), log: suite(host, LOG_SUITE) } }
    });
}

fn panicked(payload: &(dyn Any + Send)) -> Error {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or("no message".into());
    Error::new(format!("it panicked: {text}"))
}

fn guarded<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| Err(panicked(&*payload)))
}

/// Describes the library.
///
/// # Safety
/// `call` points to the host's struct.
pub unsafe fn describe((name, version): (&str, &str), kinds: &[Kind], call: *const HeartianDescribe) -> i32 {
    // SAFETY: promised by the caller.
    let call = unsafe { &*call };
    let (Some(write), Some(fail)) = (call.write, call.fail) else { return HEARTIAN_FAILED };
    let document = guarded(|| {
        let kinds = kinds.iter().map(|kind| (kind.describe)()).collect::<Result<Vec<_>, _>>()?;
        Ok(json!({ "format": 1, "name": name, "version": version, "kinds": kinds }).to_string())
    });
    match document {
        Ok(text) => {
            // SAFETY: the host's callback copies the bytes.
            unsafe { write(call.context, HeartianBytes::of(text.as_bytes())) };
            HEARTIAN_OK
        }
        Err(error) => {
            let message = HeartianBytes::of(error.message.as_bytes());
            // SAFETY: as above.
            unsafe { fail(call.context, message, HeartianBytes::of(error.remedy.as_bytes())) };
            HEARTIAN_FAILED
        }
    }
}

/// Runs one node.
///
/// # Safety
/// `call` points to the host's struct.
pub unsafe fn run(kinds: &[Kind], call: *const HeartianCall) -> i32 {
    // SAFETY: promised by the caller.
    let raw = unsafe { &*call };
    let (Some(emit), Some(fail)) = (raw.emit, raw.fail) else { return HEARTIAN_FAILED };
    // SAFETY: the host's inputs live for the call.
    let done = guarded(|| unsafe { work(kinds, raw) }).and_then(|(kind, outputs)| {
        for (port, bytes) in &outputs.0 {
            let Some(declared) = kind.outputs.iter().find(|declared| declared.name == *port) else {
                return Err(Error::new(format!("the node wrote `{port}`, which it does not declare")));
            };
            let (port, type_name) =
                (HeartianBytes::of(port.as_bytes()), HeartianBytes::of(declared.type_name.as_bytes()));
            // SAFETY: the host's callback copies the bytes.
            if unsafe { emit(raw.context, port, type_name, HeartianBytes::of(bytes)) } != HEARTIAN_OK {
                return Err(Error::new("the host refused an output"));
            }
        }
        Ok(())
    });
    let Err(error) = done else { return HEARTIAN_OK };
    let [message, remedy, parameter] =
        [&error.message, &error.remedy, error.parameter].map(|text| HeartianBytes::of(text.as_bytes()));
    // SAFETY: as above.
    unsafe { fail(raw.context, message, remedy, parameter) };
    if error.cancelled { HEARTIAN_CANCELLED } else { HEARTIAN_FAILED }
}

/// Finds the kind, wraps what came, runs it.
///
/// # Safety
/// `raw` is what the host passed, and it lives for the call.
unsafe fn work<'k>(kinds: &'k [Kind], raw: &HeartianCall) -> Result<(&'k Kind, Outputs), Error> {
    // SAFETY: promised by the caller, here and below.
    let text = |bytes: HeartianBytes| Ok::<&str, Error>(std::str::from_utf8(unsafe { bytes.get() })?);
    let name = text(raw.kind)?;
    let kind = kinds.iter().find(|kind| kind.kind == name);
    let kind = kind.ok_or_else(|| Error::new(format!("this library has no kind of node `{name}`")))?;
    let mut inputs = Vec::with_capacity(raw.input_count);
    for index in 0..raw.input_count {
        let at = raw.inputs.cast::<c_void>().wrapping_byte_add(index * raw.input_size as usize);
        // SAFETY: the host states how many inputs there are and how far apart; `HeartianInput` only ever grows.
        let input = unsafe { at.cast::<HeartianInput>().read_unaligned() };
        // SAFETY: as above.
        let bytes = unsafe { input.bytes.get() };
        inputs.push(Input { port: text(input.port)?, type_name: text(input.type_name)?, bytes });
    }
    let Suites { progress, log } = SUITES.get().copied().unwrap_or_default();
    let call = Call { context: raw.context, seed: raw.seed, threads: raw.threads.max(1) as usize, progress, log };
    let outputs = (kind.run)(text(raw.params)?, &Inputs::of(inputs), &call)?;
    Ok((kind, outputs))
}

/// Exports nodes as a plugin: one line in the library's root. The library goes by the name and version of its package.
#[macro_export]
macro_rules! export {
    ($($node:ty),+ $(,)?) => {
        const _: () = {
            static KINDS: &[$crate::Kind] = &[$($crate::Kind::of::<$node>()),+];
            static PLUGIN: $crate::abi::HeartianPlugin = $crate::entry::plugin(describe, run);

            unsafe extern "C" fn describe(call: *const $crate::abi::HeartianDescribe) -> i32 {
                let library = (::std::env!("CARGO_PKG_NAME"), ::std::env!("CARGO_PKG_VERSION"));
                // SAFETY: the host passes its own struct.
                unsafe { $crate::entry::describe(library, KINDS, call) }
            }

            unsafe extern "C" fn run(call: *const $crate::abi::HeartianCall) -> i32 {
                // SAFETY: the host passes its own struct.
                unsafe { $crate::entry::run(KINDS, call) }
            }

            #[unsafe(no_mangle)]
            unsafe extern "C" fn heartian_plugin_v1(
                host: *const $crate::abi::HeartianHost,
            ) -> *const $crate::abi::HeartianPlugin {
                // SAFETY: the host passes its own struct.
                unsafe { $crate::entry::open(host) };
                &raw const PLUGIN
            }
        };
    };
}
