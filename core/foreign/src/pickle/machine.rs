//! The stack machine behind [`super::Pickle`]: one instruction at a time, nothing called, everything bounded.

use std::collections::HashMap;

use super::{Id, Object};
use crate::ForeignError;

/// State of the replay.
pub(super) struct Machine<'a, 'b> {
    bytes: &'a [u8],
    at: usize,
    objects: Vec<Object<'a>>,
    stack: Vec<Id>,
    /// Heights of the stack at each open mark.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
    allowed: &'b dyn Fn(&str, &str) -> bool,
}

impl<'a, 'b> Machine<'a, 'b> {
    pub fn new(bytes: &'a [u8], allowed: &'b dyn Fn(&str, &str) -> bool) -> Self {
        let memo = HashMap::new();
        Self { bytes, at: 0, objects: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo, allowed }
    }

    pub fn run(&mut self, most_steps: usize) -> Result<Id, ForeignError> {
        for _ in 0..most_steps {
            let code = self.byte()?;
            if code == b'.' {
                return self.pop();
            }
            self.step(code)?;
        }
        Err(ForeignError::too_large("its pickle takes over a million steps"))
    }

    pub fn into_objects(self) -> Vec<Object<'a>> {
        self.objects
    }

    fn step(&mut self, code: u8) -> Result<(), ForeignError> {
        match code {
            0x80 => drop(self.byte()?),
            0x95 => drop(self.take(8)?),
            b'(' => self.marks.push(self.stack.len()),
            b'N' => self.push(Object::None),
            0x88 | 0x89 => self.push(Object::Truth(code == 0x88)),
            b'G' => {
                let value = f64::from_be_bytes(self.array()?);
                self.push(Object::Float(value));
            }
            b'J' | b'K' | b'M' | 0x8a => self.integer(code)?,
            b'X' | 0x8c | 0x8d => {
                let bytes = self.counted(code)?;
                let text = std::str::from_utf8(bytes).map_err(|_| self.wrong("a text that is not UTF-8"))?;
                self.push(Object::Text(text));
            }
            b'T' | b'U' | b'B' | b'C' | 0x8e => {
                let bytes = self.counted(code)?;
                self.push(Object::Bytes(bytes));
            }
            b'q' | b'r' | 0x94 | b'h' | b'j' => self.remember(code)?,
            b'}' => self.push(Object::Dictionary(Vec::new())),
            b']' | 0x8f => self.push(Object::List(Vec::new())),
            b')' => self.push(Object::Tuple(Vec::new())),
            b't' | 0x85 | 0x86 | 0x87 => self.tuple(code)?,
            b'a' | b'e' | b's' | b'u' | 0x90 => self.fill(code)?,
            b'c' | 0x93 => self.global(code)?,
            b'Q' => {
                let id = self.pop()?;
                self.push(Object::Persistent(id));
            }
            b'R' | 0x81 => self.make()?,
            b'b' => self.build()?,
            _ => return Err(self.wrong(&format!("the instruction {code:#04x} that no file of arrays needs"))),
        }
        Ok(())
    }

    fn wrong(&self, what: &str) -> ForeignError {
        ForeignError::refused(format!("its pickle has {what} near byte {}", self.at))
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], ForeignError> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let taken = rest.get(..count).ok_or_else(|| ForeignError::damaged("its pickle is cut short"))?;
        self.at += count;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, ForeignError> {
        Ok(self.take(1)?[0])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], ForeignError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// Bytes behind their own length of 1, 4 or 8 bytes.
    fn counted(&mut self, code: u8) -> Result<&'a [u8], ForeignError> {
        let len = match code {
            b'U' | b'C' | 0x8c => usize::from(self.byte()?),
            0x8d | 0x8e => usize::try_from(u64::from_le_bytes(self.array()?)).unwrap_or(usize::MAX),
            _ => u32::from_le_bytes(self.array()?) as usize,
        };
        self.take(len)
    }

    fn push(&mut self, object: Object<'a>) {
        self.stack.push(self.objects.len());
        self.objects.push(object);
    }

    fn pop(&mut self) -> Result<Id, ForeignError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(self.wrong("an instruction without its operand"));
        }
        self.stack.pop().ok_or_else(|| self.wrong("an instruction without its operand"))
    }

    fn last(&self) -> Result<Id, ForeignError> {
        self.stack.last().copied().ok_or_else(|| self.wrong("an instruction without its operand"))
    }

    /// What was pushed since the last mark.
    fn pop_marked(&mut self) -> Result<Vec<Id>, ForeignError> {
        let mark = self.marks.pop().ok_or_else(|| self.wrong("an instruction without its mark"))?;
        Ok(self.stack.split_off(mark))
    }

    fn integer(&mut self, code: u8) -> Result<(), ForeignError> {
        let value = match code {
            b'J' => i64::from(i32::from_le_bytes(self.array()?)),
            b'K' => i64::from(self.byte()?),
            b'M' => i64::from(u16::from_le_bytes(self.array()?)),
            _ => {
                let len = usize::from(self.byte()?);
                let bytes = self.take(len)?;
                if len > 8 {
                    return Err(self.wrong("a whole number of more than 64 bits"));
                }
                let negative = bytes.last().is_some_and(|byte| byte >> 7 == 1);
                let mut wide = [if negative { 0xff } else { 0 }; 8];
                wide[..len].copy_from_slice(bytes);
                i64::from_le_bytes(wide)
            }
        };
        self.push(Object::Integer(value));
        Ok(())
    }

    /// Stores the top of the stack under a number, or fetches what was stored.
    fn remember(&mut self, code: u8) -> Result<(), ForeignError> {
        let slot = match code {
            b'q' | b'h' => u32::from(self.byte()?),
            0x94 => self.memo.len() as u32,
            _ => u32::from_le_bytes(self.array()?),
        };
        if matches!(code, b'h' | b'j') {
            let id = self.memo.get(&slot).copied().ok_or_else(|| self.wrong("a reference to nothing"))?;
            self.stack.push(id);
        } else {
            let id = self.last()?;
            self.memo.insert(slot, id);
        }
        Ok(())
    }

    fn tuple(&mut self, code: u8) -> Result<(), ForeignError> {
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

    /// Appends to a list or set, or sets entries of a dictionary.
    fn fill(&mut self, code: u8) -> Result<(), ForeignError> {
        let items = match code {
            b'a' => vec![self.pop()?],
            b's' => {
                let value = self.pop()?;
                vec![self.pop()?, value]
            }
            _ => self.pop_marked()?,
        };
        let target = self.last()?;
        match (&mut self.objects[target], code) {
            (Object::List(list), b'a' | b'e' | 0x90) => list.extend(items),
            (Object::Dictionary(entries), b's' | b'u') if items.len().is_multiple_of(2) => {
                entries.extend(items.as_chunks().0.iter().map(|[key, value]| (*key, *value)));
            }
            _ => return Err(self.wrong("entries for something that takes none")),
        }
        Ok(())
    }

    fn global(&mut self, code: u8) -> Result<(), ForeignError> {
        let (module, name) = if code == b'c' {
            (self.line()?, self.line()?)
        } else {
            let (name, module) = (self.pop()?, self.pop()?);
            match (&self.objects[module], &self.objects[name]) {
                (Object::Text(module), Object::Text(name)) => (*module, *name),
                _ => return Err(self.wrong("a name that is no text")),
            }
        };
        if !(self.allowed)(module, name) {
            let shown: String = format!("{module}.{name}").chars().take(80).collect();
            let what = format!("the name `{}`, which is not on the list of what may be read,", shown.escape_debug());
            return Err(self.wrong(&what));
        }
        self.push(Object::Global(module, name));
        Ok(())
    }

    fn line(&mut self) -> Result<&'a str, ForeignError> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let end = rest.iter().take(256).position(|byte| *byte == b'\n');
        let end = end.ok_or_else(|| self.wrong("a name without an end"))?;
        self.at += end + 1;
        std::str::from_utf8(&rest[..end]).map_err(|_| self.wrong("a name that is not UTF-8"))
    }

    /// Keeps a call as data. An ordered dictionary begins empty and is a dictionary at once.
    fn make(&mut self) -> Result<(), ForeignError> {
        let (arguments, global) = (self.pop()?, self.pop()?);
        let made = match (&self.objects[global], &self.objects[arguments]) {
            (Object::Global("collections", "OrderedDict"), Object::Tuple(items)) if items.is_empty() => {
                Object::Dictionary(Vec::new())
            }
            (Object::Global(..), Object::Tuple(_)) => Object::Made { global, arguments, state: None },
            _ => return Err(self.wrong("a call of something that is no function")),
        };
        self.push(made);
        Ok(())
    }

    /// Attributes of a dictionary (its metadata) are passed over; those of what was made are kept.
    fn build(&mut self) -> Result<(), ForeignError> {
        let given = self.pop()?;
        let target = self.last()?;
        match &mut self.objects[target] {
            Object::Dictionary(_) => Ok(()),
            Object::Made { state, .. } => {
                *state = Some(given);
                Ok(())
            }
            _ => Err(self.wrong("attributes for something that takes none")),
        }
    }
}
