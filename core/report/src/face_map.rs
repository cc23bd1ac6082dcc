//! Values over the face, seen from the front: a dot a Gaussian, dark violet for the least to pale yellow for the most.

use heartian_space::Rgb8Image;
use plotters::style::RGBColor;

use crate::ReportError;
use crate::canvas::{draw_on, write_text};

const PANEL_PX: usize = 320;
const LABEL_PX: usize = 44;
const PAPER: [u8; 3] = [24, 24, 26];
const INK: RGBColor = RGBColor(235, 235, 235);
const DOT_PX: i32 = 3;
/// Shares of the values beyond which colours no longer change.
const ENDS: [f64; 2] = [0.02, 0.98];

/// One panel of a map: what it shows, in which unit, one value a position.
#[derive(Clone, Copy, Debug)]
pub struct FaceMap<'a> {
    /// What is shown.
    pub title: &'a str,
    /// Unit of the values, as written after the scale.
    pub unit: &'a str,
    /// One value a position; those that are not finite are left out.
    pub values: &'a [f64],
}

/// Panels side by side; positions have x toward the subject's left and y up, each in [−1, 1].
///
/// # Errors
/// When there is no panel or position, or a panel has not a value a position.
pub fn face_maps(positions: &[[f32; 3]], maps: &[FaceMap<'_>]) -> Result<Rgb8Image, ReportError> {
    if maps.is_empty() || positions.is_empty() || maps.iter().any(|map| map.values.len() != positions.len()) {
        return Err(ReportError::Nothing("face map with a value a position"));
    }
    let mut image = Rgb8Image::filled(maps.len() * PANEL_PX, PANEL_PX + LABEL_PX, PAPER);
    let scales: Vec<[f64; 2]> = maps.iter().map(|map| scale(map.values)).collect();
    // Nearer Gaussians over farther ones.
    let mut order: Vec<usize> = (0..positions.len()).collect();
    order.sort_by(|&a, &b| positions[a][2].total_cmp(&positions[b][2]).then(a.cmp(&b)));
    for (panel, (map, [low, high])) in maps.iter().zip(&scales).enumerate() {
        for &k in order.iter().filter(|&&k| map.values[k].is_finite()) {
            let unit = ((map.values[k] - low) / (high - low).max(1e-12)).clamp(0.0, 1.0);
            dot(&mut image, panel * PANEL_PX, positions[k], heat(unit));
        }
    }
    draw_on(&mut image, |area| {
        maps.iter().zip(&scales).enumerate().try_for_each(|(panel, (map, [low, high]))| {
            let left = (panel * PANEL_PX) as i32 + 8;
            write_text(area, map.title, (left, 4), (17, INK))?;
            write_text(area, &format!("{low:.3} to {high:.3} {}", map.unit), (left, 24), (14, INK))
        })
    })?;
    Ok(image)
}

/// The range that is drawn.
fn scale(values: &[f64]) -> [f64; 2] {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted.get((share * sorted.len().saturating_sub(1) as f64) as usize).copied();
    ENDS.map(|share| at(share).unwrap_or(0.0))
}

fn dot(image: &mut Rgb8Image, left: usize, [x, y, _]: [f32; 3], color: [u8; 3]) {
    let half = 0.46 * PANEL_PX as f32;
    let at = |unit: f32| (0.5 * PANEL_PX as f32 + half * unit) as i32;
    let (column, row) = (at(x.clamp(-1.0, 1.0)), at(-y.clamp(-1.0, 1.0)) + LABEL_PX as i32);
    for dy in -DOT_PX..=DOT_PX {
        for dx in -DOT_PX..=DOT_PX {
            let (px, py) = (column + dx, row + dy);
            let inside = dx * dx + dy * dy <= DOT_PX * DOT_PX && (0..PANEL_PX as i32).contains(&px);
            if inside && (LABEL_PX as i32..image.height as i32).contains(&py) {
                let pixel = 3 * (py as usize * image.width + left + px as usize);
                image.data[pixel..pixel + 3].copy_from_slice(&color);
            }
        }
    }
}

/// Dark violet over red and orange to pale yellow.
fn heat(unit: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] =
        [[40.0, 11.0, 84.0], [120.0, 28.0, 109.0], [207.0, 68.0, 70.0], [246.0, 140.0, 32.0], [252.0, 250.0, 170.0]];
    let at = unit * (STOPS.len() - 1) as f64;
    let (below, rest) = ((at as usize).min(STOPS.len() - 2), at - (at as usize).min(STOPS.len() - 2) as f64);
    std::array::from_fn(|c| (STOPS[below][c] + rest * (STOPS[below + 1][c] - STOPS[below][c])) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_shows_where_values_are_high_and_refuses_what_does_not_fit() -> Result<(), ReportError> {
        let positions: Vec<[f32; 3]> =
            (0..3600).map(|k| [(k % 60) as f32 / 30.0 - 0.98, (k / 60) as f32 / 30.0 - 0.98, 0.0]).collect();
        let values: Vec<f64> = positions.iter().map(|p| f64::from(p[1])).collect();
        let map = FaceMap { title: "height", unit: "", values: &values };
        let image = face_maps(&positions, &[map, map])?;
        let bright = |row: usize| u32::from(image.data[3 * (row * image.width + PANEL_PX / 2) + 1]);
        assert!(bright(LABEL_PX + 20) > bright(LABEL_PX + PANEL_PX / 2) + 20);
        assert!(bright(LABEL_PX + PANEL_PX / 2) > bright(LABEL_PX + PANEL_PX - 20) + 20);
        assert!(face_maps(&positions, &[]).is_err());
        assert!(face_maps(&positions, &[FaceMap { values: &values[1..], ..map }]).is_err());
        assert!(face_maps(&positions, &[FaceMap { values: &vec![f64::NAN; 3600], ..map }]).is_ok());
        Ok(())
    }
}
