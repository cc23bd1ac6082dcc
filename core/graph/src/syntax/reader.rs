//! Text to tree: recursive descent with a depth limit, one pass, no backtracking beyond one word.

use super::{Name, Span, Spanned, Tree};

/// Deeper nesting is refused: no graph needs it, and the stack stays bounded.
const DEPTH_LIMIT: usize = 64;

/// Where the text stops being RON, and why.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SyntaxError {
    pub span: Span,
    pub message: String,
    pub help: Option<String>,
}

type Read<T> = Result<T, SyntaxError>;

/// Reads the whole text as one value.
pub(crate) fn read(text: &str) -> Read<Spanned> {
    read_prefixed(text, 0)
}

/// Reads `text[start..]` as one value, with spans in `text`.
pub(crate) fn read_prefixed(text: &str, start: usize) -> Read<Spanned> {
    let mut reader = Reader { text, at: start, depth: 0 };
    reader.skip_space()?;
    while reader.rest().starts_with("#!") {
        reader.skip_attribute()?;
    }
    let value = reader.value()?;
    reader.skip_space()?;
    if reader.at < text.len() {
        return Err(reader.here("expected the end of the text"));
    }
    Ok(value)
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
}

fn starts_word(c: char) -> bool {
    c.is_ascii_alphabetic() || c == '_'
}

fn in_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

