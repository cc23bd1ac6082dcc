//! What shading reads besides the picture: the light's coefficients and the tables of the split sum; and the light's
//! moments, where it is fitted on the device.

use std::sync::Arc;

use super::arena::{Store, uniform};
use super::device::Gpu;
use super::params::LightStep;
use super::program::{Call, Groups, Recording, Source};
use crate::adam::{AdamOptions, corrected_rates};
use crate::brdf::tables;
use crate::environment::{COSINE_BANDS, Environment};
use crate::error::{SplatError, expect_length};
use crate::fit::LightRate;
use crate::harmonics::{BAND_OF, COUNT};

/// Light and tables on a device.
#[derive(Debug)]
pub(crate) struct Lighting {
    light: Store,
    tables: Store,
    moments: Store,
    step: wgpu::Buffer,
}

impl Lighting {
    /// The tables, and a light that is black until it is set.
    ///
    /// # Errors
    /// When the device failed.
    pub fn new(gpu: &Gpu) -> Result<Self, SplatError> {
        let mut own = Self {
            light: Store::new("the light"),
            tables: Store::new("the tables of the split sum"),
            moments: Store::new("the light's moments"),
            step: uniform(gpu, bytemuck::bytes_of(&LightStep::default())),
        };
        let mut values: Vec<f32> = tables().brdf.as_flattened().to_vec();
        values.extend_from_slice(tables().lobe.as_flattened());
        own.tables.ensure(gpu, values.len())?;
        own.light.ensure(gpu, 2 * 4 * COUNT)?;
        own.moments.ensure(gpu, 2 * 4 * COUNT)?;
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

    /// Sets first and second moments (75 each).
    ///
    /// # Errors
    /// When they are not of the light's coefficients.
    pub fn set_moments(&self, gpu: &Gpu, moments: [&[f32]; 2]) -> Result<(), SplatError> {
        for (half, values) in moments.into_iter().enumerate() {
            expect_length("the light's moments", 3 * COUNT, values.len())?;
            let rows: Vec<[f32; 4]> = values.as_chunks::<3>().0.iter().map(|[r, g, b]| [*r, *g, *b, 0.0]).collect();
            let at = (half * 16 * COUNT) as u64;
            gpu.queue.write_buffer(self.moments.get()?, at, bytemuck::cast_slice(&rows));
        }
        Ok(())
    }

    /// What the next submission's step of the light is.
    pub fn set_rate(&self, gpu: &Gpu, rate: &LightRate) {
        let [scaled, guard] = corrected_rates(&rate.options, rate.steps, rate.rate);
        let AdamOptions { beta1, beta2, .. } = rate.options;
        let step = LightStep { beta1, beta2, rate: scaled, guard, keep: rate.keep, spare: [0.0; 7] };
        gpu.queue.write_buffer(&self.step, 0, bytemuck::bytes_of(&step));
    }

    /// Records a step down `on_radiance`, not made where `status` is set.
    ///
    /// # Errors
    /// None once made.
    pub fn record(
        &self,
        gpu: &Gpu,
        recording: &mut Recording,
        [on_radiance, status]: [&wgpu::Buffer; 2],
    ) -> Result<(), SplatError> {
        let bindings =
            [(0, &self.step), (1, self.light.get()?), (2, on_radiance), (3, self.moments.get()?), (4, status)];
        let call = Call { source: Source::Light, entry: "turn_light", bindings: &bindings, groups: Groups::Linear(1) };
        recording.add(gpu, 1, &call);
        Ok(())
    }

    /// The light's coefficients and its moments as the device has them; waits for them.
    ///
    /// # Errors
    /// When the device failed.
    pub fn fetch(&self, gpu: &Arc<Gpu>) -> Result<(Environment, [Vec<f32>; 2]), SplatError> {
        let bytes = 2 * 16 * COUNT as u64;
        let parts = gpu.read(&[(self.light.get()?, bytes), (self.moments.get()?, bytes)])?;
        let rows = |part: usize| -> &[[f32; 4]] { bytemuck::cast_slice(&parts[part]) };
        let radiance = rows(0)[COUNT..].iter().map(|[r, g, b, _]| [*r, *g, *b]).collect();
        let half = |from: usize| rows(1)[from..from + COUNT].iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
        Ok((Environment { radiance }, [half(0), half(COUNT)]))
    }

    /// The two buffers at their places in `shade.wgsl`.
    ///
    /// # Errors
    /// None once made.
    pub fn bindings(&self) -> Result<[(u32, &wgpu::Buffer); 2], SplatError> {
        Ok([(1, self.light.get()?), (2, self.tables.get()?)])
    }
}
