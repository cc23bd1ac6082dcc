//! A machine for the pickles that `torch.save` writes, and for nothing else.
//!
//! Objects live in an arena and refer to each other by index, so sharing costs nothing and nesting of any depth is
//! harmless. Only the globals of [`Global::named`] are known; any other name ends the reading, and nothing is ever called:
//! "reducing" one of them only records what the file says about a tensor. Every instruction is bounded by the bytes
//! it takes, and instructions by [`MOST_STEPS`].

use std::collections::HashMap;

use super::damaged;
use super::element::Element;
use crate::DecoderError;

/// Most instructions; a state dictionary of 500 tensors takes about 30,000.
const MOST_STEPS: usize = 1 << 20;

/// Index of an object in the arena.
type Id = usize;

/// The kinds of storage: floating, or integer of so many bytes (read past, never used).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Numbers with a fraction.
    Floating(Element),
    /// Whole numbers and truth values.
    Integer,
}

/// What the file says about one tensor; nothing is checked against its storage yet.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorRecord {
    /// What is stored.
    pub kind: Kind,
    /// Name of the storage's member in the archive.
    pub storage: String,
    /// Values in the storage.
    pub storage_len: usize,
    /// Index of the first value.
    pub offset: usize,
    /// Sizes.
    pub shape: Vec<usize>,
    /// Step along each axis, values.
    pub strides: Vec<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Global {
    OrderedDict,
    RebuildTensor,
    RebuildParameter,
    Storage(Kind),
}

impl Global {
    /// The allow-list.
    fn named(module: &str, name: &str) -> Option<Self> {
        let floating = |element| Some(Self::Storage(Kind::Floating(element)));
        match (module, name) {
            ("collections", "OrderedDict") => Some(Self::OrderedDict),
            ("torch._utils", "_rebuild_tensor_v2") => Some(Self::RebuildTensor),
            ("torch._utils", "_rebuild_parameter") => Some(Self::RebuildParameter),
            ("torch", "FloatStorage") => floating(Element::Single),
            ("torch", "DoubleStorage") => floating(Element::Double),
            ("torch", "HalfStorage") => floating(Element::Half),
            ("torch", "BFloat16Storage") => floating(Element::Brain),
            (
                "torch",
                "LongStorage" | "IntStorage" | "ShortStorage" | "CharStorage" | "ByteStorage" | "BoolStorage",
            ) => Some(Self::Storage(Kind::Integer)),
            _ => None,
        }
    }
}

#[derive(Debug)]
enum Object {
    /// None, truth values, floats: present in the file, of no use here.
    Other,
    Integer(i64),
    Text(String),
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dictionary(Vec<(Id, Id)>),
    Global(Global),
    Storage {
        kind: Kind,
        key: String,
        len: usize,
    },
    Tensor(Box<TensorRecord>),
}

/// Reads the names and tensors of a state dictionary, also one under `state_dict`, `model_state_dict` or `model`.
pub fn read(bytes: &[u8]) -> Result<Vec<(String, TensorRecord)>, DecoderError> {
    let mut machine =
        Machine { bytes, at: 0, arena: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() };
    let top = machine.run()?;
    let top = ["state_dict", "model_state_dict", "model"].iter().find_map(|key| machine.entry(top, key)).unwrap_or(top);
    let Object::Dictionary(items) = &machine.arena[top] else {
        return Err(damaged("its pickle holds no dictionary of tensors", "save the network's state_dict()"));
    };
    // Entries that are no tensors (an epoch number beside them) are passed over.
    Ok(items
        .iter()
        .filter_map(|(key, value)| match (&machine.arena[*key], &machine.arena[*value]) {
            (Object::Text(name), Object::Tensor(record)) => Some((name.clone(), (**record).clone())),
            _ => None,
        })
        .collect())
}

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    arena: Vec<Object>,
    stack: Vec<Id>,
    /// Heights of the stack at each open mark.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
}

impl<'a> Machine<'a> {
    fn run(&mut self) -> Result<Id, DecoderError> {
        for _ in 0..MOST_STEPS {
            let code = self.byte()?;
            if code == b'.' {
                return self.pop();
            }
            self.step(code)?;
        }
        Err(damaged("its pickle takes over a million steps", "give a file that holds a state dictionary"))
    }

