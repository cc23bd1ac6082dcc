//! What can go wrong with an avatar. Messages name what, where and the remedy.

/// Errors of fitting, rendering and selecting.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AvatarError {
    /// The head's joints are not a root, a neck, and jaw and eyes on the neck.
    #[error(
        "head model `{name}`: the skeleton must be root → neck → (jaw, left eye, right eye); use another head model"
    )]
    Skeleton {
        /// The model's name.
        name: String,
    },
    /// Two inputs describe different clips.
    #[error("{what}: {found} where {expected} was expected; track and clip must come from the same recording")]
    Mismatch {
        /// What differs.
        what: &'static str,
        /// Wanted.
        expected: String,
        /// Found.
        found: String,
    },
    /// Too little to learn from.
    #[error("{what} ({found}); {remedy}")]
    TooLittle {
        /// What there is too little of.
        what: &'static str,
        /// How much there is.
        found: usize,
        /// What to do.
        remedy: &'static str,
    },
    /// A tracked pose holds a number that is not finite.
    #[error("the tracked pose of frame {frame} is not finite; track the clip again")]
    PoseNotFinite {
        /// Frame number.
        frame: usize,
    },
    /// An option is out of its range.
    #[error("option `{name}` is {value}; it must be {range}")]
    Option {
        /// The option's name.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What is accepted.
        range: &'static str,
    },
    /// The selection is empty.
    #[error(
        "no Gaussian is facial skin: {close} of {total} lie within {threshold_metres} m of the head mesh and {facing} of \
         those face forward; raise the threshold or train longer"
    )]
    NoSkin {
        /// Gaussians looked at.
        total: usize,
        /// Those close to the mesh.
        close: usize,
        /// Those also facing forward.
        facing: usize,
        /// The threshold used.
        threshold_metres: f32,
    },
    /// A Gaussian named by a table does not exist.
    #[error("{what} names Gaussian {index} of an avatar with {count}; it was made for another avatar")]
    Index {
        /// The table.
        what: &'static str,
        /// The index.
        index: usize,
        /// Number of Gaussians.
        count: usize,
    },
    /// The rasteriser refused the scene.
    #[error(transparent)]
    Splat(#[from] heartian_splat::SplatError),
    /// Plain data contradict themselves.
    #[error(transparent)]
    Space(#[from] heartian_space::SpaceError),
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
}
