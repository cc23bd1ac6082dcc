//! The words for what the bound on 8-bit levels did.

use heartian_pulse::{Limited, Pulse};

/// A warning that says how much was limited and when, or nothing.
pub(crate) fn bound_message(limited: &Limited, pulse: &Pulse) -> Option<String> {
    let (first, last) = (limited.first_frame?, limited.last_frame?);
    let at = |frame: u64| pulse.times_seconds.get(frame as usize).copied().unwrap_or(0.0);
    Some(format!(
        "the bound of {} 8-bit levels limited {} offsets in {} of {} frames, from {:.2} s to {:.2} s; lower phase.amplitude \
         or raise phase.most_levels if that is not wanted",
        pulse.strength.most_levels,
        limited.offsets,
        limited.frames,
        pulse.times_seconds.len(),
        at(first),
        at(last),
    ))
}