    fn step(&mut self, code: u8) -> Result<(), DecoderError> {
        match code {
            0x80 => drop(self.byte()?),
            0x95 => drop(self.take(8)?),
            b'(' => self.marks.push(self.stack.len()),
            b'N' | 0x88 | 0x89 => self.push(Object::Other),
            b'G' => {
                self.take(8)?;
                self.push(Object::Other);
            }
            b'J' => {
                let value = i64::from(i32::from_le_bytes(self.array()?));
                self.push(Object::Integer(value));
            }
            b'K' => {
                let value = i64::from(self.byte()?);
                self.push(Object::Integer(value));
            }
            b'M' => {
                let value = i64::from(u16::from_le_bytes(self.array()?));
                self.push(Object::Integer(value));
            }
            0x8a => self.long()?,
            b'X' | b'T' => {
                let len = u32::from_le_bytes(self.array()?) as usize;
                self.text(len)?;
            }
            0x8c | b'U' => {
                let len = usize::from(self.byte()?);
                self.text(len)?;
            }
            b'q' | b'r' | 0x94 | b'h' | b'j' => self.remember(code)?,
            b'}' => self.push(Object::Dictionary(Vec::new())),
            b']' => self.push(Object::List(Vec::new())),
            b')' => self.push(Object::Tuple(Vec::new())),
            b't' | 0x85 | 0x86 | 0x87 => self.tuple(code)?,
            b'a' | b'e' | b's' | b'u' => self.fill(code)?,
            b'c' | 0x93 => self.global(code)?,
            b'Q' => self.storage()?,
            b'R' => self.reduce()?,
            b'b' => self.build()?,
            _ => return Err(self.wrong(&format!("the instruction {code:#04x} that no weight file needs"))),
        }
        Ok(())
    }

