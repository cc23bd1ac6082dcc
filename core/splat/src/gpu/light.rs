//! What shading reads besides the picture: the light's coefficients and the tables of the split sum.

use super::arena::Store;
use super::device::Gpu;
use crate::brdf::tables;
use crate::environment::{COSINE_BANDS, Environment};
use crate::error::{SplatError, expect_length};
use crate::harmonics::{BAND_OF, COUNT};

/// Light and tables on a device.
#[derive(Debug)]
pub(crate) struct Lighting {
    light: Store,
    tables: Store,
}

impl Lighting {
    /// The tables, and a light that is black until it is set.
    ///
    /// # Errors
    /// When the device failed.
    pub fn new(gpu: &Gpu) -> Result<Self, SplatError> {
        let mut own = Self { light: Store::new("the light"), tables: Store::new("the tables of the split sum") };
        let mut values: Vec<f32> = tables().brdf.as_flattened().to_vec();
        values.extend_from_slice(tables().lobe.as_flattened());
        own.tables.ensure(gpu, values.len())?;
        own.light.ensure(gpu, 2 * 4 * COUNT)?;
        gpu.queue.write_buffer(own.tables.get()?, 0, bytemuck::cast_slice(&values));
        Ok(own)
    }

    /// Sets the light.
    ///
    /// # Errors
    /// When it has not the coefficients of five bands.
    pub fn set(&self, gpu: &Gpu, environment: &Environment) -> Result<(), SplatError> {
        expect_length("the light's coefficients", COUNT, environment.radiance.len())?;
        let scaled = |share: fn(usize) -> f32| {
            environment.radiance.iter().enumerate().map(move |(i, color)| {
                let [r, g, b] = color.map(|c| c * share(i));
                [r, g, b, 0.0]
            })
        };
        let values: Vec<[f32; 4]> = scaled(|i| COSINE_BANDS[BAND_OF[i]]).chain(scaled(|_| 1.0)).collect();
        gpu.queue.write_buffer(self.light.get()?, 0, bytemuck::cast_slice(&values));
        Ok(())
    }

    /// The two buffers at their places in `shade.wgsl`.
    ///
    /// # Errors
    /// None once made.
    pub fn bindings(&self) -> Result<[(u32, &wgpu::Buffer); 2], SplatError> {
        Ok([(1, self.light.get()?), (2, self.tables.get()?)])
    }
}
