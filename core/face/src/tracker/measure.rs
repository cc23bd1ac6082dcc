//! How far fitted landmarks lie from those seen.

use super::frame::{Seen, Setting, State};
use super::points::{OVAL, rotation};

/// Of a whole clip, pixels.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Root mean square over all observed landmarks but the oval's.
    pub rms_px: f64,
    /// Mean distance of the outer eye corners as projected; 0 for a head without those landmarks.
    pub interocular_px: f64,
}

/// Measures a clip.
pub fn errors(setting: &Setting, frames: &[Seen], states: &[State]) -> Errors {
    let sums = frames.iter().zip(states).map(|(seen, state)| squares(setting, seen, state));
    let (sum, count) = sums.fold((0.0, 0u64), |total, own| (total.0 + own.0, total.1 + own.1));
    Errors { rms_px: (sum / count.max(1) as f64).sqrt(), interocular_px: interocular_px(setting, states) }
}

fn interocular_px(setting: &Setting, states: &[State]) -> f64 {
    let corner = |index: u32| setting.points.indices.binary_search(&index).ok();
    let (Some(right), Some(left)) = (corner(33), corner(263)) else { return 0.0 };
    let distances: Vec<f64> = states
        .iter()
        .filter_map(|state| {
            let jaw = rotation(state.jaw);
            Some(state.project(setting, right, &jaw)?.distance(state.project(setting, left, &jaw)?))
        })
        .collect();
    distances.iter().sum::<f64>() / distances.len().max(1) as f64
}

/// Sum and number of the squared distances of observed and fitted landmarks, without the oval's.
fn squares(setting: &Setting, seen: &Seen, state: &State) -> (f64, u64) {
    let jaw = rotation(state.jaw);
    let counted = |point: &usize| !OVAL.contains(&setting.points.indices[*point]);
    let pairs = seen.points.iter().zip(&seen.pixels).filter(|(point, _)| counted(point));
    pairs.fold((0.0, 0), |(sum, count), (point, pixel)| match state.project(setting, *point, &jaw) {
        Some(fit) => (sum + (fit - *pixel).length_squared(), count + 1),
        None => (sum, count),
    })
}

/// Root mean square distance of a frame's landmarks; `None` for a frame without.
pub fn rms_px(setting: &Setting, seen: &Seen, state: &State) -> Option<f64> {
    let (sum, count) = squares(setting, seen, state);
    (count > 0).then(|| (sum / count as f64).sqrt())
}
