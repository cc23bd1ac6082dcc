//! A library in this process: loading, the handshake, and calls across the C ABI.
//!
//! The one place that trusts foreign code with raw pointers. A library is never unloaded. What it hands over is checked
//! as far as it can be: magic, versions, sizes, null pointers, UTF-8.

use std::borrow::Cow;
use std::ffi::{CString, c_void};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use heartian_plugin_abi::{
    ENTRY, HEARTIAN_ABI_MAJOR, HEARTIAN_ABI_MINOR, HEARTIAN_CANCELLED, HEARTIAN_FAILED, HEARTIAN_MAGIC, HEARTIAN_OK,
    HeartianBytes, HeartianCall, HeartianDescribe, HeartianEntry, HeartianHost, HeartianInput, HeartianLogSuite,
    HeartianPlugin, HeartianProgressSuite, LOG_SUITE, PROGRESS_SUITE,
};

use super::frame::Trouble;

/// A longer description is refused.
pub(crate) const DESCRIPTION_LIMIT: usize = 4 << 20;
/// Majors whose entry symbols are looked for, to name the version of a library that does not fit.
const MAJORS: std::ops::Range<u32> = 0..32;

/// A node to run.
pub(crate) struct Job<'a> {
    pub kind: &'a str,
    pub params: &'a str,
    pub seed: u64,
    pub threads: u32,
    pub inputs: Vec<JobInput<'a>>,
}

/// One value for a node.
pub(crate) struct JobInput<'a> {
    pub port: Cow<'a, str>,
    pub artifact: Cow<'a, str>,
    pub bytes: Cow<'a, [u8]>,
}

/// Hears what a running node has to say.
pub(crate) trait Events: Send {
    /// An output; false when it is refused.
    fn output(&mut self, port: &str, artifact: &str, bytes: Cow<'_, [u8]>) -> bool;
    /// How far it is; false when it should stop.
    fn progress(&mut self, step: u64, total: u64, metric: Option<(&str, f64)>) -> bool;
    /// One line to the user.
    fn warning(&mut self, text: &str);
}

/// A loaded library.
pub(crate) struct Native {
    plugin: HeartianPlugin,
}

static HOST: HeartianHost = HeartianHost {
    size: size_of::<HeartianHost>() as u32,
    abi_major: HEARTIAN_ABI_MAJOR,
    abi_minor: HEARTIAN_ABI_MINOR,
    suite: Some(suite),
};
static PROGRESS: HeartianProgressSuite =
    HeartianProgressSuite { size: size_of::<HeartianProgressSuite>() as u32, reserved: 0, report: Some(report) };
static LOG: HeartianLogSuite =
    HeartianLogSuite { size: size_of::<HeartianLogSuite>() as u32, reserved: 0, warn: Some(warn) };

unsafe extern "C" fn suite(name: HeartianBytes, version: u32) -> *const c_void {
    // SAFETY: the library's name lives for the call.
    match (unsafe { name.get() }, version) {
        (name, 1) if name == PROGRESS_SUITE.as_bytes() => (&raw const PROGRESS).cast(),
        (name, 1) if name == LOG_SUITE.as_bytes() => (&raw const LOG).cast(),
        _ => std::ptr::null(),
    }
}

#[cfg(unix)]
fn open(path: &Path) -> Result<libloading::Library, libloading::Error> {
    use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
    // All symbols at once: one that is missing is an error here, not a crash in the middle of a run.
    // SAFETY: the caller of `Native::load` promises it.
    unsafe { Library::open(Some(path), RTLD_NOW | RTLD_LOCAL) }.map(Into::into)
}

#[cfg(not(unix))]
fn open(path: &Path) -> Result<libloading::Library, libloading::Error> {
    // SAFETY: the caller of `Native::load` promises it.
    unsafe { libloading::Library::new(path) }
}

fn version_mismatch(theirs: &str, newer: bool) -> Trouble {
    let ours = format!("{HEARTIAN_ABI_MAJOR}.{HEARTIAN_ABI_MINOR}");
    let remedy = if newer {
        "install a newer Heartian, or build the plugin with the SDK of this one"
    } else {
        "build the plugin again with the SDK of this Heartian"
    };
    Trouble::new(format!("it was built for plugin ABI {theirs}; this program speaks ABI {ours}")).remedy(remedy)
}

impl Native {
    /// Loads a library and shakes hands.
    ///
    /// # Safety
    /// Runs the library's code in this process: its author is trusted, or the process is there to be lost.
    ///
    /// # Errors
    /// When it cannot be loaded, is no plugin, or speaks another version.
    pub unsafe fn load(path: &Path) -> Result<Self, Trouble> {
        let not_ours =
            "check that the file is a plugin, built for this system; plugins/README.md shows how one is made";
        let library =
            open(path).map_err(|error| Trouble::new(format!("it cannot be loaded: {error}")).remedy(not_ours))?;
        // Never unloaded: threads, thread-locals and leaked descriptions of it live on.
        let library = Box::leak(Box::new(library));
        // SAFETY: a symbol of that name is of that type, by the contract that the name stands for.
        let Ok(entry) = (unsafe { library.get::<HeartianEntry>(ENTRY.to_bytes_with_nul()) }) else {
            return Err(other_major(library).unwrap_or_else(|| {
                let name = ENTRY.to_string_lossy();
                Trouble::new(format!("it is no plugin: it does not export `{name}`")).remedy(not_ours)
            }));
        };
        // SAFETY: the host's struct lives for ever.
        let found = unsafe { entry(&raw const HOST) };
        if found.is_null() {
            let message = "it declines to serve this program: its entry returns nothing";
            return Err(Trouble::new(message).remedy("ask its author which versions it serves"));
        }
        // SAFETY: it is not null, and a plugin's struct is at least as long as its first five fields.
        unsafe { handshake(found) }.map(|plugin| Self { plugin })
    }

