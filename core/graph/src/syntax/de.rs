//! Tree to any serde type, with the place of what does not fit.
//!
//! Lenient where a person writing a parameter would expect it: integers serve as floats, `Some(..)` may be left out,
//! an enum's variant may be quoted.

use std::fmt;

use serde::de::value::StrDeserializer;
use serde::de::{
    DeserializeSeed, Deserializer, EnumAccess, Error, IntoDeserializer, MapAccess, SeqAccess, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;

use super::{Name, Span, Spanned, Tree};

/// What does not fit, and where (unless it is about the whole).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DeError {
    pub span: Option<Span>,
    pub message: String,
    /// The words that would do, when one of a few was expected.
    pub words: &'static [&'static str],
}

impl fmt::Display for DeError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.message)
    }
}

impl std::error::Error for DeError {}

impl Error for DeError {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self { span: None, message: message.to_string(), words: &[] }
    }
}

impl DeError {
    fn or_at(mut self, span: Span) -> Self {
        self.span = self.span.or(Some(span));
        self
    }
}

/// Named values from several places, as one struct.
pub(crate) struct Fields<'a>(pub &'a [(&'a str, &'a Spanned)]);

impl<'de> Deserializer<'de> for &'de Spanned {
    type Error = DeError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DeError> {
        let visited = match &self.tree {
            Tree::Bool(value) => visitor.visit_bool(*value),
            Tree::Integer(value) => match (u64::try_from(*value), i64::try_from(*value)) {
                (Ok(value), _) => visitor.visit_u64(value),
                (_, Ok(value)) => visitor.visit_i64(value),
                _ => visitor.visit_i128(*value),
            },
            Tree::Float(value) => visitor.visit_f64(*value),
            Tree::Char(value) => visitor.visit_char(*value),
            Tree::Text(text) | Tree::Word(text) => visitor.visit_borrowed_str(text),
            Tree::Reference(name) => Err(DeError::custom(format!("`${name}` has no value here"))),
            Tree::List(items) => visitor.visit_seq(Items(items.iter())),
            Tree::Tuple { items, .. } if items.is_empty() => visitor.visit_unit(),
            Tree::Tuple { items, .. } => visitor.visit_seq(Items(items.iter())),
            Tree::Map(pairs) => visitor.visit_map(Pairs { pairs: pairs.iter(), value: None }),
            Tree::Struct { fields, .. } => visitor.visit_map(StructFields { fields: fields.iter(), value: None }),
        };
        visited.map_err(|error| error.or_at(self.span))
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DeError> {
        match &self.tree {
            Tree::Word(word) if word == "None" => visitor.visit_none(),
            Tree::Tuple { name: Some(Name { text, .. }), items } if text == "Some" && items.len() == 1 => {
                visitor.visit_some(&items[0])
            }
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DeError> {
        match &self.tree {
            Tree::Word(word) => {
                let message = format!("expected a string, found the bare word `{word}`; write \"{word}\"");
                Err(DeError::custom(message).or_at(self.span))
            }
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DeError> {
        self.deserialize_string(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, DeError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DeError> {
        match &self.tree {
            Tree::Tuple { items, .. } => visitor.visit_seq(Items(items.iter())).map_err(|error| error.or_at(self.span)),
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, DeError> {
        match &self.tree {
            Tree::List(items) | Tree::Tuple { items, .. } if items.len() != length => {
                let message = format!("expected {length} values, found {}", items.len());
                Err(DeError::custom(message).or_at(self.span))
            }
            _ => self.deserialize_seq(visitor),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, DeError> {
        let visited = match &self.tree {
            Tree::Word(word) | Tree::Text(word) => visitor.visit_enum(word.as_str().into_deserializer()),
            Tree::Tuple { name: Some(name), .. } | Tree::Struct { name: Some(name), .. } => {
                visitor.visit_enum(Variant { name, content: self, variants })
            }
            other => Err(DeError::custom(format!("expected one word, found {}", other.describe()))),
        };
        visited.map_err(|error: DeError| {
            // An error with a place is about what stands inside the variant.
            let words = if error.span.is_none() { variants } else { error.words };
            DeError { words, ..error.or_at(self.span) }
        })
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char bytes byte_buf unit unit_struct tuple_struct map
        struct identifier ignored_any
    }
}

impl<'de> Deserializer<'de> for Fields<'de> {
    type Error = DeError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DeError> {
        visitor.visit_map(NamedFields { fields: self.0.iter(), value: None })
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

struct Items<'de>(std::slice::Iter<'de, Spanned>);

impl<'de> SeqAccess<'de> for Items<'de> {
    type Error = DeError;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, DeError> {
        self.0.next().map(|item| seed.deserialize(item)).transpose()
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.0.len())
    }
}

struct Pairs<'de> {
    pairs: std::slice::Iter<'de, (Spanned, Spanned)>,
    value: Option<&'de Spanned>,
}

impl<'de> MapAccess<'de> for Pairs<'de> {
    type Error = DeError;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, DeError> {
        let Some((key, value)) = self.pairs.next() else { return Ok(None) };
        self.value = Some(value);
        seed.deserialize(key).map(Some)
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, DeError> {
        seed.deserialize(self.value.take().ok_or_else(|| DeError::custom("a value was asked for before its key"))?)
    }
}

/// Fields by name; `N` is how a field's name and value are stored.
struct FieldsOf<'de, I> {
    fields: I,
    value: Option<&'de Spanned>,
}

type StructFields<'de> = FieldsOf<'de, std::slice::Iter<'de, (Name, Spanned)>>;
type NamedFields<'de> = FieldsOf<'de, std::slice::Iter<'de, (&'de str, &'de Spanned)>>;

/// A stored field, seen as name and value.
trait Field<'de> {
    fn parts(self) -> (&'de str, &'de Spanned);
}

impl<'de> Field<'de> for &'de (Name, Spanned) {
    fn parts(self) -> (&'de str, &'de Spanned) {
        (&self.0.text, &self.1)
    }
}

impl<'de> Field<'de> for &'de (&'de str, &'de Spanned) {
    fn parts(self) -> (&'de str, &'de Spanned) {
        *self
    }
}

impl<'de, I> MapAccess<'de> for FieldsOf<'de, I>
where
    I: Iterator,
    I::Item: Field<'de>,
{
    type Error = DeError;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, DeError> {
        let Some((name, value)) = self.fields.next().map(Field::parts) else { return Ok(None) };
        self.value = Some(value);
        let name: StrDeserializer<'_, DeError> = name.into_deserializer();
        seed.deserialize(name).map(Some).map_err(|error: DeError| error.or_at(value.span))
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, DeError> {
        seed.deserialize(self.value.take().ok_or_else(|| DeError::custom("a value was asked for before its key"))?)
    }
}

struct Variant<'de> {
    name: &'de Name,
    content: &'de Spanned,
    variants: &'static [&'static str],
}

impl<'de> EnumAccess<'de> for Variant<'de> {
    type Error = DeError;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), DeError> {
        let name: StrDeserializer<'_, DeError> = self.name.text.as_str().into_deserializer();
        let unknown = |error: DeError| DeError { words: self.variants, ..error.or_at(self.name.span) };
        Ok((seed.deserialize(name).map_err(unknown)?, self))
    }
}

