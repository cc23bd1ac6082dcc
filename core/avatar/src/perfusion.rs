//! Where and when blood arrives in the face: named regions, or a picture drawn by hand.
//!
//! The map is a frontal one over the selected skin: positions are `Skin::positions`, x toward the subject's left and y up,
//! each in [−1, 1]. A picture covers that square as one sees the face: its left edge is x = −1, its top y = 1. Red is
//! strength (128 as everywhere, 255 twice that, 0 none), green is delay (0 none, 255 the largest).
//!
//! Strengths are divided by their mean and delays are taken from theirs: the mean over the skin, which is what is
//! supervised and read (paper, c̄), keeps its strength and its moment.

use heartian_space::{Perfusion, Rgb8Image};

use crate::AvatarError;

/// A perfusion map.
#[derive(Clone, Copy, Debug)]
pub enum PerfusionMap<'a> {
    /// The same everywhere.
    Even,
    /// Forehead and cheeks strong, nose and chin weaker; delay grows away from where the facial arteries cross the jaw.
    Facial,
    /// Red: strength, green: delay.
    Picture(&'a Rgb8Image),
}

/// A named region: centre and half-width (x mirrored), and strength. Camera PPG is strongest on forehead and cheeks and
/// weakest on nose and chin in every survey of facial regions; the figures here are round ones of that order.
struct Place {
    centre: [f32; 2],
    half: [f32; 2],
    strength: f32,
}

const PLACES: [Place; 5] = [
    Place { centre: [0.0, 0.75], half: [0.75, 0.30], strength: 1.3 },
    Place { centre: [0.55, -0.15], half: [0.30, 0.30], strength: 1.25 },
    Place { centre: [0.0, 0.05], half: [0.18, 0.35], strength: 0.6 },
    Place { centre: [0.0, -0.85], half: [0.35, 0.20], strength: 0.6 },
    Place { centre: [0.75, -0.75], half: [0.30, 0.30], strength: 0.9 },
];
/// Strength where no named region reaches, and its weight beside them.
const ELSEWHERE: (f32, f32) = (0.9, 0.05);
/// Where the facial arteries come over the jaw, mirrored in x.
const INLET: [f32; 2] = [0.75, -0.95];

/// Strength and delay of each Gaussian at `positions`; `most_delay_seconds` is the largest difference in arrival.
///
/// # Errors
/// When the delay is out of range, the picture is empty, or it leaves every Gaussian without a pulse.
pub fn perfusion(
    map: PerfusionMap<'_>,
    positions: &[[f32; 3]],
    most_delay_seconds: f32,
) -> Result<Perfusion, AvatarError> {
    if !(0.0..=0.5).contains(&most_delay_seconds) {
        let value = f64::from(most_delay_seconds);
        return Err(AvatarError::Option { name: "most_delay_seconds", value, range: "0 to 0.5 s" });
    }
    let (mut strength, delay): (Vec<f32>, Vec<f32>) = match map {
        PerfusionMap::Even => return Ok(Perfusion::default()),
        PerfusionMap::Facial => positions.iter().map(|p| (facial_strength(*p), facial_delay(*p))).unzip(),
        PerfusionMap::Picture(image) => {
            if image.width == 0 || image.height == 0 {
                let remedy = "draw strength in red and delay in green";
                return Err(AvatarError::TooLittle { what: "the perfusion picture is empty", found: 0, remedy });
            }
            positions.iter().map(|p| (sample(image, *p, 0) / 128.0, sample(image, *p, 1) / 255.0)).unzip()
        }
    };
    let mean = |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64;
    let middle = mean(&strength);
    if middle < 1e-3 {
        let remedy = "the red of the perfusion picture is its strength; 128 is the usual one";
        return Err(AvatarError::TooLittle { what: "the perfusion map leaves no pulse", found: 0, remedy });
    }
    strength.iter_mut().for_each(|value| *value /= middle as f32);
    let centre = mean(&delay) as f32;
    let delay_seconds = delay.iter().map(|value| most_delay_seconds * (value - centre)).collect();
    Ok(Perfusion { strength, delay_seconds })
}

fn facial_strength([x, y, _]: [f32; 3]) -> f32 {
    let (mut sum, mut total) = (ELSEWHERE.0 * ELSEWHERE.1, ELSEWHERE.1);
    for place in &PLACES {
        let (dx, dy) = ((x.abs() - place.centre[0]) / place.half[0], (y - place.centre[1]) / place.half[1]);
        let weight = (-(dx * dx + dy * dy)).exp();
        sum += weight * place.strength;
        total += weight;
    }
    sum / total
}

