//! Nodes BaselineTrainer, SkinSelector, Renderer and Relighter.
