//! The nodes that read a heartbeat back and report it. They cannot see `heartian-pulse`: no reader grades its own pen.

mod benchmark_decoder;
mod choices;
mod hr_estimator;
mod report;
mod scores;

pub use benchmark_decoder::BenchmarkDecoder;
pub use choices::{Convention, FaceCut, NormalisedOver, Pixels, ReadBy};
pub use hr_estimator::{HrEstimator, Mode};
pub use report::Report;
