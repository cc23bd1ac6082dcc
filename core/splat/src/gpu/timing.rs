//! How long a device takes for a scene that is already there: what a fit or a viewer that keeps everything on the device
//! would see, without transfers.

use std::time::Instant;

use super::raster::GpuRasteriser;
use crate::error::SplatError;

impl GpuRasteriser {
    /// Mean seconds of the last scene's forward pass, and of its backward pass too if one was made and `backward` says
    /// so, over `times` submissions, with nothing read back.
    ///
    /// # Errors
    /// When nothing was rendered yet, or the device failed.
    pub fn resident_seconds(&self, times: u32, backward: bool) -> Result<f64, SplatError> {
        let gpu = self.gpu();
        gpu.wait()?;
        let start = Instant::now();
        for _ in 0..times {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            self.encode_forward(&mut encoder)?;
            if backward {
                self.encode_backward(&mut encoder)?;
            }
            gpu.queue.submit([encoder.finish()]);
        }
        gpu.wait()?;
        Ok(start.elapsed().as_secs_f64() / f64::from(times.max(1)))
    }
}
