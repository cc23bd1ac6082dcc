//! Every shader is valid WGSL for every number of channels, whatever machine this is, and keeps to what every device has.

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::gpu::params::{AdamStep, LightStep, LossWeights, Params, SortPass};
use crate::gpu::program::Source;

/// Storage buffers that every WebGPU device can bind to a kernel.
const STORAGE_BUFFERS: usize = 8;
/// Bytes of workgroup memory that every WebGPU device has.
const WORKGROUP_BYTES: u32 = 16_384;

#[test]
fn shaders_are_valid_without_a_device() -> Result<(), Box<dyn std::error::Error>> {
    for source in Source::ALL {
        for groups in 1..=4 {
            let text = source.text(groups);
            let module = naga::front::wgsl::parse_str(&text).map_err(|e| e.emit_to_string(&text))?;
            // No capability beyond the standard: no subgroups, no float atomics, no 64-bit numbers.
            let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
                .validate(&module)
                .map_err(|e| e.emit_to_string(&text))?;
            for (index, entry) in module.entry_points.iter().enumerate() {
                let used = |space: fn(&naga::AddressSpace) -> bool| {
                    let info = info.get_entry_point(index);
                    let used = move |handle: naga::Handle<naga::GlobalVariable>| !info[handle].is_empty();
                    module.global_variables.iter().filter(move |(handle, v)| space(&v.space) && used(*handle))
                };
                let bound = used(|space| matches!(space, naga::AddressSpace::Storage { .. })).count();
                assert!(bound <= STORAGE_BUFFERS, "{source:?} {}: {bound} storage buffers", entry.name);
                let mut layouter = naga::proc::Layouter::default();
                layouter.update(module.to_ctx())?;
                let bytes: u32 = used(|space| matches!(space, naga::AddressSpace::WorkGroup))
                    .map(|(_, variable)| layouter[variable.ty].size)
                    .sum();
                assert!(bytes <= WORKGROUP_BYTES, "{source:?} {}: {bytes} bytes of workgroup memory", entry.name);
            }
        }
    }
    Ok(())
}

#[test]
fn constants_are_laid_out_as_the_shaders_read_them() -> Result<(), Box<dyn std::error::Error>> {
    let sizes = [
        (Source::Project, "Params", size_of::<Params>()),
        (Source::Sort, "Pass", size_of::<SortPass>()),
        (Source::Adam, "Step", size_of::<AdamStep>()),
        (Source::Light, "LightStep", size_of::<LightStep>()),
        (Source::Loss, "Weights", size_of::<LossWeights>()),
    ];
    for (source, name, size) in sizes {
        let module = naga::front::wgsl::parse_str(&source.text(1))?;
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx())?;
        let found = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).map(|(handle, _)| handle);
        let found = found.ok_or(format!("no struct {name}"))?;
        assert_eq!(layouter[found].size as usize, size, "{name}");
    }
    Ok(())
}
