//! Parameters as struct fields whose doc comments are the manual that `heartian nodes KIND` prints.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// A type that a parameter may have: truth values, numbers, text, and lists of them.
pub trait ParamType: Serialize + DeserializeOwned {
    /// Its name, or that of an element of the list.
    const NAME: &'static str;
    /// Whether it is a list.
    const LIST: bool = false;
}

macro_rules! param_type {
    ($($type:ty: $name:literal),*) => {
        $(impl ParamType for $type {
            const NAME: &'static str = $name;
        })*
    };
}
param_type!(bool: "bool", u8: "u8", u16: "u16", u32: "u32", u64: "u64", i32: "i32", i64: "i64", f32: "f32", f64: "f64",
    String: "String");

impl<T: ParamType> ParamType for Vec<T> {
    const NAME: &'static str = T::NAME;
    const LIST: bool = {
        assert!(!T::LIST, "a parameter may be a list, but not a list of lists");
        true
    };
}

/// One parameter, as the manual and the checker see it.
#[derive(Clone, Copy, Debug)]
pub struct ParamDoc {
    name: &'static str,
    doc: &'static str,
    type_name: &'static str,
    list: bool,
    unit: Option<&'static str>,
    range: Option<(f64, f64)>,
    choices: &'static [&'static str],
    keyed: bool,
    file: bool,
}

impl ParamDoc {
    /// A parameter of type `T` with nothing but a name and a doc line.
    pub const fn new<T: ParamType>(name: &'static str, doc: &'static str) -> Self {
        let (type_name, list) = (T::NAME, T::LIST);
        Self { name, doc, type_name, list, unit: None, range: None, choices: &[], keyed: true, file: false }
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

    /// Marks it as the path of a file or folder that the node reads: its content enters the cache key.
    pub const fn file(self) -> Self {
        Self { file: true, ..self }
    }

    /// Its entry in the library's description.
    pub(crate) fn describe(&self, default: &Value) -> Value {
        let finite = |bound: f64| bound.is_finite().then_some(bound);
        json!({
            "name": self.name,
            "doc": self.doc.split_whitespace().collect::<Vec<_>>().join(" "),
            "type": self.type_name,
            "list": self.list,
            "default": default,
            "unit": self.unit,
            "least": self.range.and_then(|(least, _)| finite(least)),
            "greatest": self.range.and_then(|(_, greatest)| finite(greatest)),
            "choices": self.choices,
            "keyed": self.keyed,
            "file": self.file,
        })
    }

    /// The name.
    pub(crate) fn name(&self) -> &'static str {
        self.name
    }
}

/// A struct whose fields are parameters. Made by [`crate::params!`].
pub trait Params: Serialize + DeserializeOwned + Default {
    /// The struct's doc comment: what the node does.
    const DOC: &'static str;
    /// One entry a field, in the order of the fields.
    const PARAMS: &'static [ParamDoc];
}

/// Declares a node's parameters: a documented struct with a default for each field, and optionally `unit("s")`,
/// `range(0.0, 1.0)`, `choices(&["Mean", "Median"])`, `unkeyed()`, `file()`. Fields end in `;`.
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
        #[serde(crate = "heartian_plugin::serde", default, deny_unknown_fields)]
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
                    $crate::ParamDoc::new::<$type>(::std::stringify!($field), ::std::concat!($($field_doc, "\n"),+))
                    $(.$option($($argument),*))*,
                )*
            ];
        }
    };
}
