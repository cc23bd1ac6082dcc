//! Person segmentation: the selfie network, as a soft mask of the frame's own size.

use heartian_ops::{Map, MapMut, Sampling, resize_bilinear};
use heartian_space::Rgb8Image;

use super::sampling::{Border, Patch, sample};
use super::{Net, NetError};

const SIDE: usize = 256;

/// The segmentation network.
#[derive(Debug)]
pub struct PersonMatte {
    net: Net,
}

impl PersonMatte {
    /// Reads the network.
    ///
    /// # Errors
    /// When the file is damaged or is another model.
    pub fn parse(bytes: &[u8]) -> Result<Self, NetError> {
        let net = Net::parse(bytes)?;
        if net.input_shape()? != [1, SIDE, SIDE, 3] {
            let reason = format!("its input is {:?}, not [1, 256, 256, 3]", net.input_shape()?);
            return Err(NetError::WrongModel { expected: "selfie segmentation network", reason });
        }
        Ok(Self { net })
    }

    /// Probability of a person in every pixel, `height × width` in [0, 1].
    ///
    /// # Errors
    /// When the network is not the segmentation network, or the image has no pixel.
    pub fn probability(&self, image: &Rgb8Image) -> Result<Vec<f32>, NetError> {
        let step = [image.width as f32 / SIDE as f32, image.height as f32 / SIDE as f32];
        let patch = Patch {
            origin: [0.0; 2],
            right: [step[0], 0.0],
            down: [0.0, step[1]],
            size: [SIDE, SIDE],
            border: Border::Replicate,
        };
        let outputs = self.net.run(sample(image, &patch, 1.0 / 255.0, 0.0))?;
        let wrong = |reason: String| NetError::WrongModel { expected: "selfie segmentation network", reason };
        let mask = outputs.into_iter().find(|output| output.data.len() == SIDE * SIDE);
        let mask = mask.ok_or_else(|| wrong(format!("no output has {SIDE}×{SIDE} values")))?;
        let mut out = vec![0.0; image.width * image.height];
        let input = Map { height: SIDE, width: SIDE, channels: 1, data: &mask.data };
        let output = MapMut { height: image.height, width: image.width, channels: 1, data: &mut out };
        resize_bilinear(input, Sampling::HalfPixel, output).map_err(|error| wrong(error.to_string()))?;
        Ok(out)
    }
}
