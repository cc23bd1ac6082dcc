//! A face followed through a stream of frames, so that decoders see the same skin in each.
//!
//! The detector looks at every few frames only; between two looks the box moves in a straight line, which needs the frames
//! between them to wait: that many frames are held and no more. Methods get the mean colour of the box itself, pixels at
//! its rim weighted by how much of them lies inside; networks get the box enlarged by half, as they were trained.

use heartian_signal::methods::Rgb;
use heartian_space::Rgb8Image;

use crate::Reading;
use crate::preprocess::{FaceBox, FollowedBox, HAAR_ENLARGEMENT, Pixels};

/// Feeds a [`Reading`] from whole frames.
#[derive(Debug)]
pub struct Following<'a> {
    reading: Reading<'a>,
    look_every: usize,
    followed: FollowedBox,
    /// The box at the first waiting frame; `None` while no face was seen.
    from: Option<[f32; 4]>,
    waiting: Vec<(f64, Rgb8Image)>,
    seen: usize,
    looks: usize,
}

/// What became of the looking.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Looks {
    /// Frames the detector was shown.
    pub looks: usize,
    /// Frames in which it saw a face.
    pub seen: usize,
}

impl<'a> Following<'a> {
    /// Follows with a look at every `look_every`th frame, at least one.
    pub fn new(reading: Reading<'a>, look_every: usize) -> Self {
        Self {
            reading,
            look_every: look_every.max(1),
            followed: FollowedBox::default(),
            from: None,
            waiting: Vec::new(),
            seen: 0,
            looks: 0,
        }
    }

    /// Looks at every `look_every`th frame from here on, at least one.
    pub fn look_every(&mut self, look_every: usize) {
        self.look_every = look_every.max(1);
    }

    /// Takes the next frame; `find` tells the edges (left, top, right, bottom; pixels) of the face in it.
    ///
    /// # Errors
    /// Those of `find`.
    pub fn frame<E>(
        &mut self,
        seconds: f64,
        image: Rgb8Image,
        find: impl FnOnce(&Rgb8Image) -> Result<Option<[f32; 4]>, E>,
    ) -> Result<(), E> {
        if self.waiting.is_empty() && self.looks == 0 || self.waiting.len() >= self.look_every {
            let found = find(&image)?;
            self.looks += 1;
            self.seen += usize::from(found.is_some());
            let to = self.followed.follow(found);
            self.release(to);
            self.from = to;
        }
        self.waiting.push((seconds, image));
        Ok(())
    }

    /// Hands the waiting frames on, their boxes between the last one and `to`.
    fn release(&mut self, to: Option<[f32; 4]>) {
        let count = self.waiting.len();
        for (index, (seconds, image)) in std::mem::take(&mut self.waiting).into_iter().enumerate() {
            let part = index as f32 / count as f32;
            let edges = match (self.from, to) {
                (Some(from), Some(to)) => Some(std::array::from_fn(|k| from[k] + part * (to[k] - from[k]))),
                (from, to) => from.or(to),
            };
            hand_on(&mut self.reading, seconds, &image, edges);
        }
    }

    /// The reading with all its frames, and how often a face was seen.
    pub fn finish(mut self) -> (Reading<'a>, Looks) {
        self.release(self.from);
        (self.reading, Looks { looks: self.looks, seen: self.seen })
    }
}

/// Gives one frame to a reading: the box of the edges, or all of the frame where there is none.
pub fn hand_on(reading: &mut Reading<'_>, seconds: f64, image: &Rgb8Image, edges: Option<[f32; 4]>) {
    let whole = [0.0, 0.0, image.width as f32, image.height as f32];
    let color = box_mean(image, edges.unwrap_or(whole)).or_else(|| box_mean(image, whole)).unwrap_or([0.0; 3]);
    let face = edges.and_then(FaceBox::from_edges).map(|face| face.enlarged(HAAR_ENLARGEMENT));
    let crop = face.map(|face| face.crop(image.width, image.height));
    let part = crop.and_then(|(rows, columns)| Pixels::of(&image.data, image.width, rows, columns));
    if let Some(part) = part.or_else(|| Pixels::of(&image.data, image.width, 0..image.height, 0..image.width)) {
        reading.frame(seconds, color, &part);
    }
}

