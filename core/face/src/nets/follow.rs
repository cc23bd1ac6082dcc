//! The 468 landmarks of one face, followed from frame to frame.

use std::f32::consts::PI;

use heartian_space::Rgb8Image;

use super::sampling::{Border, Patch, sample};
use super::{Detection, Detector, IrisNet, Net, NetError};

const SIDE: usize = 192;
const POINTS: usize = 468;
const LEAST_PRESENCE: f32 = 0.5;
/// A region of interest is this many times the box it encloses.
const MARGIN: f32 = 1.5;
/// Outer eye corners: the subject's right, the subject's left.
const EYE_CORNERS: [usize; 2] = [33, 263];

/// A rotated square of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roi {
    /// Centre, pixels.
    pub centre_px: [f32; 2],
    /// Side, pixels.
    pub side_px: f32,
    /// Angle from the image's x axis to the square's, radians, y down.
    pub rotation: f32,
}

impl Roi {
    fn from_detection(detection: &Detection) -> Self {
        let [left, top, right, bottom] = detection.box_px;
        let [a, b, ..] = detection.keypoints_px;
        Self::around([left, top, right, bottom], a, b)
    }

    /// The region for the next frame: the box of the landmarks with a margin, turned with the line through the eyes.
    pub fn from_landmarks(points: &[[f32; 3]]) -> Self {
        let mut bounds = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];
        for [x, y, _] in points {
            bounds = [bounds[0].min(*x), bounds[1].min(*y), bounds[2].max(*x), bounds[3].max(*y)];
        }
        let corner = |i: usize| points.get(EYE_CORNERS[i]).map_or([0.0; 2], |p| [p[0], p[1]]);
        Self::around(bounds, corner(0), corner(1))
    }

    fn around([left, top, right, bottom]: [f32; 4], a: [f32; 2], b: [f32; 2]) -> Self {
        Self {
            centre_px: [(left + right) / 2.0, (top + bottom) / 2.0],
            side_px: MARGIN * (right - left).max(bottom - top),
            rotation: (b[1] - a[1]).atan2(b[0] - a[0]),
        }
    }

    fn is_usable(&self) -> bool {
        self.side_px.is_finite()
            && self.side_px >= 1.0
            && self.centre_px.iter().all(|c| c.is_finite())
            && self.rotation.abs() <= PI
    }
}

/// The landmarks of one face in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceLandmarks {
    /// 468 × (x, y, z), or 478 with the irises: pixels; z in the scale of x, negative nearer to the camera, its origin about
    /// the head's centre.
    pub points_px: Vec<[f32; 3]>,
    /// Confidence that a face is there, in [0, 1].
    pub presence: f32,
}

/// The landmark network.
#[derive(Debug)]
pub struct LandmarkNet {
    net: Net,
}

impl LandmarkNet {
    /// Reads the network.
    ///
    /// # Errors
    /// When the file is damaged or is another model.
    pub fn parse(bytes: &[u8]) -> Result<Self, NetError> {
        let net = Net::parse(bytes)?;
        if net.input_shape()? != [1, SIDE, SIDE, 3] {
            let reason = format!("its input is {:?}, not [1, 192, 192, 3]", net.input_shape()?);
            return Err(NetError::WrongModel { expected: "468-point face landmark network", reason });
        }
        Ok(Self { net })
    }

    /// Landmarks inside a region, whatever it shows: look at `presence`.
    ///
    /// # Errors
    /// When the network is not the landmark network.
    pub fn landmarks(&self, image: &Rgb8Image, roi: &Roi) -> Result<FaceLandmarks, NetError> {
        let (sin, cos) = roi.rotation.sin_cos();
        let step = roi.side_px / SIDE as f32;
        let (right, down) = ([cos * step, sin * step], [-sin * step, cos * step]);
        let half = SIDE as f32 / 2.0;
        let origin = [0, 1].map(|axis| roi.centre_px[axis] - half * (right[axis] + down[axis]));
        let patch = Patch { origin, right, down, size: [SIDE, SIDE], border: Border::Replicate };
        let outputs = self.net.run(sample(image, &patch, 1.0 / 255.0, 0.0))?;
        let of_size = |wanted: usize| {
            outputs.iter().find(|output| output.data.len() == wanted).ok_or_else(|| NetError::WrongModel {
                expected: "468-point face landmark network",
                reason: format!("no output has {wanted} values"),
            })
        };
        let presence = 1.0 / (1.0 + (-of_size(1)?.data[0]).exp());
        let points = of_size(3 * POINTS)?.data.as_chunks::<3>().0.iter().map(|[x, y, z]| {
            [origin[0] + x * right[0] + y * down[0], origin[1] + x * right[1] + y * down[1], z * step]
        });
        Ok(FaceLandmarks { points_px: points.collect(), presence })
    }
}

