//! The beat-aligned reference phase: linear between consecutive systolic peaks, 2π a beat.

use std::f64::consts::TAU;

use crate::error::{Result, SignalError, check_times};

/// Phase and beat of each frame.
#[derive(Clone, Debug, PartialEq)]
pub struct BeatPhase {
    /// Cumulative phase, radians, ≥ 0, strictly increasing: a multiple of 2π at each systolic peak. Its beat is
    /// `floor(phase/2π)`.
    pub phase_radians: Vec<f64>,
    /// Beat of each frame, counted from 0 for the first frame's.
    pub beat_index: Vec<usize>,
}

impl BeatPhase {
    /// Number of beats touched, at least 1.
    pub fn beat_count(&self) -> usize {
        self.beat_index.last().map_or(0, |last| last.saturating_add(1))
    }
}

/// The phase at frame times given the times of systolic peaks (same clock, both strictly increasing). Before the first
/// and after the last peak the rate of the nearest beat goes on.
///
/// # Errors
/// When there is no frame, fewer than two peaks, or times are not finite and increasing.
pub fn beat_aligned_phase(times_seconds: &[f64], peaks_seconds: &[f64]) -> Result<BeatPhase> {
    check_times("the frame times", times_seconds)?;
    if peaks_seconds.len() < 2 {
        return Err(SignalError::FewBeats { found: peaks_seconds.len(), needed: 2 });
    }
    check_times("the beat times", peaks_seconds)?;
    let turns: Vec<f64> = times_seconds
        .iter()
        .map(|&time| {
            let after = peaks_seconds.partition_point(|&peak| peak <= time).clamp(1, peaks_seconds.len() - 1);
            let (from, to) = (peaks_seconds[after - 1], peaks_seconds[after]);
            (after - 1) as f64 + (time - from) / (to - from)
        })
        .collect();
    let first_beat = turns[0].floor();
    Ok(BeatPhase {
        phase_radians: turns.iter().map(|turn| TAU * (turn - first_beat)).collect(),
        beat_index: turns.iter().map(|turn| (turn - first_beat).floor() as usize).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_are_whole_turns_and_ends_go_on_at_the_neighbouring_rate() -> Result<()> {
        let peaks = [1.0, 2.0, 2.5];
        let phase = beat_aligned_phase(&[-0.5, 0.5, 1.0, 1.5, 2.0, 2.25, 2.5, 3.25], &peaks)?;
        let turns: Vec<f64> = phase.phase_radians.iter().map(|radians| radians / TAU).collect();
        let wanted = [0.5, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.5];
        assert!(turns.iter().zip(wanted).all(|(got, want)| (got - want).abs() < 1e-12), "{turns:?}");
        assert_eq!(phase.beat_index, [0, 1, 2, 2, 3, 3, 4, 5]);
        assert_eq!(phase.beat_count(), 6);
        Ok(())
    }

    #[test]
    fn refuses_too_few_beats_and_bad_times() {
        assert!(matches!(beat_aligned_phase(&[0.0], &[1.0]), Err(SignalError::FewBeats { found: 1, .. })));
        assert!(matches!(beat_aligned_phase(&[], &[1.0, 2.0]), Err(SignalError::Empty(_))));
        assert!(matches!(beat_aligned_phase(&[0.0, f64::NAN], &[1.0, 2.0]), Err(SignalError::Times { index: 1, .. })));
        assert!(matches!(beat_aligned_phase(&[0.0], &[2.0, 2.0]), Err(SignalError::Times { index: 1, .. })));
    }
}
