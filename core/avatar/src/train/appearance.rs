//! From composited planes to a picture in the encoding it is compared in, the loss there, and the way back.
//!
//! Unshaded, the albedo planes are the picture in linear light; shaded, they pass through deferred shading. Loss:
//! `0.8·L1 + 0.2·(1 − SSIM)` on sRGB over black, the matte's mean absolute error, a tie of the composited normals to
//! their neighbours, and a small one of the light's higher bands to zero.

use heartian_splat::{
    Adam, AdamOptions, Environment, FrameGradient, LightRate, PhotometricWeights, mask_loss, photometric, shade,
    shade_backward, srgb_encode, srgb_encode_backward,
};

use super::targets::{Level, Target};
use crate::AvatarError;
use crate::canonical::Canonical;
use crate::deform::Motion;
use crate::picture::{Features, PictureGradient, Scene};

/// Weight of the matte's mean absolute error.
pub(super) const MASK_WEIGHT: f32 = 0.2;
/// Rate of the light's coefficients at the start.
const LIGHT_RATE: f32 = 3e-3;
/// How the light moves.
const LIGHT_ADAM: AdamOptions = AdamOptions { beta1: 0.9, beta2: 0.99, epsilon: 1e-8 };
/// Pull of the light's bands 1 and higher to zero, per step and rate.
const LIGHT_DECAY: f32 = 1e-3;

/// How planes become a picture.
pub(crate) struct Appearance {
    light: Option<Light>,
}

/// The light on its way.
struct Light {
    environment: Environment,
    adam: Adam,
}

/// Losses of one step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepLoss {
    /// Mean squared error of the encoded picture.
    pub squared_error: f64,
}

impl Appearance {
    /// The albedo planes are the picture.
    pub fn unshaded() -> Self {
        Self { light: None }
    }

    /// Shading under a light that is fitted too.
    pub fn shaded(environment: Environment) -> Self {
        let adam = Adam::new(3 * environment.radiance.len(), LIGHT_ADAM);
        Self { light: Some(Light { environment, adam }) }
    }

    /// Shading under a light on its way; nothing when the moments are not those of its coefficients.
    pub fn from_state(environment: Environment, moments: [Vec<f32>; 2], steps: u32) -> Option<Self> {
        let adam = Adam::from_parts(LIGHT_ADAM, moments, steps)?;
        let fits = adam.len() == 3 * environment.radiance.len()
            && environment.radiance.len() == Environment::default().radiance.len();
        fits.then_some(Self { light: Some(Light { environment, adam }) })
    }

    /// The light and its moments, if there is one yet.
    pub fn state(&self) -> Option<(&Environment, &Adam)> {
        self.light.as_ref().map(|light| (&light.environment, &light.adam))
    }

    /// Whether there is no light yet.
    pub fn is_unshaded(&self) -> bool {
        self.light.is_none()
    }

    /// The light; uniform white when there is none yet.
    pub fn environment(&self) -> Environment {
        self.light.as_ref().map_or_else(|| Environment::uniform([1.0; 3]), |light| light.environment.clone())
    }

    /// Renders, compares and pulls back: *adds* to `gradient` and moves the light by `decay` times its rate.
    pub fn step(
        &mut self,
        canonical: &Canonical,
        motion: &Motion,
        (level, decay): (&Level, f32),
        target: &Target,
        gradient: &mut Canonical,
    ) -> Result<(StepLoss, PictureGradient), AvatarError> {
        let camera = &level.camera;
        let kind = if self.is_unshaded() { Features::Albedo } else { Features::Materials };
        let picture = Scene::new(canonical, motion, camera, kind).picture(camera)?;
        let frame = &picture.frame;
        let linear = match &self.light {
            None => frame.planes.clone(),
            Some(light) => shade(frame, camera, &light.environment)?,
        };
        let encoded = srgb_encode(&linear);
        let mut on_image = vec![0.0; encoded.len()];
        photometric(
            &encoded,
            &target.rgb,
            [camera.width, camera.height],
            PhotometricWeights::default(),
            &mut on_image,
        )?;
        let squared_error = mean_squared_error(&encoded, &target.rgb);
        srgb_encode_backward(&linear, &mut on_image)?;
        let (planes, mut on_transmittance) = match &mut self.light {
            None => (on_image, vec![0.0; frame.transmittance.len()]),
            Some(light) => {
                let back = shade_backward(frame, camera, &light.environment, &on_image)?;
                light.step(&back.radiance, decay)?;
                (back.planes, back.transmittance)
            }
        };
        mask_loss(&frame.transmittance, &target.alpha, MASK_WEIGHT, &mut on_transmittance)?;
        let upstream = FrameGradient { planes: &planes, depth: &[], transmittance: &on_transmittance };
        let pulled = picture.backward(canonical, motion, &upstream, gradient)?;
        Ok((StepLoss { squared_error }, pulled))
    }
}

/// What step number `steps` of the light is.
pub(super) fn light_rate(steps: u32, decay: f32) -> LightRate {
    let rate = LIGHT_RATE * decay;
    LightRate { steps, rate, keep: 1.0 - LIGHT_DECAY * rate / LIGHT_RATE, options: LIGHT_ADAM }
}

impl Light {
    fn step(&mut self, gradient: &[[f32; 3]], decay: f32) -> Result<(), AvatarError> {
        let LightRate { rate, keep, .. } = light_rate(self.adam.steps() + 1, decay);
        let radiance = self.environment.radiance.as_flattened_mut();
        self.adam.step(radiance, gradient.as_flattened(), rate)?;
        for coefficient in radiance.iter_mut().skip(3) {
            *coefficient *= keep;
        }
        Ok(())
    }
}

fn mean_squared_error(image: &[f32], target: &[f32]) -> f64 {
    let sum: f64 =
        image.iter().zip(target).map(|(a, b)| f64::from((a.clamp(0.0, 1.0) - b) * (a.clamp(0.0, 1.0) - b))).sum();
    sum / image.len().max(1) as f64
}
