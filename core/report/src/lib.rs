//! Pictures of a run: contact sheets, waveform figures and previews. They explain figures; they make none.

mod canvas;
mod figure;
mod preview;
mod sheet;

pub use canvas::encode_png;
pub use figure::{Curve, waveform_figure};
pub use preview::encode_preview;
pub use sheet::contact_sheet;

/// What can go wrong while drawing.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The drawing library refused.
    #[error("drawing failed: {0}")]
    Drawing(String),
    /// The PNG writer refused.
    #[error("PNG encoding failed: {0}")]
    Png(#[from] png::EncodingError),
    /// Nothing to draw.
    #[error("there is no {0} to draw")]
    Nothing(&'static str),
    /// Clips of different sizes or lengths cannot stand side by side.
    #[error("clip `{label}` is {found}, the first clip is {expected}; render both alike")]
    Mismatch {
        /// The clip that differs.
        label: String,
        /// Size and length of the first clip.
        expected: String,
        /// Its own.
        found: String,
    },
}
