//! The device's texts against the CPU's: shaders without a device, pictures, gradients, poison, sizes, determinism.
//!
//! Where there is no adapter at all the tests that need one say that they are skipped. On a machine of CI that is a
//! software adapter; a real GPU is preferred where there is one.

mod fit;
mod optimiser;
mod parity;
mod present;
mod shaders;

use std::sync::{Arc, OnceLock};

use super::device::Gpu;
use crate::device::Device;

/// The machine's device, opened once.
fn device() -> Option<&'static Arc<Gpu>> {
    static DEVICE: OnceLock<Option<Arc<Gpu>>> = OnceLock::new();
    let opened = DEVICE.get_or_init(|| Gpu::open(Device::Gpu).ok().flatten());
    if opened.is_none() {
        println!("skipped: no Vulkan, Metal or Direct3D 12 adapter, not even a software one, is here");
    }
    opened.as_ref()
}
