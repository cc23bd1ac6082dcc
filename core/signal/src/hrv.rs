//! Heart-rate variability from the times of beats: SDNN, RMSSD, pNN50 and the power of its slow and respiratory bands
//! (Task Force of the ESC and NASPE, Circulation 93, 1996).
//!
//! Only intervals between plainly seen beats count, and those that depart by more than 30 % from the median of the eight
//! around them are taken as ectopic or missed and left out with their neighbours (normal-to-normal intervals). Bands: LF 0.04–0.15 Hz, HF
//! 0.15–0.40 Hz, of the intervals freed of their line, under a Hann window.

use crate::error::{Result, SignalError, check_times};
use crate::stats::{mean, median};

/// Low-frequency band, hertz.
pub const LF_HERTZ: [f64; 2] = [0.04, 0.15];
/// High-frequency (respiratory) band, hertz.
pub const HF_HERTZ: [f64; 2] = [0.15, 0.40];
/// Departure from the local median beyond which an interval is not normal, and intervals on either side that make it.
const MOST_DEPARTURE: f64 = 0.3;
const AROUND: usize = 4;
/// Shortest stretch that holds two periods of the slowest variation of LF, seconds.
const LEAST_SECONDS: f64 = 50.0;

/// Variability of the intervals between normal beats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variability {
    /// Normal intervals that count.
    pub intervals: usize,
    /// Intervals left out.
    pub left_out: usize,
    /// Their mean, milliseconds.
    pub mean_ms: f64,
    /// Standard deviation (n − 1), milliseconds.
    pub sdnn_ms: f64,
    /// Root mean square of successive differences, milliseconds; NaN when no two follow one another.
    pub rmssd_ms: f64,
    /// Share of successive differences above 50 ms, %; NaN likewise.
    pub pnn50_percent: f64,
    /// Power of the two bands, ms²; `None` for recordings under 50 s, which do not hold two periods of the slowest.
    pub bands: Option<Bands>,
}

/// Power of the slow and of the respiratory variation, ms².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bands {
    /// 0.04–0.15 Hz.
    pub lf_ms2: f64,
    /// 0.15–0.40 Hz.
    pub hf_ms2: f64,
}

impl Bands {
    /// LF over HF; infinite when HF holds nothing.
    pub fn ratio(&self) -> f64 {
        self.lf_ms2 / self.hf_ms2
    }
}

/// Variability of beats at increasing times; `observed` says of each whether it was plainly seen.
///
/// # Errors
/// When times do not increase, lists differ in length, or fewer than two normal intervals are left.
pub fn variability(beats_seconds: &[f64], observed: &[bool]) -> Result<Variability> {
    check_times("the beat times", beats_seconds)?;
    if observed.len() != beats_seconds.len() {
        let (expected, found) = (beats_seconds.len(), observed.len());
        return Err(SignalError::Length { what: "the list of observed beats", expected, found });
    }
    let rr: Vec<f64> = beats_seconds.windows(2).map(|pair| 1000.0 * (pair[1] - pair[0])).collect();
    let plain: Vec<bool> = (0..rr.len()).map(|k| observed[k] && observed[k + 1] && is_normal(&rr, k)).collect();
    // What stands beside an odd interval is bent by it, too.
    let normal: Vec<bool> =
        (0..rr.len()).map(|k| plain[k.saturating_sub(1)..(k + 2).min(rr.len())].iter().all(|plain| *plain)).collect();
    let kept: Vec<f64> = rr.iter().zip(&normal).filter(|(_, normal)| **normal).map(|(rr, _)| *rr).collect();
    if kept.len() < 2 {
        return Err(SignalError::FewBeats { found: kept.len() + 1, needed: 3 });
    }
    let centre = mean(&kept);
    let square = kept.iter().map(|rr| (rr - centre).powi(2)).sum::<f64>();
    let steps: Vec<f64> =
        (1..rr.len()).filter(|&k| normal[k] && normal[k - 1]).map(|k| (rr[k] - rr[k - 1]).abs()).collect();
    Ok(Variability {
        intervals: kept.len(),
        left_out: rr.len() - kept.len(),
        mean_ms: centre,
        sdnn_ms: (square / (kept.len() - 1) as f64).sqrt(),
        rmssd_ms: mean(&steps.iter().map(|step| step * step).collect::<Vec<_>>()).sqrt(),
        pnn50_percent: 100.0 * mean(&steps.iter().map(|step| f64::from(*step > 50.0)).collect::<Vec<_>>()),
        bands: bands(beats_seconds, &rr, &normal),
    })
}

/// Whether an interval is near the median of its neighbours.
fn is_normal(rr: &[f64], k: usize) -> bool {
    let around: Vec<f64> = rr[k.saturating_sub(AROUND)..(k + AROUND + 1).min(rr.len())].to_vec();
    let middle = median(&around);
    (rr[k] - middle).abs() <= MOST_DEPARTURE * middle
}

