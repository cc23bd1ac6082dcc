//! The constants of a frame as the shaders read them; `Params` and `Pass` of the WGSL texts, field by field.

use bytemuck::{Pod, Zeroable};

use crate::project::View;

/// Side of a tile, pixels; `TILE` of the shaders.
pub(crate) const TILE: usize = 16;
/// Pairs that a workgroup of the sort takes, and splats that one of the count takes.
pub(crate) const BLOCK: usize = 2048;
/// Entries of a bucket of the backward pass.
pub(crate) const BUCKET: usize = 32;
/// Channels of a group.
pub(crate) const GROUP: usize = 4;

/// `Params` of `common.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Params {
    pub rows: [[f32; 4]; 3],
    pub lens: [f32; 4],
    pub bounds: [f32; 4],
    pub near: f32,
    pub low_pass: f32,
    pub count: u32,
    pub features: u32,
    pub channels: u32,
    pub width: u32,
    pub height: u32,
    pub columns: u32,
    pub tiles: u32,
    pub capacity: u32,
    pub stride: u32,
    pub spare: u32,
}

impl Params {
    /// The camera's part.
    pub fn of_view(view: &View) -> Self {
        let [[low_x, low_y], [high_x, high_y]] = [view.low, view.high];
        let ([fx, fy], [cx, cy]) = (view.focal, view.principal);
        Self {
            rows: std::array::from_fn(|r| {
                let [x, y, z] = view.rows[r];
                [x, y, z, view.translation[r]]
            }),
            lens: [fx, fy, cx, cy],
            bounds: [low_x, low_y, high_x, high_y],
            near: view.near,
            low_pass: view.low_pass,
            ..Self::default()
        }
    }
}

/// `Pass` of `sort.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct SortPass {
    pub shift: u32,
    pub word: u32,
    pub stride: u32,
    pub indexed: u32,
}

/// Most groups of parameters of one optimiser; `rates` of `adam.wgsl`.
pub(crate) const MOST_GROUPS: usize = 16;

/// `Step` of `adam.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct AdamStep {
    pub beta1: f32,
    pub beta2: f32,
    pub count: u32,
    pub groups: u32,
    pub ends: [u32; MOST_GROUPS],
    pub rates: [[f32; 4]; MOST_GROUPS],
}

/// `LightStep` of `light.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct LightStep {
    pub beta1: f32,
    pub beta2: f32,
    pub rate: f32,
    pub guard: f32,
    pub keep: f32,
    pub spare: [f32; 7],
}

/// `Weights` of `loss.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct LossWeights {
    pub l1: f32,
    pub dssim: f32,
    pub mask: f32,
    pub slot: u32,
}
