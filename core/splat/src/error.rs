//! What can be wrong with a scene, an image or a light.

/// Errors of this crate. Values inside a scene are never an error: a Gaussian with a non-finite or degenerate
/// attribute is left out of the picture and gets zero gradients.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SplatError {
    /// A buffer's length contradicts the others.
    #[error("{what} holds {found} values where {expected} were expected")]
    Length {
        /// The buffer.
        what: &'static str,
        /// Wanted number of values.
        expected: usize,
        /// Found number of values.
        found: usize,
    },
    /// More channels than the rasteriser is built for.
    #[error("{found} channels asked for; the rasteriser takes 1 to {most}, depth included")]
    Channels {
        /// Asked for.
        found: usize,
        /// Largest.
        most: usize,
    },
    /// More (Gaussian, tile) pairs than memory should hold.
    #[error(
        "the Gaussians cover more than {most} tiles of the picture together; make them smaller or fewer, or the picture \
         smaller"
    )]
    Pairs {
        /// Most.
        most: usize,
    },
    /// A camera that makes no picture.
    #[error("the camera cannot be used: {0}")]
    Camera(&'static str),
    /// A device that does not exist, is not known, or was lost.
    #[error("device: {0}")]
    Device(String),
    /// A light file that cannot be read.
    #[error("light {path}: {reason}")]
    Light {
        /// The file.
        path: String,
        /// Why, and what to do.
        reason: String,
    },
    /// A point-cloud file that cannot be read or written.
    #[error("splat file {path}: {reason}")]
    File {
        /// The file.
        path: String,
        /// Why, and what to do.
        reason: String,
    },
}

/// Fails when a buffer has not the length that the others ask for.
pub(crate) fn expect_length(what: &'static str, expected: usize, found: usize) -> Result<(), SplatError> {
    if expected == found { Ok(()) } else { Err(SplatError::Length { what, expected, found }) }
}