/// Power by the discrete transform of the intervals at their own, uneven times: interpolating them first would damp the
/// respiratory band by a quarter.
fn bands(beats: &[f64], rr: &[f64], normal: &[bool]) -> Option<Bands> {
    // Each interval stands at its end, as in a tachogram.
    let (times, values): (Vec<f64>, Vec<f64>) =
        (0..rr.len()).filter(|&k| normal[k]).map(|k| (beats[k + 1], rr[k])).unzip();
    let (first, span) = (times[0], times[times.len() - 1] - times[0]);
    if span < LEAST_SECONDS {
        return None;
    }
    let shaped = windowed(&values);
    // Beyond half the beat rate variation cannot be told from slower one.
    let most_hertz = 0.5 * (times.len() - 1) as f64 / span;
    let power = |[low, high]: [f64; 2]| {
        let bins = (low * span).ceil() as usize..(high.min(most_hertz) * span).ceil() as usize;
        let at = |bin: usize| {
            let turn = std::f64::consts::TAU * bin as f64 / span;
            let (mut re, mut im) = (0.0, 0.0);
            for (time, value) in times.iter().zip(&shaped) {
                let (sin, cos) = (turn * (time - first)).sin_cos();
                re += value * cos;
                im += value * sin;
            }
            re * re + im * im
        };
        2.0 * bins.map(at).sum::<f64>() / (shaped.len() as f64).powi(2)
    };
    Some(Bands { lf_ms2: power(LF_HERTZ), hf_ms2: power(HF_HERTZ) })
}

/// Freed of its line, under a Hann window of unit mean square, so that power sums to the variance.
fn windowed(values: &[f64]) -> Vec<f64> {
    let n = values.len() as f64;
    let centre = mean(values);
    let position = |k: usize| k as f64 - 0.5 * (n - 1.0);
    let across: f64 = values.iter().enumerate().map(|(k, v)| position(k) * (v - centre)).sum();
    let along: f64 = (0..values.len()).map(|k| position(k).powi(2)).sum();
    let slope = if along > 0.0 { across / along } else { 0.0 };
    let hann = |k: usize| 0.5 * (1.0 - (std::f64::consts::TAU * (k as f64 + 0.5) / n).cos());
    let scale = (8.0_f64 / 3.0).sqrt();
    values.iter().enumerate().map(|(k, v)| scale * hann(k) * (v - centre - slope * position(k))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beats whose intervals swing by `slow` ms at 0.1 Hz and by `fast` ms at 0.25 Hz around 850 ms.
    fn swinging(seconds: f64, slow: f64, fast: f64) -> Vec<f64> {
        let mut beats = vec![0.0];
        while beats[beats.len() - 1] < seconds {
            let at = beats[beats.len() - 1];
            let swing = |hertz: f64| (std::f64::consts::TAU * hertz * at).sin();
            beats.push(at + 0.001 * (850.0 + slow * swing(0.1) + fast * swing(0.25)));
        }
        beats
    }

    #[test]
    fn known_swings_are_measured() -> Result<()> {
        let beats = swinging(300.0, 40.0, 20.0);
        let found = variability(&beats, &vec![true; beats.len()])?;
        let wanted = ((40.0_f64.powi(2) + 20.0_f64.powi(2)) / 2.0).sqrt();
        assert!((found.sdnn_ms - wanted).abs() < 1.5 && (found.mean_ms - 850.0).abs() < 2.0, "{found:?}");
        let bands = found.bands.ok_or(SignalError::Empty("bands"))?;
        assert!((bands.lf_ms2 / 800.0 - 1.0).abs() < 0.05 && (bands.hf_ms2 / 200.0 - 1.0).abs() < 0.05, "{bands:?}");
        assert!((bands.ratio() / 4.0 - 1.0).abs() < 0.1, "{bands:?}");
        Ok(())
    }

    #[test]
    fn ectopic_and_missed_beats_are_left_out() -> Result<()> {
        let clean = swinging(120.0, 30.0, 10.0);
        let wanted = variability(&clean, &vec![true; clean.len()])?;
        let mut beats = clean.clone();
        beats.remove(40);
        beats[80] -= 0.35;
        let found = variability(&beats, &vec![true; beats.len()])?;
        assert_eq!(found.left_out, 7);
        assert!((found.sdnn_ms - wanted.sdnn_ms).abs() < 1.5, "{} {}", found.sdnn_ms, wanted.sdnn_ms);
        let mut observed = vec![true; clean.len()];
        observed[10] = false;
        assert_eq!(variability(&clean, &observed)?.left_out, 4);
        Ok(())
    }

    #[test]
    fn short_recordings_have_no_bands_and_bad_ones_are_refused() -> Result<()> {
        let beats = swinging(20.0, 30.0, 10.0);
        assert!(variability(&beats, &vec![true; beats.len()])?.bands.is_none());
        let steady: Vec<f64> = (0..100).map(f64::from).collect();
        let found = variability(&steady, &[true; 100])?;
        assert_eq!((found.sdnn_ms, found.rmssd_ms, found.pnn50_percent), (0.0, 0.0, 0.0));
        assert!(matches!(variability(&[0.0, 1.0], &[true; 2]), Err(SignalError::FewBeats { .. })));
        assert!(matches!(variability(&[0.0, 0.0, 1.0], &[true; 3]), Err(SignalError::Times { .. })));
        assert!(matches!(variability(&[0.0, 1.0], &[true]), Err(SignalError::Length { .. })));
        assert!(variability(&[], &[]).is_err());
        Ok(())
    }
}
