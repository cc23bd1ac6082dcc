//! What reads a pulse from frames: a classical method on the mean colour, or a network on the face crop.

use std::sync::Arc;

use heartian_signal::Method;

use crate::{Architecture, Network};

/// One decoder.
#[derive(Clone, Debug)]
pub enum Reader {
    /// An unsupervised method.
    Classical(Method),
    /// A network with its weights.
    Neural(Arc<Network>),
}

impl Reader {
    /// A network with its weights.
    pub fn neural(network: Network) -> Self {
        Self::Neural(Arc::new(network))
    }

    /// Its name as people write it: `POS`, `TS-CAN`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Classical(method) => method.name(),
            Self::Neural(network) => network.architecture().name(),
        }
    }

    /// Its name in metrics: lower case letters only (`pos`, `tscan`).
    pub fn key(&self) -> String {
        self.name().chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
    }
}

/// The decoder a word names, classical or neural; case and hyphens do not matter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Named {
    /// An unsupervised method.
    Classical(Method),
    /// A network, whose weights are a file of their own.
    Neural(Architecture),
}

impl Named {
    /// The decoder of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Method::from_name(name).map(Self::Classical).or_else(|| Architecture::from_name(name).map(Self::Neural))
    }

    /// All names, classical first.
    pub fn names() -> Vec<&'static str> {
        let classical = Method::ALL.into_iter().map(Method::name);
        classical.chain(Architecture::ALL.into_iter().map(Architecture::name)).collect()
    }
}

/// Keys for several decoders, a number behind those that occur again (`physnet`, `physnet_2`).
pub fn keys(readers: &[Reader]) -> Vec<String> {
    let mut keys: Vec<String> = Vec::with_capacity(readers.len());
    for reader in readers {
        let key = reader.key();
        let mut unique = key.clone();
        let mut count = 1;
        while keys.contains(&unique) {
            count += 1;
            unique = format!("{key}_{count}");
        }
        keys.push(unique);
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_find_their_decoders_and_keys_are_unique() {
        assert_eq!(Named::from_name("ts-can"), Some(Named::Neural(Architecture::TsCan)));
        assert_eq!(Named::from_name("Omit"), Some(Named::Classical(Method::Omit)));
        assert_eq!(Named::from_name("deepphys"), None);
        assert!(Named::names().iter().all(|name| Named::from_name(name).is_some()));
        let readers = [Method::Pos, Method::Lgi, Method::Pos].map(Reader::Classical);
        assert_eq!(keys(&readers), ["pos", "lgi", "pos_2"]);
    }
}