    /// The library's description, a JSON document.
    ///
    /// # Errors
    /// When the library says so.
    pub fn describe(&self) -> Result<Vec<u8>, Trouble> {
        let page = Page { text: Mutex::default(), trouble: Mutex::default() };
        let call = HeartianDescribe {
            size: size_of::<HeartianDescribe>() as u32,
            reserved: 0,
            context: (&raw const page).cast_mut().cast(),
            write: Some(write),
            fail: Some(fail_description),
        };
        let describe = self.plugin.describe.ok_or_else(|| Trouble::new("it has no `describe`"))?;
        // SAFETY: the call and what it points to live until it returns.
        let status = unsafe { describe(&raw const call) };
        let trouble = page.trouble.into_inner().unwrap_or_else(PoisonError::into_inner);
        match (status, trouble) {
            (HEARTIAN_OK, None) => Ok(page.text.into_inner().unwrap_or_else(PoisonError::into_inner)),
            (_, Some(trouble)) => Err(trouble),
            (status, None) => Err(Trouble::new(format!("describing it failed with status {status} and no word why"))),
        }
    }

    /// Runs one node.
    ///
    /// # Errors
    /// When the library says so.
    pub fn run(&self, job: &Job<'_>, events: &mut dyn Events) -> Result<(), Trouble> {
        let hook = Hook { events: Mutex::new(events), trouble: Mutex::default() };
        let text = |text: &str| HeartianBytes::of(text.as_bytes());
        let input = |input: &JobInput<'_>| HeartianInput {
            port: text(&input.port),
            type_name: text(&input.artifact),
            bytes: HeartianBytes::of(&input.bytes),
        };
        let inputs: Vec<HeartianInput> = job.inputs.iter().map(input).collect();
        let call = HeartianCall {
            size: size_of::<HeartianCall>() as u32,
            input_size: size_of::<HeartianInput>() as u32,
            context: (&raw const hook).cast_mut().cast(),
            kind: text(job.kind),
            params: text(job.params),
            seed: job.seed,
            threads: job.threads,
            reserved: 0,
            inputs: inputs.as_ptr(),
            input_count: inputs.len(),
            emit: Some(emit),
            fail: Some(fail),
        };
        let run = self.plugin.run.ok_or_else(|| Trouble::new("it has no `run`"))?;
        // SAFETY: the call and what it points to live until it returns.
        let status = unsafe { run(&raw const call) };
        let trouble = hook.trouble.into_inner().unwrap_or_else(PoisonError::into_inner);
        let cancelled = status == HEARTIAN_CANCELLED;
        match trouble {
            None if status == HEARTIAN_OK => Ok(()),
            Some(trouble) => Err(Trouble { cancelled, ..trouble }),
            None => {
                let message = format!("it failed with status {status} and no word why");
                Err(Trouble { cancelled, ..Trouble::new(message) })
            }
        }
    }
}

/// What an entry symbol of another version tells.
fn other_major(library: &libloading::Library) -> Option<Trouble> {
    let exports = |major: &u32| {
        let name = CString::new(format!("heartian_plugin_v{major}")).unwrap_or_default();
        // SAFETY: the symbol is looked for, not called.
        unsafe { library.get::<*const c_void>(name.as_bytes_with_nul()) }.is_ok()
    };
    let major = MAJORS.filter(|major| *major != HEARTIAN_ABI_MAJOR).find(exports)?;
    Some(version_mismatch(&major.to_string(), major > HEARTIAN_ABI_MAJOR))
}

