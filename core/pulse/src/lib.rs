//! Cardiac phase, two-Gaussian waveform, residual network, losses and stage-2 fitting.
