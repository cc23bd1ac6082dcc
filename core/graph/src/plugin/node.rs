//! A node whose work is done by a library.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde_json::{Map, Value};

use crate::artifacts::{AnyArtifact, Inputs, Outputs};
use crate::context::Context;
use crate::node::{NodeError, ParamError, Port, Resources, SourceFile};
use crate::registry::{ErasedNode, Maker};
use crate::syntax::{DeError, Spanned};

use super::description::{KindParts, leak};
use super::native::{Events, Job, JobInput};
use super::process::Loaded;

/// A kind described by a library.
pub(crate) struct LoadedKind {
    pub parts: KindParts,
    pub library: &'static Loaded,
}

impl LoadedKind {
    fn defaults(&self) -> Map<String, Value> {
        let docs = self.parts.params.iter().zip(&self.parts.forms);
        docs.map(|(doc, parts)| (doc.name.to_owned(), parts.default.clone())).collect()
    }
}

/// A node with its parameters set.
struct LoadedNode {
    kind: &'static LoadedKind,
    values: Map<String, Value>,
}

impl Maker for &'static LoadedKind {
    fn build(&self, params: &[(&str, &Spanned)]) -> Result<Box<dyn ErasedNode>, DeError> {
        let mut values = self.defaults();
        for (name, value) in params {
            let mut docs = self.parts.params.iter().zip(&self.parts.forms);
            // Names are checked before; a stranger is left to the library.
            let Some((doc, parts)) = docs.find(|(doc, _)| doc.name == *name) else { continue };
            values.insert((*name).to_owned(), parts.form.read(*value, !doc.choices.is_empty())?);
        }
        Ok(Box::new(LoadedNode { kind: self, values }))
    }

    fn default_node(&self) -> Box<dyn ErasedNode> {
        Box::new(LoadedNode { kind: self, values: self.defaults() })
    }
}

impl ErasedNode for LoadedNode {
    fn sources(&self) -> Vec<SourceFile> {
        let docs = self.kind.parts.params.iter().zip(&self.kind.parts.forms);
        let named =
            docs.filter(|(_, parts)| parts.file).filter_map(|(doc, _)| Some((doc.name, self.values.get(doc.name)?)));
        let given = named.filter_map(|(name, value)| Some((name, value.as_str().filter(|path| !path.is_empty())?)));
        given.map(|(name, path)| SourceFile::new(name, path)).collect()
    }

    fn validate(&self) -> Vec<ParamError> {
        Vec::new()
    }

    fn resources(&self) -> Resources {
        Resources::default()
    }

    fn values(&self) -> Result<Map<String, Value>, serde_json::Error> {
        Ok(self.values.clone())
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let parts = &self.kind.parts;
        let params = Value::Object(self.values.clone()).to_string();
        let mut job = Job {
            kind: parts.kind,
            params: &params,
            seed: context.seed(),
            threads: u32::try_from(context.threads()).unwrap_or(u32::MAX),
            inputs: Vec::new(),
        };
        for (port, artifacts) in inputs.iter() {
            for artifact in artifacts {
                let artifact_type = artifact.artifact_type();
                let name = format!("{}/{}", artifact_type.name, artifact_type.version);
                job.inputs.push(JobInput { port: port.into(), artifact: name.into(), bytes: artifact.to_bytes()? });
            }
        }
        let mut collector = Collector { kind: self.kind, context, made: BTreeMap::new(), wrong: None };
        let trouble = self.kind.library.run(&job, context, &mut collector).err();
        drop(job);
        // A refusal of ours is the cause of whatever the library says after it.
        let Collector { made, wrong, .. } = collector;
        if let Some(error) = wrong {
            return Err(error);
        }
        if let Some(trouble) = trouble {
            let parameter = trouble.parameter.as_deref();
            let mut error = self
                .kind
                .library
                .error(&trouble.message)
                .remedy(trouble.remedy.unwrap_or_else(|| self.kind.library.report_it()));
            error.parameter = parts.params.iter().map(|param| param.name).find(|name| Some(*name) == parameter);
            error.cancelled = trouble.cancelled;
            return Err(error);
        }
        self.outputs(made)
    }
}

impl LoadedNode {
    /// What was made, as far as it is what the kind promises.
    fn outputs(&self, mut made: BTreeMap<&'static str, Vec<u8>>) -> Result<Outputs, NodeError> {
        let mut outputs = Outputs::new();
        for port in self.kind.parts.outputs {
            match made.remove(port.name) {
                Some(bytes) => outputs = outputs.put_any(port.name, self.decode(port, bytes)?),
                None if port.required => {
                    return Err(self.kind.mistake(&format!("it did not write its output `{}`", port.name)));
                }
                None => {}
            }
        }
        Ok(outputs)
    }

    fn decode(&self, port: &Port, bytes: Vec<u8>) -> Result<AnyArtifact, NodeError> {
        port.decode(bytes).map_err(|error| {
            let (output, artifact) = (port.name, port.artifact.name);
            self.kind.mistake(&format!("its output `{output}` is no `{artifact}`: {error}"))
        })
    }
}

impl LoadedKind {
    /// A mistake of the library's.
    fn mistake(&self, what: &str) -> NodeError {
        self.library.error(what).remedy(self.library.report_it())
    }
}

/// Gathers what the library writes, and passes on the rest.
struct Collector<'a> {
    kind: &'static LoadedKind,
    context: &'a Context,
    made: BTreeMap<&'static str, Vec<u8>>,
    wrong: Option<NodeError>,
}

impl Collector<'_> {
    fn take(&mut self, port: &str, artifact: &str, bytes: Cow<'_, [u8]>) -> Result<(), String> {
        let declared = self.kind.parts.outputs.iter().find(|declared| declared.name == port);
        let declared = declared.ok_or_else(|| format!("it wrote `{port}`, which it does not declare"))?;
        let (name, version) = (declared.artifact.name, declared.artifact.version);
        if artifact.rsplit_once('/') != Some((name, &version.to_string())) {
            return Err(format!("it wrote `{artifact}` to its output `{port}`, which carries `{name}/{version}`"));
        }
        match self.made.insert(declared.name, bytes.into_owned()) {
            Some(_) => Err(format!("it wrote its output `{port}` twice")),
            None => Ok(()),
        }
    }
}

impl Events for Collector<'_> {
    fn output(&mut self, port: &str, artifact: &str, bytes: Cow<'_, [u8]>) -> bool {
        if self.wrong.is_some() {
            return false;
        }
        match self.take(port, artifact, bytes) {
            Ok(()) => true,
            Err(what) => {
                self.wrong = Some(self.kind.mistake(&what));
                false
            }
        }
    }

    fn progress(&mut self, step: u64, total: u64, metric: Option<(&str, f64)>) -> bool {
        let metric = metric.map(|(name, value)| (self.kind.library.metric(name), value));
        self.context.progress(step, total, metric).is_continue()
    }

    fn warning(&mut self, text: &str) {
        let line: String = text.chars().filter(|c| !c.is_control()).take(2000).collect();
        self.context.warn(&line);
    }
}

impl Loaded {
    /// The name of a live figure, for ever: few names are kept.
    fn metric(&self, name: &str) -> &'static str {
        const NAMES: usize = 64;
        let mut names = self.metrics.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(known) = names.iter().find(|known| **known == name) {
            return known;
        }
        if names.len() >= NAMES || name.len() > 100 {
            return "metric";
        }
        let name = leak(name);
        names.push(name);
        name
    }
}
