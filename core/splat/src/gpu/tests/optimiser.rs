//! The device's Adam against the CPU's: groups, poison, what is left alone and what a stop holds.

use super::device;
use crate::gpu::kernel::{GpuBuffer, GpuKernels};
use crate::gpu::optimiser::GpuAdam;
use crate::tests::scenes::{noise, relative};
use crate::{Adam, AdamGroup, AdamOptions, SplatError};

#[test]
fn a_hundred_steps_are_those_of_the_cpu() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let options = AdamOptions { beta2: 0.99, ..AdamOptions::default() };
    let groups =
        [(703, [-2.0, 2.0]), (0, [0.0, 0.0]), (300, [-0.1, 0.1])].map(|(count, range)| AdamGroup { count, range });
    let mut parameters = noise(1003, 1);
    let start = parameters.clone();
    let mut cpu = [Adam::new(703, options), Adam::new(300, options)];
    let device = GpuAdam::new(gpu, &groups, options)?;
    device.parameters().write_floats(0, &parameters)?;
    let status = GpuBuffer::new(gpu, "the status", 1)?;
    let mut kernels = GpuKernels::new(gpu);
    device.record(&mut kernels, &status)?;
    for step in 0..100 {
        let mut gradients = noise(1003, 2 + step);
        gradients.iter_mut().zip(&start).for_each(|(g, p)| *g += p);
        (gradients[3], gradients[4], gradients[5]) = (f32::NAN, f32::INFINITY, f32::MAX);
        // The last group waits for half of the steps.
        let rates = [0.01, if step < 50 { 0.0 } else { 0.002 }];
        let (first, last) = parameters.split_at_mut(703);
        for (index, values) in [first, last].into_iter().enumerate() {
            if rates[index] > 0.0 {
                let of = if index == 0 { &gradients[..703] } else { &gradients[703..] };
                cpu[index].step(values, of, rates[index])?;
                let [low, high] = groups[2 * index].range;
                values.iter_mut().for_each(|p| *p = p.clamp(low, high));
            }
        }
        device.gradients().write_floats(0, &gradients)?;
        device.set_rates(&[(cpu[0].steps(), rates[0]), (0, 0.5), (cpu[1].steps(), rates[1])])?;
        kernels.submit()?;
    }
    let fetch = || -> Result<Vec<f32>, SplatError> {
        let words = gpu.start_reading(&[device.parameters()]).take(gpu)?;
        Ok(words[0].iter().map(|word| f32::from_bits(*word)).collect())
    };
    let found = fetch()?;
    let exact: Vec<f64> = parameters.iter().map(|p| f64::from(*p)).collect();
    assert!(relative(&found, &exact) < 1e-5, "{:e}", relative(&found, &exact));
    assert_eq!(found[3..6], start[3..6]);
    status.write(0, &[1])?;
    kernels.submit()?;
    assert_eq!(fetch()?, found, "a stop holds everything");
    assert!(device.set_rates(&[(1, 0.1)]).is_err() && device.parameters().write(1000, &[0; 4]).is_err());
    assert!(GpuAdam::new(gpu, &[groups[0]; 17], options).is_err());
    Ok(())
}