impl<'a> Reader<'a> {
    fn rest(&self) -> &'a str {
        self.text.get(self.at..).unwrap_or_default()
    }

    fn peek(&self) -> Option<char> {
        self.rest().chars().next()
    }

    fn bump(&mut self) -> Option<char> {
        let next = self.peek()?;
        self.at += next.len_utf8();
        Some(next)
    }

    fn eat(&mut self, wanted: char) -> bool {
        let found = self.peek() == Some(wanted);
        if found {
            self.at += wanted.len_utf8();
        }
        found
    }

    fn from(&self, start: usize) -> Span {
        Span { start, end: self.at }
    }

    fn error(&self, span: Span, message: impl Into<String>) -> SyntaxError {
        SyntaxError { span, message: message.into(), help: None }
    }

    /// An error at the next character, which it names.
    fn here(&self, wanted: &str) -> SyntaxError {
        let length = self.peek().map_or(0, char::len_utf8);
        let found = self.peek().map_or("the text ends".to_owned(), |c| format!("found `{}`", c.escape_default()));
        self.error(Span { start: self.at, end: self.at + length }, format!("{wanted}, {found}"))
    }

    fn skip_space(&mut self) -> Read<()> {
        loop {
            let rest = self.rest();
            let trimmed = rest.trim_start();
            self.at += rest.len() - trimmed.len();
            if trimmed.starts_with("//") {
                self.at += trimmed.find('\n').unwrap_or(trimmed.len());
            } else if trimmed.starts_with("/*") {
                self.skip_block_comment()?;
            } else {
                return Ok(());
            }
        }
    }

    fn skip_block_comment(&mut self) -> Read<()> {
        let (start, mut open) = (self.at, 0usize);
        while self.at < self.text.len() {
            let rest = self.rest();
            if rest.starts_with("/*") {
                (self.at, open) = (self.at + 2, open + 1);
            } else if rest.starts_with("*/") {
                (self.at, open) = (self.at + 2, open - 1);
                if open == 0 {
                    return Ok(());
                }
            } else {
                self.bump();
            }
        }
        Err(self.error(Span { start, end: start + 2 }, "this comment is never closed"))
    }

    /// `#![enable(..)]` is allowed and has no effect: the extensions it names are on.
    fn skip_attribute(&mut self) -> Read<()> {
        let start = self.at;
        match self.rest().find(']') {
            Some(length) => self.at += length + 1,
            None => return Err(self.error(Span { start, end: start + 2 }, "this attribute is never closed")),
        }
        self.skip_space()
    }

    fn value(&mut self) -> Read<Spanned> {
        if self.depth >= DEPTH_LIMIT {
            return Err(self.here(&format!("nested deeper than {DEPTH_LIMIT} levels")));
        }
        self.depth += 1;
        let start = self.at;
        let tree = match self.peek() {
            Some('"') => Tree::Text(self.string()?),
            Some('r') if self.rest().starts_with("r\"") || self.rest().starts_with("r#") => {
                Tree::Text(self.raw_string()?)
            }
            Some('\'') => Tree::Char(self.character()?),
            Some('[') => Tree::List(self.list(']')?),
            Some('{') => self.map()?,
            Some('(') => self.parenthesised(None)?,
            Some('$') => self.reference()?,
            Some(c) if c.is_ascii_digit() || matches!(c, '+' | '-' | '.') => self.number()?,
            Some(c) if starts_word(c) => self.word()?,
            _ => return Err(self.here("expected a value")),
        };
        self.depth -= 1;
        Ok(Spanned { span: self.from(start), tree })
    }

    fn reference(&mut self) -> Read<Tree> {
        self.bump();
        if !self.peek().is_some_and(starts_word) {
            return Err(self.here("expected a name after `$`"));
        }
        Ok(Tree::Reference(self.name().text))
    }

    fn name(&mut self) -> Name {
        let start = self.at;
        let rest = self.rest();
        self.at += rest.find(|c| !in_word(c)).unwrap_or(rest.len());
        Name { span: self.from(start), text: self.text[start..self.at].to_owned() }
    }

    fn word(&mut self) -> Read<Tree> {
        let name = self.name();
        match name.text.as_str() {
            "true" => return Ok(Tree::Bool(true)),
            "false" => return Ok(Tree::Bool(false)),
            "inf" => return Ok(Tree::Float(f64::INFINITY)),
            "NaN" => return Ok(Tree::Float(f64::NAN)),
            _ => {}
        }
        let after = self.at;
        self.skip_space()?;
        if self.peek() == Some('(') {
            return self.parenthesised(Some(name));
        }
        self.at = after;
        Ok(Tree::Word(name.text))
    }

    /// After an item: eats a comma, or requires the closing character to be next.
    fn separator(&mut self, open: usize, close: char) -> Read<()> {
        self.skip_space()?;
        if self.eat(',') {
            return self.skip_space();
        }
        match self.peek() {
            Some(c) if c == close => Ok(()),
            Some(_) => Err(self.here(&format!("expected `,` or `{close}`"))),
            None => {
                let bracket = Span { start: open, end: open + 1 };
                Err(self.error(bracket, format!("this is never closed; `{close}` is missing")))
            }
        }
    }

    fn opening(&mut self) -> Read<usize> {
        let open = self.at;
        self.bump();
        self.skip_space()?;
        Ok(open)
    }

    fn list(&mut self, close: char) -> Read<Vec<Spanned>> {
        let open = self.opening()?;
        let mut items = Vec::new();
        while !self.eat(close) {
            items.push(self.item(open, close)?);
            self.separator(open, close)?;
        }
        Ok(items)
    }

    fn item(&mut self, open: usize, close: char) -> Read<Spanned> {
        match self.peek() {
            Some(_) => self.value(),
            None => self.separator(open, close).and_then(|()| self.value()),
        }
    }

    fn map(&mut self) -> Read<Tree> {
        let open = self.opening()?;
        let mut pairs = Vec::new();
        while !self.eat('}') {
            let key = self.item(open, '}')?;
            self.skip_space()?;
            if !self.eat(':') {
                return Err(self.here("expected `:`"));
            }
            self.skip_space()?;
            pairs.push((key, self.value()?));
            self.separator(open, '}')?;
        }
        Ok(Tree::Map(pairs))
    }

    /// Whether a field name and its colon come next.
    fn at_field(&self) -> Read<bool> {
        let mut ahead = Reader { ..*self };
        if !ahead.peek().is_some_and(starts_word) {
            return Ok(false);
        }
        ahead.name();
        ahead.skip_space()?;
        Ok(ahead.peek() == Some(':'))
    }

    fn parenthesised(&mut self, name: Option<Name>) -> Read<Tree> {
        let open = self.at;
        let mut ahead = Reader { ..*self };
        ahead.opening()?;
        if !ahead.at_field()? {
            return Ok(Tree::Tuple { name, items: self.list(')')? });
        }
        self.opening()?;
        let mut fields = Vec::new();
        while !self.eat(')') {
            if !self.peek().is_some_and(starts_word) {
                return Err(self.here("expected a field name"));
            }
            let field = self.name();
            self.skip_space()?;
            if !self.eat(':') {
                return Err(self.here(&format!("expected `:` after `{}`", field.text)));
            }
            self.skip_space()?;
            fields.push((field, self.value()?));
            self.separator(open, ')')?;
        }
        Ok(Tree::Struct { name, fields })
    }

    fn number(&mut self) -> Read<Tree> {
        let start = self.at;
        let signed = self.eat('-') || self.eat('+');
        if signed && self.rest().starts_with(starts_word) {
            let word = self.name();
            let sign = if self.text[start..].starts_with('-') { -1.0 } else { 1.0 };
            return match word.text.as_str() {
                "inf" => Ok(Tree::Float(sign * f64::INFINITY)),
                "NaN" => Ok(Tree::Float(f64::NAN)),
                _ => Err(self.error(self.from(start), "this is not a number")),
            };
        }
        let radix = match self.rest().get(..2) {
            Some("0x") => 16,
            Some("0o") => 8,
            Some("0b") => 2,
            _ => 10,
        };
        let is_part = |previous: char, c: char| {
            c.is_ascii_alphanumeric()
                || matches!(c, '_' | '.')
                || (matches!(c, '+' | '-') && matches!(previous, 'e' | 'E'))
        };
        let mut previous = ' ';
        while let Some(c) = self.peek().filter(|c| is_part(if radix == 10 { previous } else { ' ' }, *c)) {
            previous = c;
            self.at += 1;
        }
        let digits: String = self.text[start..self.at].chars().filter(|c| *c != '_').collect();
        let value = if radix == 10 {
            let integer = digits.parse().ok().map(Tree::Integer);
            integer.or_else(|| digits.parse().ok().map(Tree::Float))
        } else {
            let unsigned = digits.trim_start_matches(['-', '+']).get(2..).unwrap_or_default();
            let magnitude = i128::from_str_radix(unsigned, radix).ok();
            magnitude.map(|value| Tree::Integer(if digits.starts_with('-') { -value } else { value }))
        };
        value.ok_or_else(|| self.error(self.from(start), "this is not a number"))
    }

    fn string(&mut self) -> Read<String> {
        let start = self.at;
        self.bump();
        let mut text = String::new();
        loop {
            let rest = self.rest();
            let Some(length) = rest.find(['"', '\\']) else {
                let quote = Span { start, end: start + 1 };
                return Err(self.error(quote, "this string is never closed; `\"` is missing"));
            };
            text.push_str(&rest[..length]);
            self.at += length;
            if self.eat('"') {
                return Ok(text);
            }
            text.extend(self.escape()?);
        }
    }

    fn raw_string(&mut self) -> Read<String> {
        let start = self.at;
        self.bump();
        let hashes = self.rest().len() - self.rest().trim_start_matches('#').len();
        self.at += hashes;
        if !self.eat('"') {
            return Err(self.here("expected `\"`"));
        }
        let closing = format!("\"{}", "#".repeat(hashes));
        let rest = self.rest();
        let Some(length) = rest.find(&closing) else {
            return Err(self.error(Span { start, end: start + 1 }, "this string is never closed"));
        };
        self.at += length + closing.len();
        Ok(rest[..length].to_owned())
    }

    fn character(&mut self) -> Read<char> {
        let start = self.at;
        self.bump();
        let value = if self.peek() == Some('\\') { self.escape()? } else { self.bump() };
        match value {
            Some(value) if self.eat('\'') => Ok(value),
            _ => Err(self.error(self.from(start), "this is not one character between `'`")),
        }
    }

    /// After a backslash: the character meant, or nothing for a line continuation.
    fn escape(&mut self) -> Read<Option<char>> {
        let start = self.at;
        self.bump();
        let value = match self.bump() {
            Some('n') => '\n',
            Some('r') => '\r',
            Some('t') => '\t',
            Some('0') => '\0',
            Some(c @ ('\\' | '"' | '\'')) => c,
            Some('x') => return self.code_point(start, 2).map(Some),
            Some('u') if self.eat('{') => {
                let length = self.rest().find('}').unwrap_or(usize::MAX).min(7);
                let value = self.code_point(start, length)?;
                self.eat('}');
                value
            }
            Some('\n') => {
                let rest = self.rest();
                self.at += rest.len() - rest.trim_start().len();
                return Ok(None);
            }
            _ => return Err(self.error(self.from(start), "unknown escape; write `\\\\` for a backslash")),
        };
        Ok(Some(value))
    }

    fn code_point(&mut self, start: usize, length: usize) -> Read<char> {
        let value = self.rest().get(..length).and_then(|hex| u32::from_str_radix(hex, 16).ok());
        match value.and_then(char::from_u32) {
            Some(value) => {
                self.at += length;
                Ok(value)
            }
            None => Err(self.error(self.from(start), "this is not a character's number")),
        }
    }
}
