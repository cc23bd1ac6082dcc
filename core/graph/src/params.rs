//! Parameters as struct fields whose doc comments are the manual.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// One parameter, as the manual and the checker see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParamDoc {
    /// Field name.
    pub name: &'static str,
    /// The field's doc comment; [`ParamDoc::text`] trims it.
    pub doc: &'static str,
    /// The field's Rust type.
    pub type_name: &'static str,
    /// Unit, when it has one (`s`, `px`, `bpm`).
    pub unit: Option<&'static str>,
    /// Least and greatest allowed number, inclusive; applies to each number of a list.
    pub range: Option<(f64, f64)>,
    /// Words allowed; empty when any.
    pub choices: &'static [&'static str],
    /// Whether it changes the output, and so is in the cache key.
    pub keyed: bool,
}

impl ParamDoc {
    /// A parameter with nothing but a name and a doc line.
    pub const fn new(name: &'static str, doc: &'static str, type_name: &'static str) -> Self {
        Self { name, doc, type_name, unit: None, range: None, choices: &[], keyed: true }
    }

    /// Adds a unit.
    pub const fn unit(self, unit: &'static str) -> Self {
        Self { unit: Some(unit), ..self }
    }

    /// Adds an inclusive range. Use `f64::INFINITY` for an open end.
    pub const fn range(self, least: f64, greatest: f64) -> Self {
        Self { range: Some((least, greatest)), ..self }
    }

    /// Adds the words allowed.
    pub const fn choices(self, choices: &'static [&'static str]) -> Self {
        Self { choices, ..self }
    }

    /// Marks it as not changing the output (thread counts, verbosity): it stays out of the cache key.
    pub const fn unkeyed(self) -> Self {
        Self { keyed: false, ..self }
    }

    /// A number as it was meant: an `f32` that became an `f64` on its way loses its false digits.
    pub fn show(number: f64) -> String {
        let short = number as f32;
        if f64::from(short) == number { short.to_string() } else { number.to_string() }
    }

    /// The doc comment as one trimmed paragraph.
    pub fn text(&self) -> String {
        self.doc.split_whitespace().collect::<Vec<_>>().join(" ")
    }
}

/// A struct whose fields are parameters. Made by [`crate::params!`].
pub trait Params: Serialize + DeserializeOwned + Default + Send + Sync + 'static {
    /// The struct's doc comment: what the node does.
    const DOC: &'static str;
    /// One entry a field, in the order of the fields.
    const PARAMS: &'static [ParamDoc];
}

/// Declares a node's parameters: a documented struct with a default for each field, and optionally `unit("s")`,
/// `range(0.0, 1.0)`, `choices(&["Cumulative", "Direct"])`, `unkeyed()`. Fields end in `;`.
///
/// Gives the struct (fields public) with `Clone`, `Debug`, `PartialEq`, `Default`, serde both ways (unknown fields
/// refused, absent ones defaulted) and [`Params`]. Enums among the fields derive serde, `Clone`, `Debug`, `PartialEq`.
#[macro_export]
macro_rules! params {
    (
        $(#[doc = $doc:literal])+
        $visibility:vis struct $node:ident {
            $(
                $(#[doc = $field_doc:literal])+
                $field:ident : $type:ty = $default:expr $(, $option:ident ( $($argument:expr),* ))* ;
            )*
        }
    ) => {
        $(#[doc = $doc])+
        #[derive(Clone, Debug, PartialEq, $crate::serde::Serialize, $crate::serde::Deserialize)]
        #[serde(crate = "heartian_graph::serde", default, deny_unknown_fields)]
        $visibility struct $node {
            $($(#[doc = $field_doc])+ pub $field: $type,)*
        }

        impl ::std::default::Default for $node {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $crate::Params for $node {
            const DOC: &'static str = ::std::concat!($($doc, "\n"),+);
            const PARAMS: &'static [$crate::ParamDoc] = &[
                $(
                    $crate::ParamDoc::new(
                        ::std::stringify!($field),
                        ::std::concat!($($field_doc, "\n"),+),
                        ::std::stringify!($type),
                    )
                    $(.$option($($argument),*))*,
                )*
            ];
        }
    };
}
