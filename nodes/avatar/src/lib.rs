//! The nodes of the avatar: fitting it, finding its skin, rendering it under its own light and others, showing it.

mod avatar_exporter;
mod baseline_trainer;
mod hosted;
mod relighter;
mod renderer;
mod side_by_side;
mod skin_selector;
mod turntable;

pub use avatar_exporter::AvatarExporter;
pub use baseline_trainer::BaselineTrainer;
pub use relighter::Relighter;
pub use renderer::Renderer;
pub use side_by_side::SideBySide;
pub use skin_selector::{Blood, SkinSelector};
pub use turntable::Turntable;
