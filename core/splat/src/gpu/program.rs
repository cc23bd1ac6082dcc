//! Kernels by name, and lists of dispatches that are made once and replayed every frame.

use std::collections::HashMap;
use std::sync::PoisonError;

use super::device::Gpu;

/// A WGSL file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Source {
    Project,
    Bin,
    Sort,
    Raster,
    Adam,
    Shade,
    Loss,
    Light,
    /// Of another crate.
    Other(&'static str),
}

impl Source {
    /// All files.
    #[cfg(test)]
    pub const ALL: [Self; 8] =
        [Self::Project, Self::Bin, Self::Sort, Self::Raster, Self::Adam, Self::Shade, Self::Loss, Self::Light];

    /// The text that is compiled, for pixels of `groups` of four channels.
    pub fn text(self, groups: u32) -> String {
        let own = match self {
            Self::Project => include_str!("../project.wgsl"),
            Self::Bin => include_str!("../bin.wgsl"),
            Self::Sort => include_str!("sort.wgsl"),
            Self::Raster => include_str!("../raster.wgsl"),
            Self::Adam => include_str!("../adam.wgsl"),
            Self::Shade => include_str!("../shade.wgsl"),
            Self::Loss => include_str!("../loss.wgsl"),
            Self::Light => include_str!("light.wgsl"),
            Self::Other(text) => text,
        };
        format!("const G: u32 = {groups}u;\n{}\n{own}", include_str!("common.wgsl"))
    }

    /// Whether the text depends on the groups of channels.
    fn is_sized(self) -> bool {
        matches!(self, Self::Project | Self::Raster | Self::Shade)
    }
}

/// Compiled kernels, by file, groups of channels and name; made when first asked for.
#[derive(Default)]
pub(crate) struct Programs {
    modules: HashMap<(Source, u32), wgpu::ShaderModule>,
    pipelines: HashMap<(Source, u32, &'static str), wgpu::ComputePipeline>,
}

/// How many workgroups a dispatch has.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Groups {
    /// As many, in rows of [`ROW`].
    Linear(u32),
    /// Columns and rows.
    Grid(u32, u32),
    /// What the device wrote: the dispatch of this index of the buffer of dispatches.
    Indirect(u64),
}

/// Workgroups in a row of a linear dispatch; `ROW` of the shaders.
const ROW: u32 = 32_768;

#[derive(Debug)]
struct Dispatch {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    groups: Groups,
}

/// A kernel's name and what is bound to it.
pub(crate) struct Call<'a> {
    pub source: Source,
    pub entry: &'static str,
    pub bindings: &'a [(u32, &'a wgpu::Buffer)],
    pub groups: Groups,
}

/// Dispatches in their order.
#[derive(Debug, Default)]
pub(crate) struct Recording {
    dispatches: Vec<Dispatch>,
}

impl Recording {
    /// Whether nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.dispatches.is_empty()
    }

    /// Adds a dispatch of a kernel for `groups_of_channels`.
    pub fn add(&mut self, gpu: &Gpu, groups_of_channels: u32, call: &Call<'_>) {
        let pipeline = gpu.pipeline(call.source, groups_of_channels, call.entry);
        let entries: Vec<wgpu::BindGroupEntry<'_>> = call
            .bindings
            .iter()
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() })
            .collect();
        let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(call.entry),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        self.dispatches.push(Dispatch { pipeline, bindings, groups: call.groups });
    }

    /// Encodes all of them; `indirect` holds the sizes that the device decides, where it decides any.
    pub fn replay(&self, encoder: &mut wgpu::CommandEncoder, indirect: Option<&wgpu::Buffer>) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        for dispatch in &self.dispatches {
            pass.set_pipeline(&dispatch.pipeline);
            pass.set_bind_group(0, &dispatch.bindings, &[]);
            match dispatch.groups {
                Groups::Linear(groups) => pass.dispatch_workgroups(groups.min(ROW), groups.div_ceil(ROW), 1),
                Groups::Grid(columns, rows) => pass.dispatch_workgroups(columns, rows, 1),
                Groups::Indirect(index) => {
                    if let Some(indirect) = indirect {
                        pass.dispatch_workgroups_indirect(indirect, 12 * index);
                    }
                }
            }
        }
    }
}

impl Gpu {
    fn pipeline(&self, source: Source, groups: u32, entry: &'static str) -> wgpu::ComputePipeline {
        let groups = if source.is_sized() { groups } else { 1 };
        let mut programs = self.programs.lock().unwrap_or_else(PoisonError::into_inner);
        let Programs { modules, pipelines } = &mut *programs;
        let make = || {
            let module = modules.entry((source, groups)).or_insert_with(|| {
                self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: Some(entry),
                    source: wgpu::ShaderSource::Wgsl(source.text(groups).into()),
                })
            });
            self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: None,
                module,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        };
        pipelines.entry((source, groups, entry)).or_insert_with(make).clone()
    }
}