/// Checks what the entry returned and copies it.
///
/// # Safety
/// `found` points to the first five fields at least, and to as many bytes as its `size` says.
unsafe fn handshake(found: *const HeartianPlugin) -> Result<HeartianPlugin, Trouble> {
    let broken = |what: String| {
        Err(Trouble::new(what).remedy("build the plugin with the SDK or header of this Heartian, and report it"))
    };
    if !found.is_aligned() {
        return broken("its description of itself is not where it should be (misaligned)".to_owned());
    }
    // SAFETY: promised by the caller; field by field, because the struct may be shorter than ours.
    let (magic, size, major, minor) =
        unsafe { ((*found).magic, (*found).size, (*found).abi_major, (*found).abi_minor) };
    if magic != HEARTIAN_MAGIC {
        return broken(format!("it is no plugin: its magic number is {magic:#018x}, not {HEARTIAN_MAGIC:#018x}"));
    }
    if (major, minor) > (HEARTIAN_ABI_MAJOR, HEARTIAN_ABI_MINOR) || major != HEARTIAN_ABI_MAJOR {
        return Err(version_mismatch(&format!("{major}.{minor}"), major >= HEARTIAN_ABI_MAJOR));
    }
    let wanted = size_of::<HeartianPlugin>();
    if (size as usize) < wanted {
        return broken(format!("its struct is cut short: {size} bytes where ABI {major}.{minor} has {wanted}"));
    }
    // SAFETY: it is as long as ours.
    let plugin = unsafe { found.read() };
    if plugin.describe.is_none() || plugin.run.is_none() {
        return broken("it lacks `describe` or `run`".to_owned());
    }
    Ok(plugin)
}

/// What a description is written to.
struct Page {
    text: Mutex<Vec<u8>>,
    trouble: Mutex<Option<Trouble>>,
}

/// What a running node speaks to.
struct Hook<'a> {
    events: Mutex<&'a mut dyn Events>,
    trouble: Mutex<Option<Trouble>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// # Safety
/// The library's text lives for the call.
unsafe fn text(bytes: HeartianBytes) -> String {
    // SAFETY: promised by the caller.
    String::from_utf8_lossy(unsafe { bytes.get() }).into_owned()
}

/// # Safety
/// As for [`text`].
unsafe fn some_text(bytes: HeartianBytes) -> Option<String> {
    // SAFETY: promised by the caller.
    Some(unsafe { text(bytes) }).filter(|text| !text.is_empty())
}

unsafe extern "C" fn write(context: *mut c_void, piece: HeartianBytes) {
    // SAFETY: the context is what `describe` passed, and the piece lives for the call.
    let (page, piece) = unsafe { (&*context.cast::<Page>(), piece.get()) };
    let mut document = lock(&page.text);
    if document.len().saturating_add(piece.len()) <= DESCRIPTION_LIMIT {
        document.extend_from_slice(piece);
    } else {
        *lock(&page.trouble) = Some(Trouble::new(format!("its description is longer than {DESCRIPTION_LIMIT} bytes")));
    }
}

unsafe extern "C" fn fail_description(context: *mut c_void, message: HeartianBytes, remedy: HeartianBytes) {
    // SAFETY: as above.
    let page = unsafe { &*context.cast::<Page>() };
    // SAFETY: as above.
    let trouble = unsafe { Trouble { message: text(message), remedy: some_text(remedy), ..Trouble::default() } };
    *lock(&page.trouble) = Some(trouble);
}

unsafe extern "C" fn emit(
    context: *mut c_void,
    port: HeartianBytes,
    artifact: HeartianBytes,
    bytes: HeartianBytes,
) -> i32 {
    // SAFETY: the context is what `run` passed, and the bytes live for the call.
    let (hook, port, artifact, bytes) =
        unsafe { (&*context.cast::<Hook<'_>>(), text(port), text(artifact), bytes.get()) };
    if lock(&hook.events).output(&port, &artifact, Cow::Borrowed(bytes)) { HEARTIAN_OK } else { HEARTIAN_FAILED }
}

unsafe extern "C" fn fail(
    context: *mut c_void,
    message: HeartianBytes,
    remedy: HeartianBytes,
    parameter: HeartianBytes,
) {
    // SAFETY: as above.
    let hook = unsafe { &*context.cast::<Hook<'_>>() };
    // SAFETY: as above.
    let (message, remedy, parameter) = unsafe { (text(message), some_text(remedy), some_text(parameter)) };
    *lock(&hook.trouble) = Some(Trouble { message, remedy, parameter, cancelled: false });
}

unsafe extern "C" fn report(context: *mut c_void, step: u64, total: u64, metric: HeartianBytes, value: f64) -> i32 {
    // SAFETY: as above.
    let (hook, name) = unsafe { (&*context.cast::<Hook<'_>>(), some_text(metric)) };
    let metric = name.as_deref().map(|name| (name, value));
    i32::from(!lock(&hook.events).progress(step, total, metric))
}

unsafe extern "C" fn warn(context: *mut c_void, line: HeartianBytes) {
    // SAFETY: as above.
    let (hook, line) = unsafe { (&*context.cast::<Hook<'_>>(), text(line)) };
    lock(&hook.events).warning(&line);
}
