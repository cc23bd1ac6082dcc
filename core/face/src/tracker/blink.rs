//! Blinks, read off the distance between the lids over time.
//!
//! Landmark networks learnt on open eyes keep the lids apart in a blink: a closed eye is seen at a half or a third of the
//! way. What they do show is that the distance falls and rises within half a second, so a blink is told by its shape in
//! time, and how far it closes by the clip's own blinks. Eyes that stay shut are told by a fall and a rise as sudden as a
//! blink's with nothing but low distances between; a squint comes and goes slowly. Distances are in widths of the eye.

use super::frame::Seen;
use super::points::Points;

/// Upper and lower landmarks of both eyes, and the corners of each.
const EYES: [([[u32; 2]; 3], [u32; 2]); 2] =
    [([[159, 145], [158, 153], [160, 144]], [33, 133]), ([[386, 374], [385, 380], [387, 373]], [263, 362])];
/// Around a frame, the time whose upper quartile is the open eye.
const AROUND_SECONDS: f64 = 1.0;
/// A dip below the open eye by this share begins to be a blink, and becomes one by the second.
const DIP: [f64; 2] = [0.12, 0.25];
/// A blink is over after this long; longer is a squint, which the landmarks show by themselves.
const LONGEST_SECONDS: f64 = 0.5;
/// A fall or rise by the second share of [`DIP`] within this time is sudden; eyes stay shut no longer than the second.
const SUDDEN_SECONDS: f64 = 0.1;
const LONGEST_SHUT_SECONDS: f64 = 6.0;
/// At least so many blinks say how far a closed eye is seen closed; fewer are taken for whole when they look nearly so.
const ENOUGH_BLINKS: usize = 3;
/// What is taken for closed without them, as a share of the open eye.
const CLOSED: f64 = 0.25;

/// How far the lids are closed in every frame that is part of a blink, in [0, 1]; `None` elsewhere.
pub fn closures(points: &Points, frames: &[Seen], times: &[f64]) -> Vec<Option<f64>> {
    let aspects: Vec<Option<f64>> = frames.iter().map(|seen| aspect(points, seen)).collect();
    let open: Vec<Option<f64>> = (0..frames.len()).map(|t| open_near(&aspects, times, t)).collect();
    // How much is left of the open eye.
    let left: Vec<f64> = aspects
        .iter()
        .zip(&open)
        .map(|pair| if let (Some(now), Some(open)) = pair { now / open.max(1e-6) } else { 1.0 })
        .collect();
    let blinks = blinks(&left, times);
    let mut depths: Vec<f64> =
        blinks.iter().map(|blink| left[blink.clone()].iter().copied().fold(1.0, f64::min)).collect();
    depths.sort_by(f64::total_cmp);
    let typical = depths.get(depths.len() / 2).copied().unwrap_or(CLOSED);
    let closed = if depths.len() >= ENOUGH_BLINKS { typical } else { typical.min(CLOSED) };
    let mut closures = vec![None; frames.len()];
    for t in blinks.into_iter().flatten() {
        closures[t] = Some(((1.0 - left[t]) / (1.0 - closed)).clamp(0.0, 1.0));
    }
    for (run, [before, after]) in shut(&aspects, times) {
        for t in run.clone() {
            let share = (t - run.start) as f64 / run.len() as f64;
            let open = before + share * (after - before);
            let closure = aspects[t].map(|now| ((1.0 - now / open) / (1.0 - closed)).clamp(0.0, 1.0));
            closures[t] = closure.map(|closure| closures[t].map_or(closure, |blink| closure.max(blink)));
        }
    }
    closures
}

/// Runs of frames longer than a blink between a sudden fall and a sudden rise, and the distances before and after them.
fn shut(aspects: &[Option<f64>], times: &[f64]) -> Vec<(std::ops::Range<usize>, [f64; 2])> {
    let low = |now: f64, open: f64| now < (1.0 - DIP[1]) * open;
    // The frame of the lately open eye from which a frame is a sudden change, seen towards either side.
    let open_from = |t: usize, back: bool| -> Option<f64> {
        let near = |s: &usize| (times[*s] - times[t]).abs() <= SUDDEN_SECONDS;
        let around: Vec<usize> = if back {
            (0..t).rev().take_while(near).collect()
        } else {
            (t + 1..times.len()).take_while(near).collect()
        };
        around.into_iter().filter_map(|s| aspects[s]).find(|open| aspects[t].is_some_and(|now| low(now, *open)))
    };
    let mut found: Vec<(std::ops::Range<usize>, [f64; 2])> = Vec::new();
    let mut t = 0;
    while t < aspects.len() {
        let from = t;
        t += 1;
        let Some(before) = open_from(from, true) else { continue };
        let stays = |s: &usize| {
            aspects[*s].is_some_and(|now| low(now, before)) && times[*s] - times[from] <= LONGEST_SHUT_SECONDS
        };
        let end = (from..aspects.len()).take_while(stays).last().unwrap_or(from);
        let long = times[end] - times[from] > LONGEST_SECONDS;
        if let (true, Some(after)) = (long, open_from(end, false)) {
            found.push((from..end + 1, [before, after]));
            t = end + 1;
        }
    }
    found
}

