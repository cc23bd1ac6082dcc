//! A mesh renderer: watertight rasterisation with eight samples a pixel, area lights, soft shadows, Lambert and GGX.
//!
//! It draws the synthetic recording and shares nothing with the Gaussian rasteriser, so that what is fitted was not
//! drawn by the fitter. Image coordinates are pixels, x right, y down, pixel centres at +0.5; light is linear.

mod light;
mod occlusion;
mod raster;
mod shade;

pub use light::{AreaLight, Lighting};
pub use occlusion::{Transfer, visibility_basis};
pub use raster::{EIGHT_SAMPLES, Fragment, ONE_SAMPLE, ScreenVertex, VisibilityBuffer};
pub use shade::{Surface, shade};
