//! The four networks by name, and telling them apart by their tensors.

use crate::{DecoderError, Weights};

/// A network this crate can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Architecture {
    /// Temporal-shift convolutional attention network (Liu et al. 2020); also with motion-augmented weights.
    TsCan,
    /// Temporal-difference video transformer (Yu et al. 2022).
    PhysFormer,
    /// Convolutions with an optional factorised self-attention (Joshi et al. 2024).
    FactorizePhys,
    /// Spatio-temporal encoder and decoder (Yu et al. 2019).
    PhysNet,
}

impl Architecture {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::TsCan, Self::PhysFormer, Self::FactorizePhys, Self::PhysNet];

    /// The name users write: `TS-CAN`, `PhysFormer`, `FactorizePhys`, `PhysNet`.
    pub fn name(self) -> &'static str {
        match self {
            Self::TsCan => "TS-CAN",
            Self::PhysFormer => "PhysFormer",
            Self::FactorizePhys => "FactorizePhys",
            Self::PhysNet => "PhysNet",
        }
    }

    /// The architecture of a name; case, `-`, `_` and spaces do not matter.
    pub fn from_name(name: &str) -> Option<Self> {
        let plain = |text: &str| -> String {
            text.chars().filter(|c| c.is_alphanumeric()).map(|c| c.to_ascii_lowercase()).collect()
        };
        Self::ALL.into_iter().find(|architecture| plain(architecture.name()) == plain(name))
    }

    /// The architecture that the names of the weights are those of.
    ///
    /// # Errors
    /// When no architecture has such tensors.
    pub fn of(weights: &Weights) -> Result<Self, DecoderError> {
        let known =
            |name: &str, architecture: &Self| architecture.prefixes().iter().any(|prefix| name.starts_with(prefix));
        let found =
            weights.names().find_map(|name| Self::ALL.into_iter().find(|architecture| known(name, architecture)));
        found.ok_or_else(|| DecoderError::Unrecognised {
            tensors: weights.len(),
            first: weights.names().next().map(str::to_owned),
        })
    }

    /// How tensors begin that only this architecture has.
    fn prefixes(self) -> &'static [&'static str] {
        match self {
            Self::TsCan => &["motion_conv", "apperance_"],
            Self::PhysFormer => &["Stem", "transformer"],
            Self::FactorizePhys => &["rppg_"],
            Self::PhysNet => &["ConvBlock1.", "ConvBlock2.", "ConvBlock3."],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_back() {
        for architecture in Architecture::ALL {
            assert_eq!(Architecture::from_name(architecture.name()), Some(architecture));
        }
        assert_eq!(Architecture::from_name("tscan"), Some(Architecture::TsCan));
        assert_eq!(Architecture::from_name("ts_can"), Some(Architecture::TsCan));
        assert_eq!(Architecture::from_name("deepphys"), None);
    }
}
