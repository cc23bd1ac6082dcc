//! RON text as a tree whose every part knows where it stands.
//!
//! The subset of RON that data files use: scalars, strings, lists, maps, tuples, named and unnamed structs, comments.
//! Reading is bounded in depth and never panics, whatever the bytes.

mod de;
mod reader;

pub(crate) use de::{DeError, Fields};
pub(crate) use reader::{SyntaxError, read, read_prefixed};

/// Byte range in a source text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// First byte.
    pub start: usize,
    /// One past the last byte.
    pub end: usize,
}

/// A value and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Spanned {
    pub span: Span,
    pub tree: Tree,
}

/// A name and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Name {
    pub span: Span,
    pub text: String,
}

/// RON values. `name` is the word before the parenthesis, as in `Some(3)`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Tree {
    Bool(bool),
    Integer(i128),
    Float(f64),
    Char(char),
    Text(String),
    /// A lone word: an enum variant or `None`.
    Word(String),
    List(Vec<Spanned>),
    Map(Vec<(Spanned, Spanned)>),
    Tuple {
        name: Option<Name>,
        items: Vec<Spanned>,
    },
    Struct {
        name: Option<Name>,
        fields: Vec<(Name, Spanned)>,
    },
}

impl Tree {
    /// What it is, for error messages.
    pub fn describe(&self) -> &'static str {
        match self {
            Self::Bool(_) => "a truth value",
            Self::Integer(_) | Self::Float(_) => "a number",
            Self::Char(_) => "a character",
            Self::Text(_) => "a string",
            Self::Word(_) => "a bare word",
            Self::List(_) => "a list",
            Self::Map(_) => "a map",
            Self::Tuple { .. } => "a tuple",
            Self::Struct { .. } => "a struct",
        }
    }
}

impl Spanned {
    /// The first number in it that is not finite.
    pub fn non_finite(&self) -> Option<&Self> {
        match &self.tree {
            Tree::Float(value) if !value.is_finite() => Some(self),
            Tree::List(items) | Tree::Tuple { items, .. } => items.iter().find_map(Self::non_finite),
            Tree::Struct { fields, .. } => fields.iter().find_map(|(_, value)| value.non_finite()),
            Tree::Map(pairs) => pairs.iter().find_map(|(key, value)| key.non_finite().or(value.non_finite())),
            _ => None,
        }
    }
}