/// Mean distance of the lids over the eyes' widths; `None` unless every landmark of one eye is seen.
fn aspect(points: &Points, seen: &Seen) -> Option<f64> {
    let at = |index: u32| {
        let point = points.indices.binary_search(&index).ok()?;
        seen.points.binary_search(&point).ok().map(|k| seen.pixels[k])
    };
    let eye = |(pairs, [outer, inner]): &([[u32; 2]; 3], [u32; 2])| -> Option<f64> {
        let width = at(*outer)?.distance(at(*inner)?);
        let heights: Option<Vec<f64>> = pairs.iter().map(|[a, b]| Some(at(*a)?.distance(at(*b)?))).collect();
        (width > 0.0).then_some(heights?.iter().sum::<f64>() / (3.0 * width))
    };
    let both: Vec<f64> = EYES.iter().filter_map(eye).collect();
    (!both.is_empty()).then(|| both.iter().sum::<f64>() / both.len() as f64)
}

fn open_near(aspects: &[Option<f64>], times: &[f64], t: usize) -> Option<f64> {
    let from = times.partition_point(|time| *time < times[t] - AROUND_SECONDS);
    let to = times.partition_point(|time| *time <= times[t] + AROUND_SECONDS);
    let mut values: Vec<f64> = aspects[from..to].iter().flatten().copied().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() * 3 / 4).copied()
}

/// Runs of frames below the first threshold that reach the second and end soon.
fn blinks(left: &[f64], times: &[f64]) -> Vec<std::ops::Range<usize>> {
    let mut found = Vec::new();
    let mut from = 0;
    while from < left.len() {
        let low = |value: &f64| *value < 1.0 - DIP[0];
        let length = left[from..].iter().take_while(|value| low(value)).count();
        let run = from..from + length;
        let deep = left[run.clone()].iter().any(|value| *value < 1.0 - DIP[1]);
        if deep && times[run.end - 1] - times[run.start] <= LONGEST_SECONDS {
            found.push(run);
        }
        from += length + 1;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HeadModel;
    use glam::DVec2;

    /// Frames of eyes alone that many of their widths open.
    fn frames(points: &Points, openings: &[f64]) -> Vec<Seen> {
        let frame = |opening: &f64| {
            let mut places: Vec<(usize, DVec2)> = Vec::new();
            for (pairs, [outer, inner]) in EYES {
                let mut put = |index: u32, x: f64, y: f64| {
                    if let Ok(point) = points.indices.binary_search(&index) {
                        places.push((point, DVec2::new(x, y)));
                    }
                };
                put(outer, 0.0, 0.0);
                put(inner, 20.0, 0.0);
                for [upper, lower] in pairs {
                    put(upper, 10.0, -10.0 * opening);
                    put(lower, 10.0, 10.0 * opening);
                }
            }
            places.sort_by_key(|place| place.0);
            let (points, pixels): (Vec<usize>, Vec<DVec2>) = places.into_iter().unzip();
            Seen { weights: vec![1.0; points.len()], points, pixels, closure: None }
        };
        openings.iter().map(frame).collect()
    }

    #[test]
    fn eyes_that_stay_shut_are_shut_and_narrowed_ones_are_not() {
        let points = Points::new(&HeadModel::procedural());
        let mut openings = vec![0.31; 200];
        for blink in [10, 25, 40] {
            openings[blink] = 0.19;
        }
        openings[60..110].fill(0.21);
        // Narrowed over half a second, and back.
        (0..12).for_each(|k| openings[130 + k] = 0.31 - 0.008 * k as f64);
        openings[142..170].fill(0.214);
        (0..12).for_each(|k| openings[170 + k] = 0.214 + 0.008 * k as f64);
        let times: Vec<f64> = (0..200).map(|t| f64::from(t) / 25.0).collect();
        let found = closures(&points, &frames(&points, &openings), &times);
        assert!((60..110).all(|t| found[t].is_some_and(|closure| closure > 0.75)), "{:?}", &found[55..115]);
        assert!((115..200).all(|t| found[t].is_none()), "{:?}", &found[115..]);
    }

    #[test]
    fn half_seen_blinks_are_whole_and_a_squint_is_none() {
        let points = Points::new(&HeadModel::procedural());
        let mut openings = vec![0.33; 200];
        for blink in [30, 80, 130] {
            openings[blink] = 0.26;
            openings[blink + 1] = 0.18;
            openings[blink + 2] = 0.27;
        }
        openings[150..185].fill(0.26);
        let times: Vec<f64> = (0..200).map(|t| f64::from(t) / 25.0).collect();
        let found = closures(&points, &frames(&points, &openings), &times);
        for blink in [30, 80, 130] {
            assert!(found[blink + 1].is_some_and(|closure| closure > 0.95), "{:?}", &found[blink - 1..blink + 4]);
            assert!(found[blink].is_some_and(|closure| (0.3..0.6).contains(&closure)));
        }
        assert_eq!(found.iter().flatten().count(), 9, "nothing but blinks");
        let blind = vec![Seen::default(); 3];
        assert_eq!(closures(&points, &blind, &times[..3]), [None; 3]);
    }
}
