//! What of a person is not head: below the end of the fitted mesh, and clothes over the neck.

use std::ops::ControlFlow;

use heartian_face::Observations;
use heartian_space::Rgb8Image;

use super::clothes::{Clothes, Plain, Tally};
use super::neck::Necks;
use super::outline;
use crate::CaptureError;
use crate::crop::Points;

/// Frames, spread over a clip, in which clothes are looked at.
pub(crate) const LOOKS: usize = 32;
/// A pixel is surely a person's from this probability on.
const PERSON: f32 = 0.9;

/// The body in all frames of a clip.
pub(crate) struct Body {
    necks: Necks,
    tally: Tally,
    clothes: Option<Clothes>,
}

/// One frame's body.
pub(crate) struct BodyCut {
    /// What the end of the mesh leaves of each pixel, in [0, 1].
    pub(super) kept: Vec<f32>,
    /// How surely each pixel shows clothes, in [0, 1].
    pub(super) worn: Vec<f32>,
}

impl Body {
    /// Fits the head to the landmarks of a clip; `None` where they show no head. `go_on` is asked now and then.
    pub(crate) fn fitted(
        landmarks: &Observations,
        go_on: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Option<Self>, CaptureError> {
        let necks = Necks::fit(landmarks, go_on)?;
        Ok(necks.map(|necks| Self { necks, tally: Tally::new(), clothes: None }))
    }

    /// Looks at what a frame's person wears.
    pub(crate) fn look(&mut self, frame: usize, image: &Rgb8Image, probability: &[f32], face: &Points) {
        let zones = self.necks.zones(frame, image.width);
        let face = outline::face_mask(face, image.width);
        for (i, pixel) in image.data.as_chunks::<3>().0.iter().enumerate() {
            if face[i] > 0.5 {
                self.tally.add(*pixel, Plain::Face);
            } else if probability[i] > PERSON && zones.kept[i] <= 0.0 {
                self.tally.add(*pixel, Plain::Body);
            } else if probability[i] > PERSON && zones.kept[i] >= 1.0 && !zones.dressed[i] {
                self.tally.add(*pixel, Plain::Hair);
            }
        }
        self.clothes = self.tally.clothes();
    }

    /// The body in a frame.
    pub(crate) fn cut(&self, frame: usize, image: &Rgb8Image) -> BodyCut {
        let zones = self.necks.zones(frame, image.width);
        let nothing = || vec![0.0; zones.dressed.len()];
        let worn = self.clothes.as_ref().map_or_else(nothing, |clothes| clothes.worn(image, &zones.dressed));
        BodyCut { kept: zones.kept, worn }
    }
}
