//! The C ABI between Heartian and its plugins: plain types, no dependencies. Used by the host and by the SDK.
#![no_std]

mod types;

pub use types::{
    ENTRY, HEARTIAN_ABI_MAJOR, HEARTIAN_ABI_MINOR, HEARTIAN_CANCELLED, HEARTIAN_FAILED, HEARTIAN_MAGIC, HEARTIAN_OK,
    HeartianBytes, HeartianCall, HeartianDescribe, HeartianEntry, HeartianHost, HeartianInput, HeartianLogSuite,
    HeartianPlugin, HeartianProgressSuite, LOG_SUITE, PROGRESS_SUITE,
};
