//! Colours at a soft edge, freed of the background.
//!
//! Near the matte's edge a pixel mixes head and background, and the matte never says the share exactly. So the colour
//! there is not unmixed but replaced by the mean of the head's sure inside nearby; the inside itself stays as it is.

use heartian_space::Rgb8Image;

use super::guided::box_mean;
use super::smoothstep;

/// Replaces the colours within about two pixels (at 256×256) of the edge, and of all soft pixels.
pub(super) fn replace_background(image: &mut Rgb8Image, alpha: &[f32], scale: f32) {
    let size = image.width;
    let radius = |pixels: f32| ((pixels * scale).round() as usize).max(1);
    let around = box_mean(alpha, size, radius(2.0));
    let sure: Vec<f32> = around.iter().map(|mean| smoothstep(0.75, 1.0, *mean)).collect();
    // Inside means over a near window, and over a wide one for wisps far from the inside.
    let windows = [4.0, 16.0].map(radius);
    let weights = windows.map(|radius| box_mean(&sure, size, radius));
    for channel in 0..3 {
        let plane: Vec<f32> = image.data.iter().skip(channel).step_by(3).map(|v| f32::from(*v)).collect();
        let weighted: Vec<f32> = plane.iter().zip(&sure).map(|(value, sure)| value * sure).collect();
        let sums = windows.map(|radius| box_mean(&weighted, size, radius));
        for i in 0..plane.len() {
            if alpha[i] <= 0.0 || sure[i] >= 1.0 {
                continue;
            }
            let Some(window) = (0..windows.len()).find(|k| weights[*k][i] > 0.02) else { continue };
            let inside = sums[window][i] / weights[window][i];
            image.data[3 * i + channel] = (inside + sure[i] * (plane[i] - inside) + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
