//! Pictures and files of a run: contact sheets, waveform figures, previews, tables. They explain figures; they make none.

mod agreement;
mod canvas;
mod cost;
mod csv;
mod face_map;
mod figure;
mod parquet;
mod preview;
mod scaling;
mod sheet;
mod trade_off;

pub use agreement::{Agreement, agreement_figure};
pub use canvas::{decode_png, encode_png};
pub use cost::{CostLine, CostPoint, cost_figure};
pub use csv::table_csv;
pub use face_map::{FaceMap, face_maps};
pub use figure::{Curve, waveform_figure};
pub use parquet::table_parquet;
pub use preview::encode_preview;
pub use scaling::{ScalingLine, scaling_figure};
pub use sheet::contact_sheet;
pub use trade_off::{TradeOff, trade_off_figure};

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
    /// The PNG reader refused.
    #[error("it is no PNG picture that can be read: {0}")]
    Decoding(#[from] png::DecodingError),
    /// A picture too large to read.
    #[error("a picture of {width}×{height} pixels is too large; give one of at most {most} a side")]
    Size {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Most that is read.
        most: u32,
    },
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
