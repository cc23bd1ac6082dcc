//! The nodes that write the heartbeat: phase and waveform, and the residual network.

mod bound;
mod mlp_residual;
mod phase_model;

pub use mlp_residual::MlpResidual;
pub use phase_model::{LossesUsed, PhaseModel, Preset, WeakPrior};
