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
    /// `$name`: stands for a graph's parameter, or for its input where a wire is expected.
    Reference(String),
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
            Self::Reference(_) => "a reference",
            Self::List(_) => "a list",
            Self::Map(_) => "a map",
            Self::Tuple { .. } => "a tuple",
            Self::Struct { .. } => "a struct",
        }
    }
}

impl Spanned {
    /// The name that this whole value refers to: `$name`, or `"$name"` for editors that know only plain RON.
    pub fn reference(&self) -> Option<&str> {
        match &self.tree {
            Tree::Reference(name) => Some(name),
            Tree::Text(text) => text.strip_prefix('$').filter(|name| is_name(name)),
            _ => None,
        }
    }

    /// Values directly inside it.
    pub fn children(&self) -> Box<dyn Iterator<Item = &Self> + '_> {
        match &self.tree {
            Tree::List(items) | Tree::Tuple { items, .. } => Box::new(items.iter()),
            Tree::Struct { fields, .. } => Box::new(fields.iter().map(|(_, value)| value)),
            Tree::Map(pairs) => Box::new(pairs.iter().flat_map(|(key, value)| [key, value])),
            _ => Box::new(std::iter::empty()),
        }
    }

    /// The same, to be changed.
    pub fn children_mut(&mut self) -> Box<dyn Iterator<Item = &mut Self> + '_> {
        match &mut self.tree {
            Tree::List(items) | Tree::Tuple { items, .. } => Box::new(items.iter_mut()),
            Tree::Struct { fields, .. } => Box::new(fields.iter_mut().map(|(_, value)| value)),
            Tree::Map(pairs) => Box::new(pairs.iter_mut().flat_map(|(key, value)| [key, value])),
            _ => Box::new(std::iter::empty()),
        }
    }

    /// The first number in it that is not finite.
    pub fn non_finite(&self) -> Option<&Self> {
        match &self.tree {
            Tree::Float(value) if !value.is_finite() => Some(self),
            _ => self.children().find_map(Self::non_finite),
        }
    }
}

/// Whether a word can stand after `$`.
pub(crate) fn is_name(word: &str) -> bool {
    let first = |c: char| c.is_ascii_alphabetic() || c == '_';
    word.starts_with(first) && word.chars().all(|c| first(c) || c.is_ascii_digit())
}
