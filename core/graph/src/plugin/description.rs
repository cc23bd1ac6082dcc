//! What a library says it is, checked, and turned into kinds of nodes.
//!
//! The text that kinds are made of must live as long as the program: it is leaked, once for each library that is loaded,
//! as the library itself is (it is never unloaded).

use std::collections::BTreeSet;

use heartian_artifact::ArtifactType;
use serde::Deserialize;
use serde_json::Value;

use crate::node::Port;
use crate::params::ParamDoc;
use crate::registry::Registry;

use super::values::ParamForm;

/// The form of description that this host reads.
const FORMAT: u32 = 1;

/// A library's description of itself.
#[derive(Debug, Deserialize)]
pub(crate) struct Description {
    format: u32,
    pub name: String,
    pub version: String,
    kinds: Vec<KindText>,
}

#[derive(Debug, Deserialize)]
struct KindText {
    kind: String,
    revision: u32,
    #[serde(default)]
    doc: String,
    #[serde(default)]
    inputs: Vec<PortText>,
    outputs: Vec<PortText>,
    #[serde(default)]
    params: Vec<ParamText>,
}

#[derive(Debug, Deserialize)]
struct PortText {
    name: String,
    #[serde(rename = "type")]
    type_name: String,
    #[serde(default)]
    doc: String,
    #[serde(default)]
    many: bool,
    #[serde(default = "yes")]
    required: bool,
}

#[derive(Debug, Deserialize)]
struct ParamText {
    name: String,
    #[serde(default)]
    doc: String,
    #[serde(rename = "type")]
    type_name: String,
    #[serde(default)]
    list: bool,
    default: Value,
    unit: Option<String>,
    least: Option<f64>,
    greatest: Option<f64>,
    #[serde(default)]
    choices: Vec<String>,
    #[serde(default = "yes")]
    keyed: bool,
    #[serde(default)]
    file: bool,
}

fn yes() -> bool {
    true
}

/// A kind of node, its text leaked.
pub(crate) struct KindParts {
    pub kind: &'static str,
    pub revision: u32,
    pub doc: &'static str,
    pub inputs: &'static [Port],
    pub outputs: &'static [Port],
    pub params: &'static [ParamDoc],
    pub forms: Vec<ParamParts>,
}

/// What a parameter's manual does not say.
pub(crate) struct ParamParts {
    pub form: ParamForm,
    pub default: Value,
    /// It names a file or folder that the node reads.
    pub file: bool,
}

/// Text for the rest of the program's life.
pub(crate) fn leak(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

impl Description {
    /// Reads a description.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(document: &[u8]) -> Result<Self, String> {
        let value: Value =
            serde_json::from_slice(document).map_err(|error| format!("its description is not JSON: {error}"))?;
        let format = value.get("format").and_then(Value::as_u64);
        if format != Some(FORMAT.into()) {
            let found = format.map_or("no form".to_owned(), |format| format!("form {format}"));
            return Err(format!("its description has {found}; this program reads form {FORMAT}"));
        }
        let description: Self = serde_json::from_value(value)
            .map_err(|error| format!("its description is not of the right form: {error}"))?;
        debug_assert_eq!(description.format, FORMAT);
        if description.name.is_empty() || description.kinds.is_empty() {
            return Err("its description has no name or no kinds of nodes".to_owned());
        }
        Ok(description)
    }

    /// The kinds it describes. `house` knows the types of the program's own artifacts.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn kinds(&self, house: &Registry) -> Result<Vec<KindParts>, String> {
        let mut seen = BTreeSet::new();
        let kind = |text: &KindText| {
            let word = text.kind.starts_with(|c: char| c.is_ascii_alphabetic())
                && text.kind.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '.'));
            if !word || !seen.insert(text.kind.clone()) {
                return Err(format!("`{}` is no name for a kind of node, or stands twice", text.kind));
            }
            text.parts(house).map_err(|problem| format!("{}: {problem}", text.kind))
        };
        self.kinds.iter().map(kind).collect()
    }
}

