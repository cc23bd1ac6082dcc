//! From recovered waves to heart rates, each with what speaks for it.

use heartian_signal::certainty::{Evidence, evidence, window_rates};
use heartian_signal::{HeartRate, Protocol, WindowRate};

use crate::{DecoderError, Reader, Wave, keys};

/// What one decoder says.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Key of the decoder, unique among those that read the recording (`pos`, `tscan`).
    pub key: String,
    /// Its name (`POS`, `TS-CAN`).
    pub name: &'static str,
    /// Time of the trace's first sample, seconds.
    pub start_seconds: f64,
    /// The trace as the decoder gave it, on an even grid.
    pub trace: Vec<f64>,
    /// The rate over the whole recording, the filtered trace and its spectrum.
    pub rate: HeartRate,
    /// Rates of windows read by themselves.
    pub windows: Vec<WindowRate>,
    /// What speaks for the rate.
    pub evidence: Evidence,
}

impl Measured {
    /// The chance that the rate is right to 5 bpm.
    pub fn confidence(&self) -> f64 {
        self.evidence.confidence()
    }
}

/// The heart rate in each wave, in the order of the decoders; each is confirmed or doubted by the others.
pub fn measure(
    readers: &[Reader],
    waves: Vec<Result<Wave, DecoderError>>,
    protocol: &Protocol,
) -> Vec<(String, Result<Measured, DecoderError>)> {
    let read = |wave: Result<Wave, DecoderError>| -> Result<(Wave, HeartRate), DecoderError> {
        let wave = wave?;
        let rate = protocol.estimate(&wave.values, wave.rate_hertz)?;
        Ok((wave, rate))
    };
    let rates: Vec<_> = waves.into_iter().map(read).collect();
    let bpm: Vec<Option<f64>> = rates.iter().map(|rate| rate.as_ref().ok().map(|(_, rate)| rate.bpm)).collect();
    let judged = |(index, rate): (usize, Result<(Wave, HeartRate), DecoderError>)| {
        let key = keys(readers).swap_remove(index);
        let judge = |(wave, rate): (Wave, HeartRate)| {
            let others: Vec<f64> =
                bpm.iter().enumerate().filter(|(other, _)| *other != index).filter_map(|(_, bpm)| *bpm).collect();
            let windows = window_rates(&wave.values, wave.rate_hertz, protocol);
            let evidence = evidence(&rate, &windows, &others)?;
            let (key, name, start_seconds) = (key.clone(), readers[index].name(), wave.start_seconds);
            Ok(Measured { key, name, start_seconds, trace: wave.values, rate, windows, evidence })
        };
        let measured = rate.and_then(judge);
        (key, measured)
    };
    rates.into_iter().enumerate().map(judged).collect()
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use heartian_signal::{Method, Preset, SignalError};

    use super::*;

    #[test]
    fn decoders_confirm_each_other_and_one_that_failed_says_why() {
        let readers = [Method::Pos, Method::Pos, Method::Chrom].map(Reader::Classical);
        let tone = |bpm: f64| {
            let values = (0..600).map(|k| (std::f64::consts::TAU * bpm / 60.0 * f64::from(k) / 30.0).sin()).collect();
            Ok(Wave { rate_hertz: 30.0, start_seconds: 2.0, values })
        };
        let failed = Err(DecoderError::Signal(SignalError::Flat("the trace")));
        let found = measure(&readers, vec![tone(80.0), tone(80.4), failed], &Preset::ToolboxFine.protocol());
        assert_eq!(found.iter().map(|(key, _)| key.as_str()).collect::<Vec<_>>(), ["pos", "pos_2", "chrom"]);
        let first = found[0].1.as_ref().unwrap();
        assert!((first.rate.bpm - 80.0).abs() < 0.2 && first.evidence.methods == 1.0 && first.confidence() > 0.9);
        assert!(found[2].1.is_err());
    }
}
