//! Parameter types by name, for kinds described at run time: reading a value as its type, with the messages that
//! built-in nodes give.

use serde::de::{DeserializeOwned, Deserializer, Error};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Types a parameter may have; a list holds any number of one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ParamForm {
    scalar: Scalar,
    list: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scalar {
    Bool,
    U8,
    U16,
    U32,
    U64,
    I32,
    I64,
    F32,
    F64,
    Text,
}

const NAMES: [(&str, Scalar); 10] = [
    ("bool", Scalar::Bool),
    ("u8", Scalar::U8),
    ("u16", Scalar::U16),
    ("u32", Scalar::U32),
    ("u64", Scalar::U64),
    ("i32", Scalar::I32),
    ("i64", Scalar::I64),
    ("f32", Scalar::F32),
    ("f64", Scalar::F64),
    ("String", Scalar::Text),
];

impl ParamForm {
    /// The type of that name.
    pub fn named(name: &str, list: bool) -> Option<Self> {
        NAMES.iter().find(|(known, _)| *known == name).map(|(_, scalar)| Self { scalar: *scalar, list })
    }

    /// All names, for an error.
    pub fn names() -> String {
        NAMES.map(|(name, _)| name).join(", ")
    }

    /// The type as the manual shows it.
    pub fn show(self) -> String {
        let name = NAMES.iter().find(|(_, scalar)| *scalar == self.scalar).map_or("", |(name, _)| name);
        if self.list { format!("Vec<{name}>") } else { name.to_owned() }
    }

    /// Whether its values are text.
    pub fn is_text(self) -> bool {
        self.scalar == Scalar::Text
    }

    /// The value, if it is of this type. With `choices` a bare word serves as text, as it does for an enum.
    pub fn read<'de, D: Deserializer<'de>>(self, from: D, choices: bool) -> Result<Value, D::Error> {
        match self.scalar {
            Scalar::Bool => self.typed::<bool, D>(from),
            Scalar::U8 => self.typed::<u8, D>(from),
            Scalar::U16 => self.typed::<u16, D>(from),
            Scalar::U32 => self.typed::<u32, D>(from),
            Scalar::U64 => self.typed::<u64, D>(from),
            Scalar::I32 => self.typed::<i32, D>(from),
            Scalar::I64 => self.typed::<i64, D>(from),
            Scalar::F32 => self.typed::<f32, D>(from),
            Scalar::F64 => self.typed::<f64, D>(from),
            Scalar::Text if choices => match Value::deserialize(from)? {
                value if self.is_words(&value) => Ok(value),
                _ => Err(D::Error::custom(if self.list { "expected a list of words" } else { "expected one word" })),
            },
            Scalar::Text => self.typed::<String, D>(from),
        }
    }

    fn is_words(self, value: &Value) -> bool {
        match value {
            Value::Array(values) => self.list && values.iter().all(Value::is_string),
            value => !self.list && value.is_string(),
        }
    }

    fn typed<'de, T: DeserializeOwned + Serialize, D: Deserializer<'de>>(self, from: D) -> Result<Value, D::Error> {
        let value = if self.list {
            serde_json::to_value(Vec::<T>::deserialize(from)?)
        } else {
            serde_json::to_value(T::deserialize(from)?)
        };
        let value = value.map_err(D::Error::custom)?;
        // What JSON has no number for, such as 1e300 as f32, became null.
        let finite = match &value {
            Value::Array(values) => !values.iter().any(Value::is_null),
            value => !value.is_null(),
        };
        if finite { Ok(value) } else { Err(D::Error::custom(format!("it is too large for {}", self.show()))) }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn values_are_read_as_their_type_and_nothing_else() {
        let read = |name, list, value: Value| ParamForm::named(name, list).unwrap().read(value, false).ok();
        assert_eq!(read("f64", false, json!(3)), Some(json!(3.0)));
        assert_eq!(read("f32", false, json!(0.1)), Some(json!(f64::from(0.1f32))));
        assert_eq!(read("f32", false, json!(1e300)), None);
        assert_eq!(read("u8", false, json!(255)), Some(json!(255)));
        assert_eq!(read("u8", false, json!(256)), None);
        assert_eq!(read("u64", false, json!(-1)), None);
        assert_eq!(read("i64", true, json!([-1, 2])), Some(json!([-1, 2])));
        assert_eq!(read("i64", true, json!(-1)), None);
        assert_eq!(read("bool", false, json!(1)), None);
        assert_eq!(read("String", false, json!("x")), Some(json!("x")));
        assert_eq!(ParamForm::named("Rounding", false), None);
        let words = ParamForm::named("String", true).unwrap();
        assert_eq!(words.read(json!(["a"]), true).ok(), Some(json!(["a"])));
        assert_eq!(words.read(json!("a"), true).ok(), None);
    }
}
