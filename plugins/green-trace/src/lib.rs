//! A plugin with one measuring node: reads the house's `clip/1`, writes the house's `traces/1`.

use heartian_plugin::{Bundle, Call, Error, Inputs, Node, Outputs, Port, export, params};

params! {
    /// Mean green of the pixels that belong to the person, frame by frame: the plainest of all pulse signals.
    pub struct GreenTrace {
        /// Alpha from which a pixel counts as the person.
        least_alpha: u8 = 128, range(1.0, 255.0);
        /// Label of the trace.
        label: String = "green".to_owned();
    }
}

impl Node for GreenTrace {
    const KIND: &'static str = "GreenTrace";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[Port::one("clip", "clip/1", "The clip to measure.")];
    const OUTPUTS: &'static [Port] = &[Port::one("traces", "traces/1", "Mean green, 0 to 255, sRGB-encoded.")];

    fn run(&self, inputs: &Inputs<'_>, call: &Call) -> Result<Outputs, Error> {
        let clip = inputs.get("clip")?.bundle()?;
        let (shape, frames) = clip.tensor::<u8>("frames")?;
        let (alpha, times) = (clip.tensor::<u8>("alpha")?.1, clip.tensor::<f64>("times_seconds")?.1);
        let area = shape.iter().skip(1).take(2).product::<usize>().max(1);
        let mut values = Vec::with_capacity(times.len());
        for (index, (frame, matte)) in frames.chunks(area * 3).zip(alpha.chunks(area)).enumerate() {
            values.push(mean_green(frame, matte, self.least_alpha).ok_or_else(|| {
                Error::new(format!("frame {index} shows nobody")).parameter("least_alpha").remedy("lower `least_alpha`")
            })?);
            if call.progress(index as u64 + 1, times.len() as u64, None).is_break() {
                return Err(Error::cancelled());
            }
        }
        let bundle = Bundle::new().meta("labels", &[&self.label])?.tensor("0.times_seconds", &[times.len()], &times)?;
        Ok(Outputs::new().put_bundle("traces", &bundle.tensor("0.values", &[values.len()], &values)?)?)
    }
}

export!(GreenTrace);

/// Mean of the green channel where the matte is opaque enough; nothing when it is so nowhere.
fn mean_green(frame: &[u8], matte: &[u8], least_alpha: u8) -> Option<f64> {
    let pixels = frame.as_chunks::<3>().0.iter().zip(matte).filter(|(_, alpha)| **alpha >= least_alpha);
    let (sum, count) = pixels.fold((0u64, 0u64), |(sum, count), (pixel, _)| (sum + u64::from(pixel[1]), count + 1));
    (count > 0).then(|| sum as f64 / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_person_counts() {
        let frame = [0, 10, 0, 0, 20, 0, 0, 200, 0];
        assert_eq!(mean_green(&frame, &[255, 128, 127], 128), Some(15.0));
        assert_eq!(mean_green(&frame, &[0; 3], 128), None);
        assert_eq!(mean_green(&[], &[], 1), None);
    }
}
