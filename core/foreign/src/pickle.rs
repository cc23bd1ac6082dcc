//! A pickle replayed as plain objects (protocols 2 to 5).
//!
//! Objects live in an arena and refer to each other by index, so sharing costs nothing and nesting or rings of any depth
//! are harmless. Only names that the caller allows are known; any other ends the reading, and nothing is ever called:
//! what a pickle asks to be made is kept as [`Object::Made`], for the caller to make sense of. Every instruction is
//! bounded by the bytes it takes, and instructions by [`MOST_STEPS`].

mod machine;

use std::borrow::Cow;

use crate::ForeignError;
use machine::Machine;

/// Most instructions; a state dictionary of 500 tensors takes about 30,000, a head model a few hundred.
const MOST_STEPS: usize = 1 << 20;

/// Index of an object in its pickle.
pub type Id = usize;

/// One object; texts and bytes are borrowed from the file.
#[derive(Clone, Debug, PartialEq)]
pub enum Object<'a> {
    /// Python's `None`.
    None,
    /// A truth value.
    Truth(bool),
    /// A whole number of at most 64 bits.
    Integer(i64),
    /// A number with a fraction.
    Float(f64),
    /// A text.
    Text(&'a str),
    /// Bytes, or a text of Python 2.
    Bytes(&'a [u8]),
    /// A tuple.
    Tuple(Vec<Id>),
    /// A list or set.
    List(Vec<Id>),
    /// A dictionary in the order it was filled; a key may come twice, the last one counts.
    Dictionary(Vec<(Id, Id)>),
    /// A class or function by module and name; one of those allowed.
    Global(&'a str, &'a str),
    /// Something kept outside the pickle, by what names it.
    Persistent(Id),
    /// What calling a global with these arguments would have made, and the state set on it.
    Made {
        /// The class or function, always a [`Object::Global`].
        global: Id,
        /// Its arguments, always a [`Object::Tuple`].
        arguments: Id,
        /// What was built into it.
        state: Option<Id>,
    },
}

/// A pickle's objects.
#[derive(Debug)]
pub struct Pickle<'a> {
    objects: Vec<Object<'a>>,
    top: Id,
}

impl<'a> Pickle<'a> {
    /// Replays a pickle; `allowed` says which (module, name) may occur. What follows its end is ignored.
    ///
    /// # Errors
    /// When it is cut short, contradicts itself, takes too many steps, or names anything that is not allowed.
    pub fn read(bytes: &'a [u8], allowed: &dyn Fn(&str, &str) -> bool) -> Result<Self, ForeignError> {
        let mut machine = Machine::new(bytes, allowed);
        let top = machine.run(MOST_STEPS)?;
        Ok(Self { objects: machine.into_objects(), top })
    }

    /// The object that was pickled.
    pub fn top(&self) -> Id {
        self.top
    }

    /// An object.
    pub fn get(&self, id: Id) -> &Object<'a> {
        &self.objects[id]
    }

    /// A text, of either Python; `None` for anything else.
    pub fn text(&self, id: Id) -> Option<&'a str> {
        match self.objects[id] {
            Object::Text(text) => Some(text),
            Object::Bytes(bytes) => std::str::from_utf8(bytes).ok(),
            _ => None,
        }
    }

    /// Bytes, also as Python 3 writes them in protocol 2 (a Latin-1 text to be encoded); `None` for anything else.
    pub fn bytes(&self, id: Id) -> Option<Cow<'a, [u8]>> {
        match &self.objects[id] {
            Object::Bytes(bytes) => Some(Cow::Borrowed(bytes)),
            Object::Made { global, arguments, .. } if self.is_global(*global, "_codecs", "encode") => {
                let [text, ..] = self.items(*arguments)?[..] else { return None };
                let Object::Text(text) = self.objects[text] else { return None };
                text.chars().map(|c| u8::try_from(u32::from(c)).ok()).collect::<Option<Vec<u8>>>().map(Cow::Owned)
            }
            _ => None,
        }
    }

    /// A whole number or truth value.
    pub fn integer(&self, id: Id) -> Option<i64> {
        match self.objects[id] {
            Object::Integer(value) => Some(value),
            Object::Truth(value) => Some(i64::from(value)),
            _ => None,
        }
    }

    /// A size or index.
    pub fn size(&self, id: Id) -> Option<usize> {
        self.integer(id).and_then(|value| usize::try_from(value).ok())
    }

    /// Items of a tuple or list.
    pub fn items(&self, id: Id) -> Option<&[Id]> {
        match &self.objects[id] {
            Object::Tuple(items) | Object::List(items) => Some(items),
            _ => None,
        }
    }

    /// Entries of a dictionary.
    pub fn entries(&self, id: Id) -> Option<&[(Id, Id)]> {
        match &self.objects[id] {
            Object::Dictionary(entries) => Some(entries),
            _ => None,
        }
    }

    /// A dictionary's value by name.
    pub fn entry(&self, id: Id, key: &str) -> Option<Id> {
        self.entries(id)?.iter().rev().find(|(name, _)| self.text(*name) == Some(key)).map(|(_, value)| *value)
    }

    /// Whether an object is this global.
    pub fn is_global(&self, id: Id, module: &str, name: &str) -> bool {
        self.objects[id] == Object::Global(module, name)
    }
}