/// Distance from the inlet along the frontal map, 1 at the top of the forehead's middle.
fn facial_delay([x, y, _]: [f32; 3]) -> f32 {
    let far = INLET[0].hypot(1.0 - INLET[1]);
    ((x.abs() - INLET[0]).hypot(y - INLET[1]) / far).min(1.0)
}

/// Bilinear value of a channel, 0–255.
fn sample(image: &Rgb8Image, [x, y, _]: [f32; 3], channel: usize) -> f32 {
    let at = |unit: f32, count: usize| (unit.clamp(0.0, 1.0) * count as f32 - 0.5).clamp(0.0, (count - 1) as f32);
    let (column, row) = (at(0.5 * (x + 1.0), image.width), at(0.5 * (1.0 - y), image.height));
    let (left, top) = (column as usize, row as usize);
    let (fx, fy) = (column - left as f32, row - top as f32);
    let pixel = |dx: usize, dy: usize| {
        let (column, row) = ((left + dx).min(image.width - 1), (top + dy).min(image.height - 1));
        f32::from(image.data[3 * (row * image.width + column) + channel])
    };
    let line = |dy: usize| pixel(0, dy) + fx * (pixel(1, dy) - pixel(0, dy));
    line(0) + fy * (line(1) - line(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Vec<[f32; 3]> {
        (0..400).map(|k| [(k % 20) as f32 / 9.5 - 1.0, (k / 20) as f32 / 9.5 - 1.0, 0.0]).collect()
    }

    fn at(map: &Perfusion, positions: &[[f32; 3]], place: [f32; 2]) -> (f32, f32) {
        let far = |p: &[f32; 3]| (p[0] - place[0]).hypot(p[1] - place[1]);
        let nearest = (0..positions.len()).min_by(|&a, &b| far(&positions[a]).total_cmp(&far(&positions[b])));
        nearest.map_or((0.0, 0.0), |k| (map.strength[k], map.delay_seconds[k]))
    }

    #[test]
    fn the_face_pulses_on_forehead_and_cheeks_and_later_upward() -> Result<(), AvatarError> {
        let positions = grid();
        let map = perfusion(PerfusionMap::Facial, &positions, 0.06)?;
        let [forehead, cheek, nose, chin, jaw] =
            [[0.0, 0.8], [0.55, -0.1], [0.0, 0.05], [0.0, -0.9], [0.75, -0.95]].map(|p| at(&map, &positions, p));
        assert!(forehead.0 > 1.4 * nose.0 && cheek.0 > 1.4 * chin.0, "{forehead:?} {cheek:?} {nose:?} {chin:?}");
        assert!(forehead.1 - jaw.1 > 0.04 && cheek.1 > jaw.1 && nose.1 < forehead.1);
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        assert!((mean(&map.strength) - 1.0).abs() < 1e-4 && mean(&map.delay_seconds).abs() < 1e-6);
        assert!(perfusion(PerfusionMap::Even, &positions, 0.06)?.is_even());
        Ok(())
    }

    #[test]
    fn a_picture_is_read_as_one_sees_the_face() -> Result<(), AvatarError> {
        // Strong on the picture's left, late at its bottom.
        let mut image = Rgb8Image::filled(2, 2, [64, 0, 0]);
        image.data = vec![192, 0, 0, 64, 0, 0, 192, 255, 0, 64, 255, 0];
        let positions = grid();
        let map = perfusion(PerfusionMap::Picture(&image), &positions, 0.1)?;
        let [left_top, right_bottom] = [[-1.0, 1.0], [1.0, -1.0]].map(|p| at(&map, &positions, p));
        assert!((left_top.0 / right_bottom.0 - 3.0).abs() < 1e-4, "{left_top:?} {right_bottom:?}");
        assert!((right_bottom.1 - left_top.1 - 0.1).abs() < 1e-4);
        Ok(())
    }

    #[test]
    fn maps_without_a_pulse_and_delays_out_of_range_are_refused() {
        let positions = grid();
        let black = Rgb8Image::filled(3, 3, [0; 3]);
        assert!(matches!(
            perfusion(PerfusionMap::Picture(&black), &positions, 0.0),
            Err(AvatarError::TooLittle { .. })
        ));
        let none = Rgb8Image::filled(0, 0, [0; 3]);
        assert!(perfusion(PerfusionMap::Picture(&none), &positions, 0.0).is_err());
        for delay in [-0.1, 3.0, f32::NAN] {
            assert!(matches!(perfusion(PerfusionMap::Facial, &positions, delay), Err(AvatarError::Option { .. })));
        }
    }
}
