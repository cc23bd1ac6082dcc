//! SIMD dispatch, convolution, pooling and activations on plain `f32` slices.
//!
//! Feature maps are row-major `height × width × channels` ([`Map`]). A kernel is written once over lanes `[f32; L]` and
//! instantiated per instruction set ([`dispatch!`]); every kernel has a plain reference twin in its tests. Results depend
//! on the chosen instruction set only by rounding, and never on the number of threads: nothing here starts one.

pub mod activation;
mod convolution;
mod lanes;
mod map;
mod planar;
mod pooling;
pub mod simd;
mod volume;

pub use convolution::{Filter, conv2d, depthwise_conv2d, linear, transposed_conv2d};
pub use map::{Map, MapMut, ShapeError, Window};
pub use planar::{Convolution, PairScratch, PairedConvolution, Scratch, Strip, Windows};
pub use pooling::{Sampling, average_pool, max_pool, resize_bilinear};
pub use volume::{Extent, FrameMut, Volume};
