//! The four networks (see rPPG-Toolbox and the papers named in each), and what they share.

pub mod factorizephys;
pub mod physformer;
pub mod physnet;
pub mod tscan;

use std::collections::BTreeMap;

use heartian_ops::{Extent, Volume};

use crate::{Batch, DecoderError, InputForm};

/// Inner values under the names of the reference vectors; empty unless a test asks.
#[derive(Debug, Default)]
pub struct Trace(Option<BTreeMap<String, Vec<f32>>>);

impl Trace {
    /// Records, for tests.
    #[cfg(test)]
    pub fn recording() -> Self {
        Self(Some(BTreeMap::new()))
    }

    /// What was recorded.
    #[cfg(test)]
    pub fn into_values(self) -> BTreeMap<String, Vec<f32>> {
        self.0.unwrap_or_default()
    }

    /// Adds values under a name, if anybody listens; more values of one name follow the earlier ones.
    pub fn note(&mut self, name: impl FnOnce() -> String, values: impl FnOnce() -> Vec<f32>) {
        if let Some(notes) = &mut self.0 {
            notes.entry(name()).or_default().extend(values());
        }
    }
}

/// One chunk of a batch as planes with a margin.
fn chunk_volume(batch: &Batch<'_>, form: &InputForm, chunk: usize, margin: usize) -> Result<Volume, DecoderError> {
    let frames = batch.frames + form.extra_frames;
    let extent = Extent { frames, channels: form.channels(), height: form.side_px, width: form.side_px };
    let len = extent.values();
    Ok(Volume::from_dense(extent, margin, &batch.data[chunk * len..(chunk + 1) * len], false)?)
}
