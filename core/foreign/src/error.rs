//! What can be wrong with a foreign file; each message says what and, by [`ForeignError::remedy`], what to do.

/// Errors of the readers of foreign containers.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ForeignError {
    /// The bytes contradict the container's own rules, or are cut short.
    #[error("{what}; {}", self.remedy())]
    Damaged {
        /// What is wrong and where.
        what: String,
    },
    /// The file is sound but holds something that is not read here.
    #[error("{what}; {}", self.remedy())]
    Refused {
        /// What it holds.
        what: String,
    },
    /// A size in the file is beyond what the caller allows.
    #[error("{what}; {}", self.remedy())]
    TooLarge {
        /// Which size.
        what: String,
    },
}

impl ForeignError {
    pub(crate) fn damaged(what: impl Into<String>) -> Self {
        Self::Damaged { what: what.into() }
    }

    pub(crate) fn refused(what: impl Into<String>) -> Self {
        Self::Refused { what: what.into() }
    }

    pub(crate) fn too_large(what: impl Into<String>) -> Self {
        Self::TooLarge { what: what.into() }
    }

    /// What is wrong, without the remedy.
    pub fn what(&self) -> &str {
        match self {
            Self::Damaged { what } | Self::Refused { what } | Self::TooLarge { what } => what,
        }
    }

    /// What to do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Damaged { .. } => "copy or download it again",
            Self::Refused { .. } => "only plain arrays are read, nothing is executed; save plain arrays or tensors",
            Self::TooLarge { .. } => "give the right file",
        }
    }
}
