//! Gaussians on a head: deformation, stage-1 fitting, density control, skin selection.
