//! Where the rasteriser runs, as the user says it.
//!
//! `auto` never means a software adapter: where there is no real GPU, it is the CPU.

use crate::error::SplatError;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// What stands before every kernel's WGSL: guards, and the rows of large dispatches.
pub const KERNEL_PRELUDE: &str = concat!("const G: u32 = 1u;\n", include_str!("gpu/common.wgsl"), "\n");

/// What a renderer or a trainer is asked to run on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Device {
    /// A GPU when there is a real one, else the CPU.
    #[default]
    Auto,
    /// The CPU's lanes and threads.
    Cpu,
    /// A GPU; an error where there is none.
    Gpu,
}

impl Device {
    /// All of them, in the order a manual lists them.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Cpu, Self::Gpu];

    /// `auto`, `cpu` or `gpu`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Device {
    type Err = SplatError;

    fn from_str(text: &str) -> Result<Self, SplatError> {
        let found = Self::ALL.into_iter().find(|device| device.name().eq_ignore_ascii_case(text.trim()));
        found.ok_or_else(|| SplatError::Device(format!("{text:?} is no device; choose auto, cpu or gpu")))
    }
}

/// What a machine's adapter is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AdapterReport {
    /// As the driver names it.
    pub name: String,
    /// `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// Driver and its version.
    pub driver: String,
    /// Largest buffer that a kernel can see at once, bytes.
    pub largest_binding: u64,
    /// Most workgroups along one axis of a dispatch.
    pub workgroups: u32,
    /// Whether it computes on the CPU.
    pub is_software: bool,
    /// Whether it has what the kernels need.
    pub is_usable: bool,
    /// Whether `auto` takes it.
    pub is_automatic: bool,
}

impl AdapterReport {
    /// Whether it may be taken for `device`: a software adapter only where a GPU is asked for in so many words.
    pub fn suits(&self, device: Device) -> bool {
        match device {
            Device::Cpu => false,
            Device::Auto => self.is_usable && !self.is_software,
            Device::Gpu => self.is_usable,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_others_are_refused() {
        assert!(Device::ALL.into_iter().all(|device| device.name().parse::<Device>().is_ok_and(|d| d == device)));
        assert!("GPU".parse::<Device>().is_ok_and(|d| d == Device::Gpu));
        assert!("cuda".parse::<Device>().is_err_and(|e| e.to_string().contains("auto, cpu or gpu")));
        assert_eq!(Device::default(), Device::Auto);
    }
}
