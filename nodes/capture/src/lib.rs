//! The nodes that see the face: frames with their matte and landmarks, and the head tracked through them; and the one that
//! lays clips out for other programs.

mod dataset_exporter;
mod flame_tracker;
mod frame_loader;
mod track_movie;

pub use dataset_exporter::DatasetExporter;
pub use flame_tracker::FlameTracker;
pub use frame_loader::FrameLoader;
pub use track_movie::TrackMovie;
