//! A plugin that misbehaves, for the host's tests: how is written in the file itself, behind [`FAULT`], so that one build
//! gives a library of each kind by changing a few bytes. Speaks the bare ABI; written against all advice.

mod describe;
mod faults;

use std::io::Write;

use heartian_plugin_abi::{HEARTIAN_ABI_MAJOR, HEARTIAN_ABI_MINOR, HEARTIAN_MAGIC, HeartianHost, HeartianPlugin};

/// The fault's name, between the mark and the first dot.
#[used]
static FAULT: [u8; 48] = *b"HEARTIAN-FAULT=none.............................";

fn fault() -> String {
    // SAFETY: a plain static; read where it lies, because a test may have changed the file.
    let bytes = unsafe { (&raw const FAULT).read_volatile() };
    String::from_utf8_lossy(&bytes["HEARTIAN-FAULT=".len()..]).split('.').next().unwrap_or_default().to_owned()
}

#[cfg(target_os = "linux")]
#[used]
#[unsafe(link_section = ".init_array")]
static AT_LOAD: extern "C" fn() = {
    extern "C" fn at_load() {
        match fault().as_str() {
            "abort_at_load" => std::process::abort(),
            "hang_at_load" => faults::hang(),
            "print_at_load" => {
                // What cannot be printed spoils nothing but the fault.
                let _ = std::io::stdout().write_all(b"HtP1 rubbish that is no frame\n");
                let _ = std::io::stdout().flush();
            }
            _ => {}
        }
    }
    at_load
};

static mut PLUGIN: HeartianPlugin = HeartianPlugin {
    magic: HEARTIAN_MAGIC,
    size: size_of::<HeartianPlugin>() as u32,
    abi_major: HEARTIAN_ABI_MAJOR,
    abi_minor: HEARTIAN_ABI_MINOR,
    reserved: 0,
    describe: Some(describe::describe),
    run: Some(faults::run),
    suite: None,
};

/// The entry, exported in one version and no other.
#[unsafe(no_mangle)]
unsafe extern "C" fn heartian_plugin_v1(_: *const HeartianHost) -> *const HeartianPlugin {
    let plugin = &raw mut PLUGIN;
    // SAFETY: the host calls this once, and nothing else touches the struct.
    let changed = unsafe { &mut *plugin };
    match fault().as_str() {
        "null" => return std::ptr::null(),
        "magic" => changed.magic ^= 1,
        "newer_minor" => changed.abi_minor += 1,
        "newer_major" => changed.abi_major += 1,
        "older_major" => changed.abi_major -= 1,
        "short" => changed.size -= 8,
        "no_run" => changed.run = None,
        "misaligned" => return plugin.cast::<u8>().wrapping_add(1).cast(),
        _ => {}
    }
    plugin
}