impl KindText {
    fn parts(&self, house: &Registry) -> Result<KindParts, String> {
        if self.outputs.is_empty() || self.outputs.iter().any(|port| port.many) {
            return Err("it needs an output at least, and an output carries one value".to_owned());
        }
        let params = self.params.iter().map(ParamText::parts).collect::<Result<Vec<_>, _>>()?;
        distinct("parameter", self.params.iter().map(|param| param.name.as_str()))?;
        let (docs, forms): (Vec<ParamDoc>, Vec<ParamParts>) = params.into_iter().unzip();
        Ok(KindParts {
            kind: leak(&self.kind),
            revision: self.revision,
            doc: leak(&self.doc),
            inputs: ports("input", &self.inputs, house)?,
            outputs: ports("output", &self.outputs, house)?,
            params: Vec::leak(docs),
            forms,
        })
    }
}

fn distinct<'a>(what: &str, names: impl Iterator<Item = &'a str>) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for name in names {
        let plain = name.starts_with(|c: char| c.is_ascii_alphabetic())
            && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        if !plain || !seen.insert(name) {
            return Err(format!("`{name}` is no name for an {what}, or stands twice"));
        }
    }
    Ok(())
}

fn ports(what: &str, texts: &[PortText], house: &Registry) -> Result<&'static [Port], String> {
    distinct(what, texts.iter().map(|port| port.name.as_str()))?;
    let port = |text: &PortText| {
        let (name, doc) = (leak(&text.name), leak(&text.doc));
        let mut port =
            typed_port((name, doc), &text.type_name, house).map_err(|problem| format!("{what} `{name}`: {problem}"))?;
        (port.many, port.required) = (text.many, text.required);
        Ok::<_, String>(port)
    };
    Ok(Vec::leak(texts.iter().map(port).collect::<Result<Vec<_>, _>>()?))
}

/// A port of the type `name/version`: one of the house's, or a foreign one that travels as it is.
fn typed_port((name, doc): (&'static str, &'static str), text: &str, house: &Registry) -> Result<Port, String> {
    let form = || format!("`{text}` is no type; write `clip/1`, or `org.example.thing/1` for one of your own");
    let (type_name, version) = text.split_once('/').ok_or_else(form)?;
    let version: u32 = version.parse().map_err(|_| form())?;
    if let Some(known) = house.artifact(type_name) {
        if known.artifact.version == version {
            return Ok(known.alike(name, doc));
        }
        let ours = known.artifact.version;
        return Err(format!("it speaks form {version} of `{type_name}`; this program has form {ours}"));
    }
    let part =
        |part: &str| !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-'));
    if !type_name.contains('.') || !type_name.split('.').all(part) {
        let message = "is neither one of the house's types nor a reverse domain name such as `org.example.thing`";
        return Err(format!("`{type_name}` {message}"));
    }
    Ok(Port::encoded(name, ArtifactType { name: leak(type_name), version }, doc))
}

impl ParamText {
    fn parts(&self) -> Result<(ParamDoc, ParamParts), String> {
        let wrong = |problem: String| format!("parameter `{}`: {problem}", self.name);
        let form = ParamForm::named(&self.type_name, self.list)
            .ok_or_else(|| wrong(format!("its type `{}` is none of {}", self.type_name, ParamForm::names())))?;
        let choices: Vec<&'static str> = self.choices.iter().map(|choice| leak(choice)).collect();
        if !form.is_text() && (!choices.is_empty() || self.file) || self.file && self.list {
            return Err(wrong("only text may have choices, or name a file".to_owned()));
        }
        let default = form
            .read(self.default.clone(), !choices.is_empty())
            .map_err(|error| wrong(format!("its default is not of its type: {error}")))?;
        let range = (self.least.is_some() || self.greatest.is_some())
            .then(|| (self.least.unwrap_or(f64::NEG_INFINITY), self.greatest.unwrap_or(f64::INFINITY)));
        let doc = ParamDoc {
            unit: self.unit.as_deref().map(leak),
            range,
            choices: Vec::leak(choices),
            keyed: self.keyed,
            ..ParamDoc::new(leak(&self.name), leak(&self.doc), leak(&form.show()))
        };
        match crate::plan::out_of_bounds(&doc, &default) {
            Some(reason) => Err(wrong(format!("its default {reason}"))),
            None => Ok((doc, ParamParts { form, default, file: self.file })),
        }
    }
}
