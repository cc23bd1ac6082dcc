//! Colours at a soft edge, freed of the background.
//!
//! Near the matte's edge a pixel mixes head and background, and the matte never says the share exactly. So what is there
//! is not unmixed but replaced by the mean of the head's sure inside nearby; the inside itself stays as it is. Video keeps
//! colour at half the resolution of brightness, so the background's colour reaches further in than its light.

use heartian_space::Rgb8Image;

use super::guided::box_mean;
use super::smoothstep;

/// How far the background reaches in, and over what the inside is averaged there (and where there is none, for wisps far
/// from the inside), pixels at 256×256: brightness, then colour.
const BRIGHTNESS: [f32; 3] = [2.0, 4.0, 16.0];
const COLOR: [f32; 3] = [4.0, 6.0, 16.0];

/// Replaces brightness and colour within about two and four pixels (at 256×256) of the edge, and of all soft pixels.
pub(super) fn replace_background(image: &mut Rgb8Image, alpha: &[f32], scale: f32) {
    let size = image.width;
    let pixels = image.data.as_chunks::<3>().0;
    let luma: Vec<f32> =
        pixels.iter().map(|[r, g, b]| 0.299 * f32::from(*r) + 0.587 * f32::from(*g) + 0.114 * f32::from(*b)).collect();
    let [bright, color] = [BRIGHTNESS, COLOR].map(|reach| Edge::new(alpha, size, reach.map(|pixels| pixels * scale)));
    let bright = bright.cleaned(&luma, alpha);
    for channel in 0..3 {
        let plane = image.data.iter().skip(channel).step_by(3);
        let difference: Vec<f32> = plane.zip(&luma).map(|(value, luma)| f32::from(*value) - luma).collect();
        let cleaned = color.cleaned(&difference, alpha);
        for i in (0..alpha.len()).filter(|i| alpha[*i] > 0.0 && color.sure[*i] < 1.0) {
            image.data[3 * i + channel] = (bright[i] + cleaned[i] + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

/// Where the inside is sure.
struct Edge {
    size: usize,
    sure: Vec<f32>,
    windows: [usize; 2],
    /// How much of the inside each window holds.
    weights: [Vec<f32>; 2],
}

impl Edge {
    fn new(alpha: &[f32], size: usize, reach: [f32; 3]) -> Self {
        let [reach, near, far] = reach.map(|pixels| (pixels.round() as usize).max(1));
        let sure: Vec<f32> = box_mean(alpha, size, reach).iter().map(|mean| smoothstep(0.75, 1.0, *mean)).collect();
        let weights = [near, far].map(|radius| box_mean(&sure, size, radius));
        Self { size, sure, windows: [near, far], weights }
    }

    /// The plane with the inside's mean where the head is soft or near its edge.
    fn cleaned(&self, plane: &[f32], alpha: &[f32]) -> Vec<f32> {
        let weighted: Vec<f32> = plane.iter().zip(&self.sure).map(|(value, sure)| value * sure).collect();
        let sums = self.windows.map(|radius| box_mean(&weighted, self.size, radius));
        let clean = |i: usize| {
            let window = (0..2).find(|k| self.weights[*k][i] > 0.02);
            let Some(window) = window.filter(|_| alpha[i] > 0.0 && self.sure[i] < 1.0) else { return plane[i] };
            let inside = sums[window][i] / self.weights[window][i];
            inside + self.sure[i] * (plane[i] - inside)
        };
        (0..plane.len()).map(clean).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_that_bled_in_goes() {
        let size = 64;
        let alpha: Vec<f32> = (0..size * size).map(|i| if i % size < 32 { 1.0 } else { 0.0 }).collect();
        let mut image = Rgb8Image::filled(size, size, [20, 40, 220]);
        // Brown hair, blue by two pixels at its edge.
        for (i, _) in alpha.iter().enumerate().filter(|(_, alpha)| **alpha > 0.0) {
            let hair = if i % size < 30 { [90, 70, 50] } else { [60, 68, 120] };
            image.set_pixel(i % size, i / size, hair);
        }
        replace_background(&mut image, &alpha, 1.0);
        for x in 20..32 {
            let [r, _, b] = image.pixel(x, 30);
            assert!(r > b + 20, "column {x}: {:?}", image.pixel(x, 30));
        }
        assert_eq!(image.pixel(33, 30), [20, 40, 220], "the background stays");
    }

    #[test]
    fn a_mixed_edge_gets_its_foreground_back_and_the_inside_stays() {
        let size = 64;
        let (skin, wall) = ([200.0, 150.0, 120.0], [20.0, 40.0, 220.0]);
        let alpha: Vec<f32> =
            (0..size * size).map(|i| (1.0 - ((i % size) as f32 - 30.0) / 4.0).clamp(0.0, 1.0)).collect();
        let mut image = Rgb8Image::filled(size, size, [0; 3]);
        for (i, a) in alpha.iter().enumerate() {
            let mixed = std::array::from_fn(|c| (a * skin[c] + (1.0 - a) * wall[c]).round() as u8);
            image.set_pixel(i % size, i / size, mixed);
        }
        let before = image.clone();
        replace_background(&mut image, &alpha, 1.0);
        (0..26).for_each(|x| assert_eq!(image.pixel(x, 30), before.pixel(x, 30), "column {x} is inside"));
        (40..64).for_each(|x| assert_eq!(image.pixel(x, 30), before.pixel(x, 30), "column {x} is background"));
        for x in 26..34 {
            let pixel = image.pixel(x, 30);
            let off: f32 = (0..3).map(|c| (f32::from(pixel[c]) - skin[c]).abs()).fold(0.0, f32::max);
            assert!(off < 10.0, "column {x}: {pixel:?}");
        }
    }
}
