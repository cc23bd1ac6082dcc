//! The iris network: centre and rim of the irises, read in squares around the eyes that the landmarks place.

use heartian_space::Rgb8Image;

use super::sampling::{Border, Patch, sample};
use super::{Net, NetError};

const SIDE: usize = 64;
/// Points of an iris: its centre, then its rim.
const POINTS: usize = 5;
/// The square's side in widths of the eye.
const MARGIN: f32 = 2.3;
/// Corners of the eyes: the subject's right and left, each from left to right in a picture. The network learnt on right
/// eyes; left ones are shown to it in a mirror.
const CORNERS: [[usize; 2]; 2] = [[33, 133], [362, 263]];

/// The iris network.
#[derive(Debug)]
pub struct IrisNet {
    net: Net,
}

impl IrisNet {
    /// Reads the network.
    ///
    /// # Errors
    /// When the file is damaged or is another model.
    pub fn parse(bytes: &[u8]) -> Result<Self, NetError> {
        let net = Net::parse(bytes)?;
        if net.input_shape()? != [1, SIDE, SIDE, 3] {
            let reason = format!("its input is {:?}, not [1, 64, 64, 3]", net.input_shape()?);
            return Err(NetError::WrongModel { expected: "iris network", reason });
        }
        Ok(Self { net })
    }

    /// The ten iris points that follow the face mesh's 468 landmarks: right eye, left eye, each its centre and four points
    /// of its rim. `None` where an eye's landmarks or the answer make no sense.
    ///
    /// # Errors
    /// When the network is not the iris network.
    pub fn irises(&self, image: &Rgb8Image, landmarks: &[[f32; 3]]) -> Result<Option<Vec<[f32; 3]>>, NetError> {
        let (right, left) = rayon::join(|| self.iris(image, landmarks, 0), || self.iris(image, landmarks, 1));
        Ok(right?.zip(left?).map(|(right, left)| right.into_iter().chain(left).collect()))
    }

    fn iris(&self, image: &Rgb8Image, landmarks: &[[f32; 3]], eye: usize) -> Result<Option<Vec<[f32; 3]>>, NetError> {
        let Some(patch) = patch(landmarks, eye) else { return Ok(None) };
        let outputs = self.net.run(sample(image, &patch, 1.0 / 255.0, 0.0))?;
        let found = outputs.iter().find(|output| output.data.len() == 3 * POINTS).ok_or_else(|| {
            let reason = format!("no output has {} values", 3 * POINTS);
            NetError::WrongModel { expected: "iris network", reason }
        })?;
        let Patch { origin, right, down, .. } = patch;
        let step = down[0].hypot(down[1]);
        let place = |[x, y, z]: &[f32; 3]| {
            [origin[0] + x * right[0] + y * down[0], origin[1] + x * right[1] + y * down[1], z * step]
        };
        let points: Vec<[f32; 3]> = found.data.as_chunks::<3>().0.iter().map(place).collect();
        let inside = |[x, y, _]: &[f32; 3]| {
            let centre = [0, 1].map(|k| origin[k] + 0.5 * SIDE as f32 * (right[k] + down[k]));
            (x - centre[0]).hypot(y - centre[1]) < 0.5 * SIDE as f32 * step
        };
        Ok(points.iter().all(inside).then_some(points))
    }
}

/// The square around an eye, mirrored for the left one; `None` when the corners are not there or fall together.
fn patch(landmarks: &[[f32; 3]], eye: usize) -> Option<Patch> {
    let [a, b] = CORNERS[eye].map(|index| landmarks.get(index));
    let (a, b) = (a?, b?);
    let width = (b[0] - a[0]).hypot(b[1] - a[1]);
    if !(width.is_finite() && width >= 1.0) {
        return None;
    }
    let step = MARGIN * width / SIDE as f32;
    let (cos, sin) = ((b[0] - a[0]) / width, (b[1] - a[1]) / width);
    let (across, down) = ([cos * step, sin * step], [-sin * step, cos * step]);
    let right = if eye == 0 { across } else { across.map(|value| -value) };
    let half = SIDE as f32 / 2.0;
    let origin = [0, 1].map(|k| 0.5 * (a[k] + b[k]) - half * (right[k] + down[k]));
    Some(Patch { origin, right, down, size: [SIDE, SIDE], border: Border::Replicate })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_are_centred_on_the_eyes_and_the_left_one_is_mirrored() {
        let mut landmarks = vec![[0.0; 3]; 468];
        (landmarks[33], landmarks[133]) = ([10.0, 20.0, 0.0], [30.0, 20.0, 0.0]);
        (landmarks[362], landmarks[263]) = ([50.0, 22.0, 0.0], [70.0, 22.0, 0.0]);
        for (eye, centre, direction) in [(0, [20.0, 20.0], 1.0), (1, [60.0, 22.0], -1.0)] {
            let found = patch(&landmarks, eye);
            let Some(Patch { origin, right, down, .. }) = found else { panic!("no square") };
            let middle = [0, 1].map(|k| origin[k] + 32.0 * (right[k] + down[k]));
            assert!((middle[0] - centre[0]).abs() < 1e-4 && (middle[1] - centre[1]).abs() < 1e-4, "{middle:?}");
            assert!((64.0 * right[0] - direction * 2.3 * 20.0).abs() < 1e-4 && right[1] == 0.0);
        }
        landmarks[133] = landmarks[33];
        assert!(patch(&landmarks, 0).is_none() && patch(&landmarks[..100], 1).is_none());
    }

    #[test]
    fn another_network_is_refused() {
        assert!(IrisNet::parse(b"no network").is_err());
    }
}