/// Follows one face: detects where it is lost, then reads each region from the frame before. At first the largest face
/// is taken, or another by its rank in size; after a loss the one nearest to where it was last.
#[derive(Debug)]
pub struct FaceFollower<'a> {
    detector: &'a Detector,
    landmarks: &'a LandmarkNet,
    irises: Option<&'a IrisNet>,
    rank: usize,
    roi: Option<Roi>,
    last: Option<Roi>,
}

impl<'a> FaceFollower<'a> {
    /// A follower of the largest face that has seen nothing.
    pub fn new(detector: &'a Detector, landmarks: &'a LandmarkNet) -> Self {
        Self { detector, landmarks, irises: None, rank: 0, roi: None, last: None }
    }

    /// Follows the face of that rank in size instead, 0 being the largest; with fewer faces the smallest there is.
    pub fn of_rank(mut self, rank: usize) -> Self {
        self.rank = rank;
        self
    }

    /// A follower that reads the irises too, where there is a network for them.
    pub fn with_irises(mut self, irises: Option<&'a IrisNet>) -> Self {
        self.irises = irises;
        self
    }

    /// The landmarks in the next frame, or `None` where no face is seen.
    ///
    /// # Errors
    /// When a network is not what it should be.
    pub fn next(&mut self, image: &Rgb8Image) -> Result<Option<FaceLandmarks>, NetError> {
        let mut found = self.find(image)?;
        if let (Some(face), Some(net)) = (&mut found, self.irises) {
            face.points_px.extend(net.irises(image, &face.points_px)?.into_iter().flatten());
        }
        Ok(found)
    }

    fn find(&mut self, image: &Rgb8Image) -> Result<Option<FaceLandmarks>, NetError> {
        if let Some(roi) = self.roi
            && let Some(found) = self.read(image, &roi)?
        {
            return Ok(Some(found));
        }
        let Some(detection) = choose(self.detector.detect(image)?, self.rank, self.last) else { return Ok(None) };
        // A detection frames the face differently from landmarks: read once more in the landmarks' own frame.
        if self.read(image, &Roi::from_detection(&detection))?.is_none() {
            return Ok(None);
        }
        match self.roi {
            Some(roi) => self.read(image, &roi),
            None => Ok(None),
        }
    }

    /// Reads one region and remembers the next; forgets the face when it is not there.
    fn read(&mut self, image: &Rgb8Image, roi: &Roi) -> Result<Option<FaceLandmarks>, NetError> {
        self.roi = None;
        if !roi.is_usable() {
            return Ok(None);
        }
        let found = self.landmarks.landmarks(image, roi)?;
        let sound = found.points_px.iter().flatten().all(|value| value.is_finite());
        if !sound || found.presence.is_nan() || found.presence < LEAST_PRESENCE {
            return Ok(None);
        }
        self.roi = Some(Roi::from_landmarks(&found.points_px));
        self.last = self.roi;
        Ok(Some(found))
    }
}

/// The detection to follow: the one nearest to the last region when its centre lies inside, else the one of that rank by
/// size, or the smallest when there are fewer.
fn choose(mut found: Vec<Detection>, rank: usize, last: Option<Roi>) -> Option<Detection> {
    let side = |d: &Detection| (d.box_px[2] - d.box_px[0]).max(d.box_px[3] - d.box_px[1]);
    found.retain(|detection| side(detection) > 0.0);
    if let Some(last) = last {
        let away = |d: &Detection| {
            let offset = [0, 1].map(|k| 0.5 * (d.box_px[k] + d.box_px[k + 2]) - last.centre_px[k]);
            offset[0].hypot(offset[1])
        };
        let nearest = found.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        if let Some(detection) = nearest.filter(|detection| away(detection) < 0.5 * last.side_px) {
            return Some(*detection);
        }
    }
    found.sort_by(|a, b| side(b).total_cmp(&side(a)));
    found.get(rank.min(found.len().saturating_sub(1))).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn face(x: f32, side: f32) -> Detection {
        Detection { box_px: [x, 0.0, x + side, side], keypoints_px: [[x, 1.0]; 6], score: 0.9 }
    }

    #[test]
    fn the_largest_face_is_taken_or_one_by_rank_and_after_a_loss_the_same_again() {
        let both = || vec![face(0.0, 30.0), face(100.0, 60.0)];
        let left = |found: Option<Detection>| found.map(|face| face.box_px[0]);
        assert_eq!(left(choose(both(), 0, None)), Some(100.0));
        assert_eq!(left(choose(both(), 1, None)), Some(0.0));
        assert_eq!(left(choose(both(), 7, None)), Some(0.0), "with two faces the seventh is the smaller one");
        let last = Roi { centre_px: [20.0, 14.0], side_px: 45.0, rotation: 0.0 };
        assert_eq!(left(choose(both(), 0, Some(last))), Some(0.0), "the face that was followed");
        let gone = Roi { centre_px: [900.0, 14.0], ..last };
        assert_eq!(left(choose(both(), 0, Some(gone))), Some(100.0));
        assert_eq!(choose(vec![face(f32::NAN, f32::NAN)], 0, None), None);
        assert_eq!(choose(Vec::new(), 3, Some(last)), None);
    }
}
