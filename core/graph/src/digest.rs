//! Digests, and the canonical text that keys are made of.

use std::fmt;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

/// A BLAKE3 digest; shown as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest([u8; 32]);

impl Digest {
    /// The digest of some bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self::from(blake3::hash(bytes))
    }

    /// The digest of pieces, joined.
    pub fn of_pieces<'a>(pieces: impl IntoIterator<Item = &'a [u8]>) -> Self {
        let mut hasher = blake3::Hasher::new();
        pieces.into_iter().for_each(|piece| {
            hasher.update(piece);
        });
        Self::from(hasher.finalize())
    }

    /// The digest of all that is still to be read.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn of_rest(mut from: impl std::io::Read) -> std::io::Result<Self> {
        let (mut hasher, mut piece) = (blake3::Hasher::new(), vec![0; 1 << 20]);
        loop {
            match from.read(&mut piece)? {
                0 => return Ok(Self::from(hasher.finalize())),
                count => hasher.update(&piece[..count]),
            };
        }
    }

    /// The digest of a JSON value, whatever the order of its keys.
    pub fn of_json(value: &Value) -> Self {
        Self::of(canonical(value).as_bytes())
    }

    /// The 32 bytes.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl From<[u8; 32]> for Digest {
    fn from(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }
}

impl From<blake3::Hash> for Digest {
    fn from(hash: blake3::Hash) -> Self {
        Self(*hash.as_bytes())
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&blake3::Hash::from_bytes(self.0).to_hex())
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, formatter)
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

impl std::str::FromStr for Digest {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        blake3::Hash::from_hex(text).map(Self::from).map_err(|error| format!("no digest: {error}"))
    }
}

/// JSON without spaces, with sorted keys and −0 as 0. Depth is bounded by the readers that made the value.
pub(crate) fn canonical(value: &Value) -> String {
    let mut text = String::new();
    write_canonical(value, &mut text);
    text
}

fn write_canonical(value: &Value, text: &mut String) {
    match value {
        Value::Object(map) => {
            let mut keys: Vec<&String> = map.keys().collect();
            keys.sort();
            text.push('{');
            for (index, key) in keys.into_iter().enumerate() {
                text.push_str(if index == 0 { "" } else { "," });
                text.push_str(&Value::from(key.as_str()).to_string());
                text.push(':');
                write_canonical(&map[key], text);
            }
            text.push('}');
        }
        Value::Array(values) => {
            text.push('[');
            for (index, value) in values.iter().enumerate() {
                text.push_str(if index == 0 { "" } else { "," });
                write_canonical(value, text);
            }
            text.push(']');
        }
        Value::Number(number) if number.as_f64() == Some(0.0) && number.is_f64() => text.push_str("0.0"),
        other => text.push_str(&other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn keys_do_not_see_key_order_or_the_sign_of_zero_but_see_all_else() {
        let digest = Digest::of_json(&json!({"a": [1, 0.0], "b": "x"}));
        assert_eq!(digest, Digest::of_json(&json!({"b": "x", "a": [1, -0.0]})));
        for other in [json!({"a": [1, 0.5], "b": "x"}), json!({"a": [1], "b": "x"}), json!({"a": [0.0, 1], "b": "x"})] {
            assert_ne!(digest, Digest::of_json(&other));
        }
        let value = json!({"b": [1, {"z": null, "a": "é\n"}], "a": -0.0, "c": {}});
        assert_eq!(canonical(&value), r#"{"a":0.0,"b":[1,{"a":"é\n","z":null}],"c":{}}"#);
        let text = digest.to_string();
        assert_eq!(serde_json::from_value::<Digest>(Value::from(text)).ok(), Some(digest));
    }
}
