//! The nodes of the avatar: fitting it, finding its skin, rendering it under its own light and others.

mod baseline_trainer;
mod hosted;
mod relighter;
mod renderer;
mod skin_selector;

pub use baseline_trainer::BaselineTrainer;
pub use relighter::Relighter;
pub use renderer::Renderer;
pub use skin_selector::{Blood, SkinSelector};
