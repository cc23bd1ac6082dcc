//! The rasteriser's twin on a GPU: the same pictures and gradients from WGSL, through Vulkan, Metal or Direct3D 12.
//!
//! What always holds: no float is added atomically and every reduction has one order, so a device gives the same bits on
//! every run; the number of (splat, tile) entries never leaves the device, so a frame is one submission; a lost device,
//! memory that does not suffice and a scene past the device's limits are errors that say what to do, never panics.
//! Each `.wgsl` file stands beside the Rust text of the same formula; what only a GPU needs is in `gpu/`.

mod arena;
mod device;
mod fit;
mod frames;
mod kernel;
mod light;
mod optimiser;
mod params;
mod planes;
mod present;
mod program;
mod raster;
mod resident;
mod scene;
mod sort;
mod timing;

#[cfg(test)]
mod tests;

pub use device::{Gpu, adapters};
pub use fit::GpuFitter;
pub use frames::GpuFrames;
pub use kernel::{GpuBuffer, GpuKernels, GpuReading};
pub use optimiser::GpuAdam;
pub use present::GpuPresenter;
pub use raster::GpuRasteriser;
