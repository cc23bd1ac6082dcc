//! Camera, images, clips, time series, colour spaces and named metrics: the plain data every domain crate shares.
//!
//! World frame: metres, x right, y up, z toward the viewer. Camera frame: OpenCV (x right, y down, z forward), pixel
//! centres at +0.5. Images are row-major, top row first, RGB interleaved; 8-bit images are sRGB-encoded.

mod camera;
mod clip;
pub mod color;
mod csv;
mod error;
mod image;
mod labels;
mod metrics;
mod progress;
mod series;
mod skin;
mod sparse;
mod table;
mod traces;

pub use camera::Camera;
pub use clip::{Clip, Sequence};
pub use csv::{CsvError, CsvKind, read_csv};
pub use error::SpaceError;
pub use image::Rgb8Image;
pub use labels::Labels;
pub use metrics::Metrics;
pub use progress::{Host, Progress};
pub use series::Series;
pub use skin::{Modulation, Perfusion, Skin};
pub use sparse::AlbedoOperator;
pub use table::{Cell, Cells, Table};
pub use traces::{Trace, Traces};