    fn wrong(&self, what: &str) -> DecoderError {
        damaged(
            &format!("its pickle has {what} near byte {}", self.at),
            "only plain tensors are read, nothing is executed; save the network's state_dict()",
        )
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], DecoderError> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let taken = rest.get(..count).ok_or_else(|| damaged("its pickle is cut short", "copy or download it again"))?;
        self.at += count;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, DecoderError> {
        Ok(self.take(1)?[0])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecoderError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn push(&mut self, object: Object) {
        self.stack.push(self.arena.len());
        self.arena.push(object);
    }

    fn pop(&mut self) -> Result<Id, DecoderError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(self.wrong("an instruction without its operand"));
        }
        self.stack.pop().ok_or_else(|| self.wrong("an instruction without its operand"))
    }

    /// What was pushed since the last mark.
    fn pop_marked(&mut self) -> Result<Vec<Id>, DecoderError> {
        let mark = self.marks.pop().ok_or_else(|| self.wrong("an instruction without its mark"))?;
        Ok(self.stack.split_off(mark))
    }

    fn long(&mut self) -> Result<(), DecoderError> {
        let len = usize::from(self.byte()?);
        let bytes = self.take(len)?;
        if len > 8 {
            return Err(self.wrong("a whole number of more than 64 bits"));
        }
        let negative = bytes.last().is_some_and(|byte| byte >> 7 == 1);
        let mut wide = [if negative { 0xff } else { 0 }; 8];
        wide[..len].copy_from_slice(bytes);
        self.push(Object::Integer(i64::from_le_bytes(wide)));
        Ok(())
    }

    fn text(&mut self, len: usize) -> Result<(), DecoderError> {
        let bytes = self.take(len)?;
        let text = std::str::from_utf8(bytes).map_err(|_| self.wrong("a text that is not UTF-8"))?;
        self.push(Object::Text(text.to_owned()));
        Ok(())
    }

    /// Stores the top of the stack under a number, or fetches what was stored.
    fn remember(&mut self, code: u8) -> Result<(), DecoderError> {
        let slot = match code {
            b'q' | b'h' => u32::from(self.byte()?),
            0x94 => self.memo.len() as u32,
            _ => u32::from_le_bytes(self.array()?),
        };
        if matches!(code, b'h' | b'j') {
            let id = self.memo.get(&slot).copied().ok_or_else(|| self.wrong("a reference to nothing"))?;
            self.stack.push(id);
        } else {
            let id = self.stack.last().copied().ok_or_else(|| self.wrong("an instruction without its operand"))?;
            self.memo.insert(slot, id);
        }
        Ok(())
    }

    fn tuple(&mut self, code: u8) -> Result<(), DecoderError> {
        let items = if code == b't' {
            self.pop_marked()?
        } else {
            let mut items = Vec::new();
            for _ in 0..code - 0x84 {
                items.push(self.pop()?);
            }
            items.reverse();
            items
        };
        self.push(Object::Tuple(items));
        Ok(())
    }

    /// Appends to a list, or sets entries of a dictionary.
    fn fill(&mut self, code: u8) -> Result<(), DecoderError> {
        let items = match code {
            b'a' => vec![self.pop()?],
            b's' => {
                let value = self.pop()?;
                vec![self.pop()?, value]
            }
            _ => self.pop_marked()?,
        };
        let target = self.stack.last().copied().ok_or_else(|| self.wrong("an instruction without its operand"))?;
        match (&mut self.arena[target], code) {
            (Object::List(list), b'a' | b'e') => list.extend(items),
            (Object::Dictionary(entries), b's' | b'u') if items.len().is_multiple_of(2) => {
                entries.extend(items.as_chunks().0.iter().map(|[key, value]| (*key, *value)));
            }
            _ => return Err(self.wrong("entries for something that takes none")),
        }
        Ok(())
    }

    fn global(&mut self, code: u8) -> Result<(), DecoderError> {
        let (module, name) = if code == b'c' {
            (self.line()?, self.line()?)
        } else {
            let name = self.pop()?;
            let module = self.pop()?;
            match (&self.arena[module], &self.arena[name]) {
                (Object::Text(module), Object::Text(name)) => (module.clone(), name.clone()),
                _ => return Err(self.wrong("a name that is no text")),
            }
        };
        let global = Global::named(&module, &name).ok_or_else(|| {
            let shown: String = format!("{module}.{name}").chars().take(80).collect();
            self.wrong(&format!("the name `{}`, which is not on the list of tensor parts,", shown.escape_debug()))
        })?;
        self.push(Object::Global(global));
        Ok(())
    }

    fn line(&mut self) -> Result<String, DecoderError> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let end = rest.iter().take(256).position(|byte| *byte == b'\n');
        let end = end.ok_or_else(|| self.wrong("a name without an end"))?;
        self.at += end + 1;
        Ok(String::from_utf8_lossy(&rest[..end]).into_owned())
    }

    /// `('storage', storage class, key, device, length)`.
    fn storage(&mut self) -> Result<(), DecoderError> {
        let id = self.pop()?;
        let found = match &self.arena[id] {
            Object::Tuple(items) => match items[..] {
                [_, class, key, _, len] => match (&self.arena[class], &self.arena[key], self.size(len)) {
                    (Object::Global(Global::Storage(kind)), Object::Text(key), Some(len)) => {
                        Some(Object::Storage { kind: *kind, key: key.clone(), len })
                    }
                    _ => None,
                },
                _ => None,
            },
            _ => None,
        };
        let found = found.ok_or_else(|| self.wrong("a storage it does not describe"))?;
        self.push(found);
        Ok(())
    }

    fn reduce(&mut self) -> Result<(), DecoderError> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let (Object::Global(function), Object::Tuple(arguments)) = (&self.arena[function], &self.arena[arguments])
        else {
            return Err(self.wrong("a call of something that is no function"));
        };
        let made = match function {
            Global::OrderedDict if arguments.is_empty() => Some(Object::Dictionary(Vec::new())),
            Global::RebuildTensor => self.tensor(arguments),
            Global::RebuildParameter => arguments.first().and_then(|id| match &self.arena[*id] {
                Object::Tensor(record) => Some(Object::Tensor(record.clone())),
                _ => None,
            }),
            _ => None,
        };
        let made = made.ok_or_else(|| self.wrong("a tensor it does not describe"))?;
        self.push(made);
        Ok(())
    }

    /// `(storage, offset, sizes, strides, …)`.
    fn tensor(&self, arguments: &[Id]) -> Option<Object> {
        let [storage, offset, shape, strides, ..] = *arguments else { return None };
        let Object::Storage { kind, key, len } = &self.arena[storage] else { return None };
        let sizes = |id: Id| match &self.arena[id] {
            Object::Tuple(items) if items.len() <= 8 => items.iter().map(|item| self.size(*item)).collect(),
            _ => None,
        };
        let (shape, strides): (Vec<usize>, Vec<usize>) = (sizes(shape)?, sizes(strides)?);
        let offset = self.size(offset)?;
        (shape.len() == strides.len()).then(|| {
            Object::Tensor(Box::new(TensorRecord {
                kind: *kind,
                storage: key.clone(),
                storage_len: *len,
                offset,
                shape,
                strides,
            }))
        })
    }

    /// Attributes of a dictionary (its metadata) are passed over; nothing else here has any.
    fn build(&mut self) -> Result<(), DecoderError> {
        self.pop()?;
        match self.stack.last().map(|id| &self.arena[*id]) {
            Some(Object::Dictionary(_)) => Ok(()),
            _ => Err(self.wrong("attributes for something that takes none")),
        }
    }

    fn size(&self, id: Id) -> Option<usize> {
        match self.arena[id] {
            Object::Integer(value) => usize::try_from(value).ok(),
            _ => None,
        }
    }

    fn entry(&self, id: Id, key: &str) -> Option<Id> {
        let Object::Dictionary(items) = &self.arena[id] else { return None };
        let named = |(name, value): &(Id, Id)| {
            let is_key = matches!(&self.arena[*name], Object::Text(text) if text == key);
            (is_key && matches!(self.arena[*value], Object::Dictionary(_))).then_some(*value)
        };
        items.iter().find_map(named)
    }
}
