//! Nodes PhaseModel and MlpResidual.