/// Mean colour of the pixels between the edges, those at the rim by their share; `None` when none lies inside.
fn box_mean(image: &Rgb8Image, [left, top, right, bottom]: [f32; 4]) -> Option<Rgb> {
    let along = |from: f32, to: f32, most: usize| {
        let (from, to) = (f64::from(from).max(0.0), f64::from(to).min(most as f64));
        let first = from as usize;
        let weight = move |k: usize| ((k + 1) as f64).min(to) - (k as f64).max(from);
        let weights: Vec<f64> = (first..(to.ceil() as usize).min(most)).map(weight).collect();
        (first, weights)
    };
    let ((x, columns), (y, rows)) = (along(left, right, image.width), along(top, bottom, image.height));
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for (row, row_weight) in rows.iter().enumerate() {
        let from = 3 * ((y + row) * image.width + x);
        let pixels = image.data[from..from + 3 * columns.len()].as_chunks::<3>().0;
        let Some((last, inner)) = pixels.split_last() else { continue };
        let mut line = [0.0; 3];
        // All but the first and the last count fully.
        let mut whole = [0u32; 3];
        for pixel in inner.iter().skip(1) {
            (0..3).for_each(|c| whole[c] += u32::from(pixel[c]));
        }
        let rim = inner.first().map(|first| (first, columns[0]));
        for (pixel, weight) in rim.into_iter().chain([(last, columns[columns.len() - 1])]) {
            (0..3).for_each(|c| line[c] += weight * f64::from(pixel[c]));
        }
        (0..3).for_each(|c| sum[c] += row_weight * (line[c] + f64::from(whole[c])));
        total += row_weight * columns.iter().sum::<f64>();
    }
    (total > 0.0).then(|| sum.map(|value| value / total))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use std::convert::Infallible;

    use heartian_signal::{Method, Preset};

    use super::*;
    use crate::{Reader, Statistics};

    #[test]
    fn the_mean_of_a_box_weighs_its_rim() {
        let mut image = Rgb8Image::filled(5, 4, [0; 3]);
        image.set_pixel(1, 1, [100, 0, 50]);
        image.set_pixel(2, 1, [0, 40, 0]);
        let mean = box_mean(&image, [0.5, 1.0, 2.5, 2.0]).unwrap();
        assert!((mean[0] - 50.0).abs() < 1e-9 && (mean[1] - 10.0).abs() < 1e-9 && (mean[2] - 25.0).abs() < 1e-9);
        assert_eq!(box_mean(&image, [9.0, 9.0, 12.0, 12.0]), None);
        assert_eq!(box_mean(&image, [1.0, 1.0, 2.0, 2.0]), Some([100.0, 0.0, 50.0]));
        assert_eq!(box_mean(&image, [f32::NAN; 4]).map(|mean| mean[1] > 0.0), Some(true), "NaN edges are no edges");
    }

    /// A face that moves across a bright background keeps its colour, though the detector sees every tenth frame only.
    #[test]
    fn the_box_moves_with_the_face_between_looks() {
        let readers = [Reader::Classical(Method::Green)];
        let mut following = Following::new(Reading::new(&readers, Statistics::PerChunk), 10);
        for k in 0..200u32 {
            let left = 10 + k as usize / 4;
            let mut image = Rgb8Image::filled(120, 40, [255; 3]);
            let beat = (10.0 * (std::f64::consts::TAU * 1.2 * f64::from(k) / 30.0).sin()) as i32;
            let skin = Rgb8Image::filled(30, 30, [180, (100 + beat) as u8, 90]);
            image.paste(&skin, left, 5);
            let find = |_: &Rgb8Image| -> Result<_, Infallible> {
                Ok(Some([left as f32 + 4.0, 9.0, left as f32 + 26.0, 31.0]))
            };
            following.frame(f64::from(k) / 30.0, image, find).unwrap();
        }
        let (reading, looks) = following.finish();
        assert_eq!(looks, Looks { looks: 20, seen: 20 });
        let protocol = Preset::ToolboxFine.protocol();
        let wave = reading.finish(&protocol).remove(0).unwrap();
        assert_eq!(wave.values.len(), 200);
        assert!(wave.values.iter().all(|green| (89.0..=111.0).contains(green)), "background got in");
        assert!((protocol.estimate(&wave.values, wave.rate_hertz).unwrap().bpm - 72.0).abs() < 1.0);
    }
}
