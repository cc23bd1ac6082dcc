//! What a person wears, told from skin and hair by colour: a collar over the neck is no neck.
//!
//! Colours are counted in frames spread over the clip, where it is plain what they belong to: the face and the head's
//! hair on one side, the body below and beside the neck on the other. Bare shoulders look like the face, and then nothing
//! is told. Counts are integers, so their order does not matter.

use heartian_space::Rgb8Image;

use super::smoothstep;

/// Cells of brightness, and of either difference of colours.
const LEVELS: usize = 8;
const HUES: usize = 32;
const CELLS: usize = LEVELS * HUES * HUES;
/// The largest difference of colours told, as a share of their sum.
const WIDEST: f32 = 0.4;
/// Added to the sum: dark pixels have no hue to speak of.
const DARK: f32 = 40.0;
/// Fewer pixels say nothing.
const LEAST: u64 = 400;
/// Density below which a colour counts as not seen.
const UNSEEN: f32 = 2e-4;
/// From this share of the evidence on a pixel may be clothes, and from this it is.
const SURE: [f32; 2] = [0.55, 0.85];

/// What a pixel is plainly part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Plain {
    Face,
    Hair,
    Body,
}

/// Counts of colours.
#[derive(Clone)]
pub(super) struct Tally {
    counts: [Vec<u32>; 3],
}

/// The share of the evidence that says clothes, for every cell of colour.
#[derive(Clone)]
pub(super) struct Clothes {
    share: Vec<f32>,
}

impl Tally {
    pub(super) fn new() -> Self {
        Self { counts: std::array::from_fn(|_| vec![0; CELLS]) }
    }

    pub(super) fn add(&mut self, pixel: [u8; 3], part: Plain) {
        let place = place(pixel).map(|value| value.round() as usize);
        let count = &mut self.counts[part as usize][cell(place)];
        *count = count.saturating_add(1);
    }

    /// `None` when too little was seen of body or face.
    pub(super) fn clothes(&self) -> Option<Clothes> {
        let total = |part: Plain| self.counts[part as usize].iter().map(|count| u64::from(*count)).sum::<u64>();
        if total(Plain::Face) < LEAST || total(Plain::Body) < LEAST {
            return None;
        }
        let density = |part: Plain| -> Vec<f32> {
            let scale = 1.0 / total(part).max(1) as f32;
            blurred(self.counts[part as usize].iter().map(|count| *count as f32 * scale).collect())
        };
        let [face, hair, body] = [Plain::Face, Plain::Hair, Plain::Body].map(density);
        let share = |((face, hair), body): ((&f32, &f32), &f32)| {
            let (head, body) = (face.max(*hair) + UNSEEN, body + UNSEEN);
            body / (body + head)
        };
        Some(Clothes { share: face.iter().zip(&hair).zip(&body).map(share).collect() })
    }
}

impl Clothes {
    /// How surely each pixel shows clothes, in [0, 1]; 0 where they cannot lie.
    pub(super) fn worn(&self, image: &Rgb8Image, dressed: &[bool]) -> Vec<f32> {
        let pixels = image.data.as_chunks::<3>().0.iter().zip(dressed);
        pixels
            .map(|(pixel, dressed)| if *dressed { smoothstep(SURE[0], SURE[1], self.of(*pixel)) } else { 0.0 })
            .collect()
    }

    /// The share at a colour, between the cells around it.
    fn of(&self, pixel: [u8; 3]) -> f32 {
        let at = place(pixel);
        let low = at.map(|value| value.floor());
        let mut sum = 0.0;
        for corner in 0..8usize {
            let high = [corner & 1, corner >> 1 & 1, corner >> 2];
            let mut weight = 1.0;
            let mut from = [0; 3];
            for axis in 0..3 {
                let part = at[axis] - low[axis];
                weight *= if high[axis] == 1 { part } else { 1.0 - part };
                from[axis] = low[axis] as usize + high[axis];
            }
            if weight > 0.0 {
                sum += weight * self.share[cell(from)];
            }
        }
        sum
    }
}

/// Brightness and hue in cells.
fn place([r, g, b]: [u8; 3]) -> [f32; 3] {
    let [r, g, b] = [r, g, b].map(f32::from);
    let sum = r + g + b;
    let hue = |difference: f32| {
        let share = difference / (sum + DARK) / WIDEST;
        (0.5 + 0.5 * share).clamp(0.0, 1.0) * (HUES - 1) as f32
    };
    [sum / 765.0 * (LEVELS - 1) as f32, hue(r - g), hue(b - g)]
}

fn cell([level, u, v]: [usize; 3]) -> usize {
    (level.min(LEVELS - 1) * HUES + u.min(HUES - 1)) * HUES + v.min(HUES - 1)
}

/// Each cell mixed with its neighbours: once along hue, twice along brightness, which shadows change.
fn blurred(mut density: Vec<f32>) -> Vec<f32> {
    for (stride, length) in [(1, HUES), (HUES, HUES), (HUES * HUES, LEVELS), (HUES * HUES, LEVELS)] {
        let before = density.clone();
        for (i, value) in density.iter_mut().enumerate() {
            let at = i / stride % length;
            let lower = if at > 0 { before[i - stride] } else { before[i] };
            let upper = if at + 1 < length { before[i + stride] } else { before[i] };
            *value = 0.25 * lower + 0.5 * before[i] + 0.25 * upper;
        }
    }
    density
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts of a face, brown hair and a body of one colour, each in ten brightnesses.
    fn tally(body: [u8; 3]) -> Tally {
        let mut tally = Tally::new();
        for (color, part) in [([210, 160, 130], Plain::Face), ([90, 70, 50], Plain::Hair), (body, Plain::Body)] {
            for step in 0..1000u32 {
                let shade = 0.7 + 0.03 * (step % 10) as f32;
                tally.add(color.map(|value: u8| (f32::from(value) * shade) as u8), part);
            }
        }
        tally
    }

    #[test]
    fn a_shirt_is_told_from_skin_and_hair_and_bare_shoulders_are_not() {
        let worn = |body: [u8; 3], pixel: [u8; 3]| {
            let image = Rgb8Image::filled(1, 1, pixel);
            tally(body).clothes().map(|clothes| clothes.worn(&image, &[true])[0])
        };
        for shirt in [[110, 115, 125], [20, 60, 160], [240, 240, 240]] {
            assert_eq!(worn(shirt, shirt.map(|value: u8| (f32::from(value) * 0.85) as u8)), Some(1.0), "{shirt:?}");
            for own in [[180, 135, 110], [120, 91, 74], [75, 58, 42]] {
                assert_eq!(worn(shirt, own), Some(0.0), "{own:?} over {shirt:?}");
            }
        }
        assert_eq!(worn([210, 160, 130], [180, 135, 110]), Some(0.0));
        assert_eq!(worn([20, 60, 160], [20, 160, 20]), Some(0.0), "a colour that was never seen");
        assert!(Tally::new().clothes().is_none());
    }

    #[test]
    fn clothes_lie_only_where_they_may() {
        let shirt = [20, 60, 160];
        let image = Rgb8Image::filled(2, 1, shirt);
        let worn = tally(shirt).clothes().map(|clothes| clothes.worn(&image, &[true, false]));
        assert_eq!(worn, Some(vec![1.0, 0.0]));
        let extremes = [[0; 3], [255; 3], [255, 0, 0], [0, 0, 255], [0, 255, 0]];
        let clothes = tally(shirt).clothes();
        assert!(extremes.iter().all(|pixel| clothes.as_ref().is_some_and(|c| (0.0..=1.0).contains(&c.of(*pixel)))));
    }
}
