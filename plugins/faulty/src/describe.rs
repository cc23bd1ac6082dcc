//! What the plugin says of itself, and the ways in which it fails to.

use heartian_plugin_abi::{HEARTIAN_FAILED, HEARTIAN_OK, HeartianBytes, HeartianDescribe};

use crate::{fault, faults};

pub(crate) unsafe extern "C" fn describe(call: *const HeartianDescribe) -> i32 {
    // SAFETY: the host passes its own struct.
    let call = unsafe { &*call };
    let (Some(write), Some(fail)) = (call.write, call.fail) else { return HEARTIAN_FAILED };
    let text = match fault().as_str() {
        "describe_panics" => panic!("describing is hard"),
        "describe_fails" => {
            let (message, remedy) = (HeartianBytes::of(b"no licence"), HeartianBytes::of(b"buy one"));
            // SAFETY: the host copies the bytes.
            unsafe { fail(call.context, message, remedy) };
            return HEARTIAN_FAILED;
        }
        fault => faults::description(fault),
    };
    // SAFETY: as above.
    unsafe { write(call.context, HeartianBytes::of(text.as_bytes())) };
    HEARTIAN_OK
}
