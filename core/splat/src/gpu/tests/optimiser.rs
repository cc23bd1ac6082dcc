//! The device's Adam against the CPU's, poison included.

use super::device;
use crate::gpu::optimiser::GpuAdam;
use crate::tests::scenes::{noise, relative};
use crate::{Adam, AdamOptions, SplatError};

#[test]
fn a_hundred_steps_are_those_of_the_cpu() -> Result<(), SplatError> {
    let Some(gpu) = device() else { return Ok(()) };
    let (options, count) = (AdamOptions { beta2: 0.99, ..AdamOptions::default() }, 1003);
    let mut parameters = noise(count, 1);
    let start = parameters.clone();
    let mut cpu = Adam::new(count, options);
    let mut device = GpuAdam::new(gpu, &parameters, [-2.0, 2.0], options)?;
    for step in 0..100 {
        let mut gradients = noise(count, 2 + step);
        gradients.iter_mut().zip(&start).for_each(|(g, p)| *g += p);
        (gradients[3], gradients[4], gradients[5]) = (f32::NAN, f32::INFINITY, f32::MAX);
        cpu.step(&mut parameters, &gradients, 0.01)?;
        parameters.iter_mut().for_each(|p| *p = p.clamp(-2.0, 2.0));
        device.step(&gradients, 0.01)?;
    }
    let found = device.parameters()?;
    let exact: Vec<f64> = parameters.iter().map(|p| f64::from(*p)).collect();
    assert!(relative(&found, &exact) < 1e-5, "{:e}", relative(&found, &exact));
    assert_eq!(found[3..6], start[3..6]);
    assert!(device.step(&[0.0], 0.01).is_err());
    Ok(())
}
