//! What goes wrong while describing and running.

use std::time::Duration;

use heartian_plugin_abi::{HEARTIAN_FAILED, HEARTIAN_OK, HeartianBytes, HeartianCall};

/// Never returns, and says nothing.
pub fn hang() -> ! {
    loop {
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// The description, with one fault in it.
pub fn description(fault: &str) -> String {
    let good = r#"{"format": 1, "name": "faulty", "version": "0.1.0", "kinds": [
        {"kind": "Fine", "revision": 1, "doc": "Does as it is told.",
         "outputs": [{"name": "out", "type": "org.example.fault/1", "doc": "One byte."}],
         "params": [{"name": "tag", "type": "u32", "default": 0, "doc": "Tells one from another."}]},
        {"kind": "Faulty", "revision": 1, "doc": "Does wrong.",
         "inputs": [{"name": "in", "type": "org.example.fault/1", "doc": "Ignored.", "required": false}],
         "outputs": [{"name": "out", "type": "org.example.fault/1", "doc": "One byte."},
                     {"name": "clip", "type": "clip/1", "doc": "Rubbish.", "required": false}],
         "params": [{"name": "level", "type": "f64", "default": 0.5, "least": 0, "greatest": 1, "unit": "dB",
                     "doc": "How wrong."},
                    {"name": "mode", "type": "String", "default": "Soft", "choices": ["Soft", "Hard"], "doc": "How."}]}
    ]}"#;
    let (from, to) = match fault {
        "describe_rubbish" => return "{ this is not JSON".to_owned(),
        "describe_binary" => return "\u{0}\u{1}\u{2}".repeat(100),
        "describe_nothing" => return String::new(),
        "describe_endless" => return good.repeat(8000),
        "describe_form" => ("\"format\": 1", "\"format\": 2"),
        "describe_type" => ("org.example.fault/1", "fault/1"),
        "describe_house" => ("clip/1", "clip/99"),
        "describe_default" => ("\"default\": 0.5", "\"default\": 1.5"),
        "describe_default_type" => ("\"default\": 0.5", "\"default\": \"half\""),
        "describe_param" => ("\"type\": \"f64\"", "\"type\": \"quaternion\""),
        "describe_twice" => ("\"Fine\"", "\"Faulty\""),
        "describe_port" => ("\"name\": \"clip\"", "\"name\": \"out\""),
        "describe_builtin" => ("\"Fine\"", "\"Renderer\""),
        "describe_no_output" => (
            "\"outputs\": [{\"name\": \"out\", \"type\": \"org.example.fault/1\", \"doc\": \"One byte.\"}]",
            "\"outputs\": []",
        ),
        _ => ("", ""),
    };
    if from.is_empty() { good.to_owned() } else { good.replacen(from, to, usize::MAX) }
}

/// Writes an output.
///
/// # Safety
/// `call` is the host's.
unsafe fn emit(call: &HeartianCall, port: &str, type_name: &str, bytes: &[u8]) {
    let text = |text: &str| HeartianBytes::of(text.as_bytes());
    if let Some(emit) = call.emit {
        // SAFETY: the host copies the bytes. Its refusal is ignored, which it must survive.
        unsafe { emit(call.context, text(port), text(type_name), HeartianBytes::of(bytes)) };
    }
}

/// Runs a node, with one fault.
pub unsafe extern "C" fn run(call: *const HeartianCall) -> i32 {
    const FAULT_TYPE: &str = "org.example.fault/1";
    // SAFETY: the host passes its own struct.
    let call = unsafe { &*call };
    // SAFETY: the host's text lives for the call.
    let fine = unsafe { call.kind.get() } == b"Fine";
    let fault = if fine { String::new() } else { super::fault() };
    match fault.as_str() {
        "panic" => panic!("the node panics"),
        "abort" => std::process::abort(),
        "exit" => std::process::exit(0),
        // SAFETY: none; that is the point.
        "segfault" => unsafe { std::ptr::null_mut::<u64>().wrapping_add(1).write_volatile(1) },
        "overflow" => return i32::try_from(deeper(1) & 1).unwrap_or(0),
        "hang" => hang(),
        "eat" => {
            let mut eaten = Vec::new();
            loop {
                eaten.push(vec![1u8; 16 << 20]);
            }
        }
        "says_nothing" => return HEARTIAN_FAILED,
        "says_why" => {
            let texts = [&b"the level is too high"[..], b"lower `level`", b"level"].map(HeartianBytes::of);
            if let Some(fail) = call.fail {
                // SAFETY: the host copies the text.
                unsafe { fail(call.context, texts[0], texts[1], texts[2]) };
            }
            return HEARTIAN_FAILED;
        }
        "missing" => return HEARTIAN_OK,
        // SAFETY: the call is the host's, here and below.
        "wrong_type" => unsafe { emit(call, "out", "org.example.other/1", b"x") },
        "undeclared" => unsafe { emit(call, "elsewhere", FAULT_TYPE, b"x") },
        "twice" => unsafe { emit(call, "out", FAULT_TYPE, b"x") },
        "no_clip" => unsafe { emit(call, "clip", "clip/1", b"this is no safetensors file") },
        "prints" => println!("HtP1 rubbish that is no frame"),
        "closes" => faults_of_the_system::close_everything(),
        _ => {}
    }
    // SAFETY: as above.
    unsafe { emit(call, "out", FAULT_TYPE, b"x") };
    HEARTIAN_OK
}

/// Needs more stack than there is.
#[expect(unconditional_recursion, reason = "the fault")]
fn deeper(depth: u64) -> u64 {
    let ballast = std::hint::black_box([depth; 512]);
    deeper(depth + 1) + ballast[(depth % 512) as usize]
}

mod faults_of_the_system {
    //! Pipes pulled from under the host's own code.

    /// Closes every open file of the process, then lives on.
    pub fn close_everything() {
        #[cfg(unix)]
        for descriptor in 0..64 {
            use std::os::fd::FromRawFd;
            // SAFETY: none; the files belong to others. That is the point.
            drop(unsafe { std::fs::File::from_raw_fd(descriptor) });
        }
        super::hang();
    }
}
