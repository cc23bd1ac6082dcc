//! What can be asked of a synthetic recording, with ranges checked in one place.

use serde::{Deserialize, Serialize};

use super::look::{Light, SkinTone};
use crate::CaptureError;

/// Most memory a recording may take for frames and matte, bytes.
const MEMORY_LIMIT: f64 = 16.0 * (1u64 << 30) as f64;

/// Options of a synthetic recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SyntheticOptions {
    /// Length, seconds, in (0, 3600].
    pub seconds: f64,
    /// Side of the square picture, pixels, 32 to 2048.
    pub size: usize,
    /// Frame rate, hertz, 1 to 240.
    pub frames_per_second: f64,
    /// Which person, motion, heart and noise.
    pub seed: u64,
    /// Mean heart rate, 30 to 220 beats a minute.
    pub heart_rate_bpm: f64,
    /// Heart-rate variability: standard deviation of the beat-to-beat intervals, 0 to 150 ms.
    pub hrv_ms: f64,
    /// The light.
    pub light: Light,
    /// The skin tone.
    pub skin_tone: SkinTone,
    /// Relative change of green skin albedo from trough to peak of a beat at the forehead and cheeks, 0 to 0.2.
    pub pulse_strength: f64,
    /// How much the head moves and talks, 0 (still but for eyes and lids) to 2; 1 is ±8° of yaw.
    pub motion: f64,
    /// Standard deviation of the landmarks' error along each axis, 0 to 20 pixels.
    pub landmark_noise_px: f64,
}

impl Default for SyntheticOptions {
    fn default() -> Self {
        Self {
            seconds: 20.0,
            size: 256,
            frames_per_second: 30.0,
            seed: 1,
            heart_rate_bpm: 72.0,
            hrv_ms: 35.0,
            light: Light::Studio,
            skin_tone: SkinTone::Light,
            pulse_strength: 0.012,
            motion: 1.0,
            landmark_noise_px: 0.6,
        }
    }
}

impl SyntheticOptions {
    /// Number of frames, at least 1.
    pub fn frame_count(&self) -> usize {
        ((self.seconds * self.frames_per_second).round() as usize).max(1)
    }

    /// Checks every option.
    ///
    /// # Errors
    /// Names the first option that is out of its range, or says that the recording would not fit in memory.
    pub fn validate(&self) -> Result<(), CaptureError> {
        let size = self.size as f64;
        let checks = [
            ("seconds", self.seconds, self.seconds > 0.0 && self.seconds <= 3600.0, "above 0 and at most 3600"),
            ("size", size, (32..=2048).contains(&self.size), "32 to 2048 pixels"),
            within("frames_per_second", self.frames_per_second, [1.0, 240.0], "1 to 240"),
            within("heart_rate_bpm", self.heart_rate_bpm, [30.0, 220.0], "30 to 220"),
            within("hrv_ms", self.hrv_ms, [0.0, 150.0], "0 to 150"),
            within("pulse_strength", self.pulse_strength, [0.0, 0.2], "0 to 0.2"),
            within("motion", self.motion, [0.0, 2.0], "0 to 2"),
            within("landmark_noise_px", self.landmark_noise_px, [0.0, 20.0], "0 to 20"),
        ];
        for (name, value, is_fine, range) in checks {
            if !is_fine {
                return Err(CaptureError::Option { name, value, range });
            }
        }
        let bytes = self.frame_count() as f64 * size * size * 4.0;
        if bytes > MEMORY_LIMIT {
            let gibibytes = bytes / (1u64 << 30) as f64;
            return Err(CaptureError::TooLarge { frames: self.frame_count(), size: self.size, gibibytes });
        }
        Ok(())
    }
}

fn within(
    name: &'static str,
    value: f64,
    [low, high]: [f64; 2],
    range: &'static str,
) -> (&'static str, f64, bool, &'static str) {
    (name, value, (low..=high).contains(&value), range)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_option_out_of_range_is_refused_by_its_name() {
        let fine = SyntheticOptions::default();
        assert!(fine.validate().is_ok());
        let change = |edit: fn(&mut SyntheticOptions, f64), values: &[f64], name: &str| {
            for value in values {
                let mut options = fine.clone();
                edit(&mut options, *value);
                let message = options.validate().map_or_else(|error| error.to_string(), |()| "accepted".into());
                assert!(message.contains(name), "{value}: {message}");
            }
        };
        let odd = [f64::NAN, f64::INFINITY, -1.0, 1e9];
        change(|o, v| o.seconds = v, &[f64::NAN, f64::INFINITY, -1.0, 0.0, 1e9], "seconds");
        change(|o, v| o.size = v as usize, &[0.0, 31.0, 1e6], "size");
        change(|o, v| o.frames_per_second = v, &odd, "frames_per_second");
        change(|o, v| o.heart_rate_bpm = v, &odd, "heart_rate_bpm");
        change(|o, v| o.hrv_ms = v, &odd, "hrv_ms");
        change(|o, v| o.pulse_strength = v, &odd, "pulse_strength");
        change(|o, v| o.motion = v, &odd, "motion");
        change(|o, v| o.landmark_noise_px = v, &odd, "landmark_noise_px");
        let huge = SyntheticOptions { seconds: 3600.0, size: 2048, ..fine };
        assert!(matches!(huge.validate(), Err(CaptureError::TooLarge { .. })));
    }
}
