//! Landmarks seen in a clip: what the tracker fits, and all it sees.
//!
//! Always holds: the image has area, times are finite and strictly increasing, every frame's landmarks have finite
//! positions, finite non-negative weights and strictly increasing indices below [`Observations::LANDMARKS`]. Positions
//! are pixels with centres at +0.5; a frame without a face has no landmarks.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::FaceError;

/// One landmark in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    /// Index in MediaPipe's face mesh: 0–467, and 468–477 for the irises.
    pub index: u32,
    /// Where it was seen, pixels.
    pub position_px: [f32; 2],
    /// Confidence; 1 is ordinary, 0 is ignored.
    pub weight: f32,
}

/// All landmarks of a clip, stored flat.
#[derive(Clone, Debug, PartialEq)]
pub struct Observations {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// `T` frame times, seconds.
    pub times_seconds: Vec<f64>,
    /// `T+1`: frame `t` owns entries `offsets[t]..offsets[t+1]` of the arrays below.
    offsets: Vec<u32>,
    /// Landmark indices.
    indices: Vec<u32>,
    /// Positions, pixels.
    positions_px: Vec<[f32; 2]>,
    /// Weights.
    weights: Vec<f32>,
}

impl Observations {
    /// One more than the largest landmark index.
    pub const LANDMARKS: u32 = 478;

    /// Checks and stores the landmarks of every frame; `None` or an empty list is a frame without a face.
    /// Landmarks may come in any order.
    ///
    /// # Errors
    /// Zero-size image, no frame, as many times as frames not given, times out of order, a position or weight that is
    /// not a number, a negative weight, an index out of range or twice in one frame.
    pub fn new(
        width: usize,
        height: usize,
        times_seconds: Vec<f64>,
        frames: Vec<Option<Vec<Landmark>>>,
    ) -> Result<Self, FaceError> {
        if frames.len() != times_seconds.len() {
            let reason = format!("{} frames and {} times; give one time a frame", frames.len(), times_seconds.len());
            return Err(FaceError::Observations(reason));
        }
        let mut observations = Self {
            width,
            height,
            times_seconds,
            offsets: vec![0],
            indices: Vec::new(),
            positions_px: Vec::new(),
            weights: Vec::new(),
        };
        for frame in frames {
            let mut landmarks = frame.unwrap_or_default();
            landmarks.sort_by_key(|landmark| landmark.index);
            for landmark in landmarks {
                observations.indices.push(landmark.index);
                observations.positions_px.push(landmark.position_px);
                observations.weights.push(landmark.weight);
            }
            observations.offsets.push(observations.indices.len() as u32);
        }
        observations.validate()?;
        Ok(observations)
    }

    /// Number of frames, ≥ 1.
    pub fn len(&self) -> usize {
        self.times_seconds.len()
    }

    /// Never true of checked observations; here because every `len` has one.
    pub fn is_empty(&self) -> bool {
        self.times_seconds.is_empty()
    }

    /// Whether a frame shows a face.
    pub fn has_face(&self, frame: usize) -> bool {
        !self.range(frame).is_empty()
    }

    /// The landmarks of one frame, in increasing order of their index; nothing for a frame without a face.
    pub fn frame(&self, frame: usize) -> impl Iterator<Item = Landmark> + '_ {
        self.range(frame).map(|i| Landmark {
            index: self.indices[i],
            position_px: self.positions_px[i],
            weight: self.weights[i],
        })
    }

    /// Whether any frame shows an iris (landmarks 468–477).
    pub fn shows_irises(&self) -> bool {
        self.indices.iter().any(|index| *index >= 468)
    }

    fn range(&self, frame: usize) -> std::ops::Range<usize> {
        match self.offsets.get(frame..frame + 2) {
            Some([from, to]) => *from as usize..*to as usize,
            _ => 0..0,
        }
    }

    pub(crate) fn validate(&self) -> Result<(), FaceError> {
        if self.width == 0 || self.height == 0 {
            return Err(FaceError::ImageSize { width: self.width, height: self.height });
        }
        if self.times_seconds.is_empty() {
            return Err(FaceError::Observations("there is no frame".into()));
        }
        if let Some(frame) = self.times_seconds.windows(2).position(|pair| !matches!(pair, [a, b] if a < b)) {
            return Err(FaceError::Observations(format!(
                "the time of frame {} is not after the one before",
                frame + 1
            )));
        }
        if self.times_seconds.iter().any(|time| !time.is_finite()) {
            return Err(FaceError::Observations("a time is not finite".into()));
        }
        for frame in 0..self.len() {
            let mut before = None;
            for landmark in self.frame(frame) {
                check(frame, &landmark)?;
                if before.is_some_and(|before| landmark.index <= before) {
                    let reason = format!("landmark {} occurs twice in frame {frame}", landmark.index);
                    return Err(FaceError::Observations(reason));
                }
                before = Some(landmark.index);
            }
        }
        Ok(())
    }
}

fn check(frame: usize, landmark: &Landmark) -> Result<(), FaceError> {
    let Landmark { index, position_px: [x, y], weight } = *landmark;
    for (what, value, fine) in
        [("x", x, x.is_finite()), ("y", y, y.is_finite()), ("weight", weight, weight.is_finite() && weight >= 0.0)]
    {
        if !fine {
            return Err(FaceError::Landmark { frame, landmark: index, what, value });
        }
    }
    if index >= Observations::LANDMARKS {
        let reason = format!("frame {frame} has a landmark {index}; indices run to {}", Observations::LANDMARKS - 1);
        return Err(FaceError::Observations(reason));
    }
    Ok(())
}

impl Artifact for Observations {
    const TYPE: ArtifactType = ArtifactType { name: "observations", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let count = self.indices.len();
        Bundle::new()
            .tensor("times_seconds", &[self.len()], &self.times_seconds)?
            .tensor("offsets", &[self.len() + 1], &self.offsets)?
            .tensor("indices", &[count], &self.indices)?
            .tensor("positions_px", &[count, 2], self.positions_px.as_flattened())?
            .tensor("weights", &[count], &self.weights)?
            .meta("size_px", &[self.width, self.height])
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let [width, height]: [usize; 2] = reader.meta("size_px")?;
        let times_seconds: Vec<f64> = reader.tensor("times_seconds")?.1;
        let offsets = reader.shaped::<u32>("offsets", &[Some(times_seconds.len() + 1)])?;
        let (_, indices) = reader.tensor::<u32>("indices")?;
        let positions_px =
            reader.shaped::<f32>("positions_px", &[Some(indices.len()), Some(2)])?.as_chunks::<2>().0.to_vec();
        let weights = reader.shaped::<f32>("weights", &[Some(indices.len())])?;
        let ordered = offsets.first() == Some(&0) && offsets.windows(2).all(|pair| pair[0] <= pair[1]);
        if !ordered || offsets.last().copied().map(|last| last as usize) != Some(indices.len()) {
            return Err(ArtifactError::Invalid("observations: the offsets do not cover the landmarks".into()));
        }
        let observations = Self { width, height, times_seconds, offsets, indices, positions_px, weights };
        observations.validate().map_err(|error| ArtifactError::Invalid(error.to_string()))?;
        Ok(observations)
    }
}
