//! Gaussians: projection, rasteriser with exact gradients, deferred shading, lights and image losses. Knows no face.
