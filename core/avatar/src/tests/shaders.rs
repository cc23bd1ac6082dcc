//! The avatar's kernels are valid WGSL, whatever machine this is, and keep to what every device has.

use heartian_splat::KERNEL_PRELUDE;
use naga::valid::{Capabilities, ValidationFlags, Validator};

/// Storage buffers and bytes of workgroup memory that every WebGPU device grants a kernel.
const LIMITS: (usize, u32) = (8, 16_384);

#[test]
fn kernels_are_valid_without_a_device() -> Result<(), Box<dyn std::error::Error>> {
    for own in crate::device::TEXTS {
        let text = format!("{KERNEL_PRELUDE}{own}");
        let module = naga::front::wgsl::parse_str(&text).map_err(|e| e.emit_to_string(&text))?;
        let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .map_err(|e| e.emit_to_string(&text))?;
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx())?;
        assert!(!module.entry_points.is_empty());
        for (index, entry) in module.entry_points.iter().enumerate() {
            let info = info.get_entry_point(index);
            let used = || module.global_variables.iter().filter(|(handle, _)| !info[*handle].is_empty());
            let bound = used().filter(|(_, v)| matches!(v.space, naga::AddressSpace::Storage { .. })).count();
            let shared = used().filter(|(_, v)| matches!(v.space, naga::AddressSpace::WorkGroup));
            let bytes: u32 = shared.map(|(_, v)| layouter[v.ty].size).sum();
            assert!(bound <= LIMITS.0 && bytes <= LIMITS.1, "{}: {bound} buffers, {bytes} bytes", entry.name);
        }
    }
    Ok(())
}
