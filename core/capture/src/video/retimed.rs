//! Frames whose true times stand beside the video, as data sets keep them.

use super::{FrameSource, TimedFrame, VideoError};

/// A source with other times.
pub(super) struct Retimed {
    source: Box<dyn FrameSource + Send>,
    times_seconds: std::vec::IntoIter<f64>,
}

impl Retimed {
    pub fn new(source: Box<dyn FrameSource + Send>, times_seconds: Vec<f64>) -> Self {
        Self { source, times_seconds: times_seconds.into_iter() }
    }
}

impl FrameSource for Retimed {
    /// Frames without a time of their own end the video: where they belong is not known.
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        let Some(seconds) = self.times_seconds.next() else { return Ok(None) };
        Ok(self.source.next_frame()?.map(|frame| TimedFrame { seconds, ..frame }))
    }

    fn frame_count(&self) -> Option<usize> {
        self.source.frame_count()
    }

    fn notes(&self) -> &[String] {
        self.source.notes()
    }
}
