//! L_base of stage 2 by rendering: one training frame with offsets on its skin's green albedo, deformed, rasterised,
//! shaded and compared in full, and pulled back through all of it. What the linear map (`operator.rs`) is judged by.

use heartian_space::{Clip, Skin};
use heartian_splat::{
    FrameGradient, PhotometricWeights, photometric, shade, shade_backward, srgb_encode, srgb_encode_backward,
};

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::evaluate::planar;
use crate::operator::check_recording;
use crate::picture::{AlbedoOffsets, Features, Scene};

/// An avatar whose every parameter is frozen but the green albedo of its skin, beside the recording it was fitted to.
pub struct FrozenRender<'a> {
    avatar: &'a Avatar,
    skin: &'a Skin,
    clip: &'a Clip,
    weights: PhotometricWeights,
}

impl<'a> FrozenRender<'a> {
    /// With the photometric weights of stage 1: 0.8·L1 + 0.2·D-SSIM on encoded pictures over black.
    ///
    /// # Errors
    /// When the clip is not the avatar's recording, or the skin names Gaussians that do not exist.
    pub fn new(avatar: &'a Avatar, skin: &'a Skin, clip: &'a Clip) -> Result<Self, AvatarError> {
        check_recording(avatar, skin, clip)?;
        Ok(Self { avatar, skin, clip, weights: PhotometricWeights::default() })
    }

    /// The same with other weights.
    pub fn with_weights(self, weights: PhotometricWeights) -> Self {
        Self { weights, ..self }
    }

    /// L_base of one frame at `offsets`, one a skin Gaussian, linear albedo; **adds** its gradient to `gradient`.
    ///
    /// # Errors
    /// When the frame does not exist or a length is not that of the skin.
    pub fn loss(&self, frame: usize, offsets: &[f32], gradient: &mut [f32]) -> Result<f64, AvatarError> {
        let Avatar { canonical, motion, environment, camera, states, .. } = self.avatar;
        let count = self.skin.gaussians.len();
        if offsets.len() != count || gradient.len() != count || frame >= states.len() {
            let expected = format!("{count} skin Gaussians, frames below {}", states.len());
            let found = format!("{} offsets, {} gradients, frame {frame}", offsets.len(), gradient.len());
            return Err(AvatarError::Mismatch { what: "the offsets of a frame", expected, found });
        }
        let mut scene = Scene::new(canonical, &motion.motion(&states[frame]), camera, Features::Materials);
        scene.add_albedo(AlbedoOffsets { gaussians: &self.skin.gaussians, green: offsets, red_blue: &[] });
        let picture = scene.picture(camera)?;
        let linear = shade(&picture.frame, camera, environment)?;
        let encoded = srgb_encode(&linear);
        let mut on_image = vec![0.0; encoded.len()];
        let size = [camera.width, camera.height];
        let loss = photometric(&encoded, &planar(self.clip, frame), size, self.weights, &mut on_image)?;
        srgb_encode_backward(&linear, &mut on_image)?;
        let back = shade_backward(&picture.frame, camera, environment, &on_image)?;
        let upstream = FrameGradient { planes: &back.planes, depth: &[], transmittance: &back.transmittance };
        let gaussians = picture.scene.gaussians();
        let pulled = heartian_splat::backward(&gaussians, &picture.prepared, &picture.frame, &upstream)?;
        for (&index, to) in self.skin.gaussians.iter().zip(gradient) {
            let green = index as usize * gaussians.channels + 1;
            // At either end of the albedo's range the sum is held, and what is held has no slope.
            if (f32::EPSILON..=1.0 - f32::EPSILON).contains(&gaussians.features[green]) {
                *to += pulled.features[green];
            }
        }
        Ok(loss.total)
    }
}