impl<'de> VariantAccess<'de> for Variant<'de> {
    type Error = DeError;

    fn unit_variant(self) -> Result<(), DeError> {
        Err(DeError::custom(format!("`{}` takes no values", self.name.text)))
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, DeError> {
        match &self.content.tree {
            Tree::Tuple { items, .. } if items.len() == 1 => seed.deserialize(&items[0]),
            _ => Err(DeError::custom(format!("`{}` takes one value", self.name.text))),
        }
    }

    fn tuple_variant<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, DeError> {
        self.content.deserialize_tuple(length, visitor)
    }

    fn struct_variant<V: Visitor<'de>>(self, _: &'static [&'static str], visitor: V) -> Result<V::Value, DeError> {
        self.content.deserialize_any(visitor)
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde::{Deserialize, Serialize};

    use super::super::read;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    enum Mode {
        Cumulative,
        Blend(f64),
        Window { low: f32, high: f32 },
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Everything {
        a: i8,
        b: u64,
        c: f64,
        d: Option<String>,
        e: Vec<(u32, f32)>,
        f: [f64; 2],
        g: Mode,
        h: Vec<Mode>,
        i: char,
        j: bool,
        k: std::collections::BTreeMap<String, Option<i32>>,
        l: (),
    }

    fn everything() -> Everything {
        Everything {
            a: -3,
            b: u64::MAX,
            c: 1e-7,
            d: Some("x \"y\"\n\u{e9}".into()),
            e: vec![(1, 0.5), (2, -1.5)],
            f: [0.0, -2.5],
            g: Mode::Window { low: 0.75, high: 3.0 },
            h: vec![Mode::Cumulative, Mode::Blend(2.0)],
            i: '\'',
            j: true,
            k: [("p".into(), None), ("q".into(), Some(4))].into(),
            l: (),
        }
    }

    #[test]
    fn what_the_ron_crate_writes_is_read_back_equal() {
        let value = everything();
        for text in [
            ron::to_string(&value).unwrap(),
            ron::ser::to_string_pretty(&value, ron::ser::PrettyConfig::new().struct_names(true)).unwrap(),
        ] {
            assert_eq!(Everything::deserialize(&read(&text).unwrap()).unwrap(), value, "{text}");
        }
    }

    #[test]
    fn misfits_are_placed() {
        let text = "(low: 1, high: [2, \"three\"])";
        #[derive(Debug, Deserialize)]
        #[expect(dead_code, reason = "only read")]
        struct Pair {
            low: f64,
            high: [f64; 2],
        }
        let error = Pair::deserialize(&read(text).unwrap()).unwrap_err();
        let span = error.span.unwrap();
        assert_eq!(&text[span.start..span.end], "\"three\"");
        assert!(error.message.contains("expected f64"), "{error}");
        assert!(Pair::deserialize(&read("(low: 1, high: (1, 2, 3))").unwrap()).unwrap_err().message.contains("3"));
    }
}
