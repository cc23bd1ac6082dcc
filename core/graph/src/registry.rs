//! The kinds of nodes a program knows, erased of their types.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::artifacts::{Inputs, Outputs};
use crate::context::Context;
use crate::digest::Digest;
use crate::node::{Need, Node, NodeError, ParamError, Port, Resources, SourceFile};
use crate::params::ParamDoc;
use crate::syntax::{DeError, Fields, Spanned};

/// A node with its parameters set, its type forgotten.
pub trait ErasedNode: Send + Sync {
    /// See [`Node::sources`].
    fn sources(&self) -> Vec<SourceFile>;
    /// See [`Node::validate`].
    fn validate(&self) -> Vec<ParamError>;
    /// See [`Node::leaves_empty`].
    fn leaves_empty(&self) -> Vec<&'static str> {
        Vec::new()
    }
    /// See [`Node::needs`].
    fn needs(&self) -> Vec<Need> {
        Vec::new()
    }
    /// See [`Node::numerics`].
    fn numerics(&self) -> Option<String> {
        None
    }
    /// See [`Node::resources`].
    fn resources(&self) -> Resources;
    /// All parameters, defaults written out.
    ///
    /// # Errors
    /// When a value has no JSON form.
    fn values(&self) -> Result<serde_json::Map<String, Value>, serde_json::Error>;
    /// See [`Node::run`].
    ///
    /// # Errors
    /// Those of the node.
    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError>;
}

impl<N: Node> ErasedNode for N {
    fn sources(&self) -> Vec<SourceFile> {
        Node::sources(self)
    }
    fn validate(&self) -> Vec<ParamError> {
        Node::validate(self)
    }
    fn leaves_empty(&self) -> Vec<&'static str> {
        Node::leaves_empty(self)
    }
    fn needs(&self) -> Vec<Need> {
        Node::needs(self)
    }
    fn numerics(&self) -> Option<String> {
        Node::numerics(self)
    }
    fn resources(&self) -> Resources {
        Node::resources(self)
    }
    fn values(&self) -> Result<serde_json::Map<String, Value>, serde_json::Error> {
        match serde_json::to_value(self)? {
            Value::Object(map) => Ok(map),
            _ => Ok(serde_json::Map::new()),
        }
    }
    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        Node::run(self, inputs, context)
    }
}

/// A kind of node: its manual, and how to make one.
#[derive(Clone, Copy)]
pub struct NodeKind {
    /// See [`Node::KIND`].
    pub kind: &'static str,
    /// See [`Node::REVISION`].
    pub revision: u32,
    /// Digest of the library that holds the code, when it is not compiled in. Part of the cache key.
    pub implementation: Option<Digest>,
    /// What it does, in words.
    pub doc: &'static str,
    /// See [`Node::INPUTS`].
    pub inputs: &'static [Port],
    /// See [`Node::OUTPUTS`].
    pub outputs: &'static [Port],
    /// Its parameters.
    pub params: &'static [ParamDoc],
    pub(crate) make: Make,
}

/// How nodes of a kind are made.
#[derive(Clone, Copy)]
pub(crate) enum Make {
    /// Linked into the program.
    Linked { default: fn() -> Box<dyn ErasedNode>, build: fn(Fields<'_>) -> Result<Box<dyn ErasedNode>, DeError> },
    /// Described by a library at run time.
    Loaded(&'static dyn Maker),
}

/// Makes nodes of a kind that was described at run time.
pub(crate) trait Maker: Send + Sync {
    /// A node with these parameters, the others by default.
    fn build(&self, params: &[(&str, &Spanned)]) -> Result<Box<dyn ErasedNode>, DeError>;
    /// A node with default parameters.
    fn default_node(&self) -> Box<dyn ErasedNode>;
}

impl NodeKind {
    /// The kind of `N`.
    pub const fn of<N: Node>() -> Self {
        Self {
            kind: N::KIND,
            revision: N::REVISION,
            implementation: None,
            doc: N::DOC,
            inputs: N::INPUTS,
            outputs: N::OUTPUTS,
            params: N::PARAMS,
            make: Make::Linked {
                default: || Box::new(N::default()),
                build: |fields| Ok(Box::new(N::deserialize(fields)?)),
            },
        }
    }

    /// A node with default parameters.
    pub fn default_node(&self) -> Box<dyn ErasedNode> {
        match self.make {
            Make::Linked { default, .. } => default(),
            Make::Loaded(maker) => maker.default_node(),
        }
    }

    /// A node with these parameters, the others by default.
    pub(crate) fn build(&self, params: &[(&str, &Spanned)]) -> Result<Box<dyn ErasedNode>, DeError> {
        match self.make {
            Make::Linked { build, .. } => build(Fields(params)),
            Make::Loaded(maker) => maker.build(params),
        }
    }

    /// The input of that name.
    pub fn input(&self, name: &str) -> Option<&'static Port> {
        self.inputs.iter().find(|port| port.name == name)
    }

    /// The output of that name.
    pub fn output(&self, name: &str) -> Option<&'static Port> {
        self.outputs.iter().find(|port| port.name == name)
    }

    /// The parameter of that name.
    pub fn param(&self, name: &str) -> Option<&'static ParamDoc> {
        self.params.iter().find(|param| param.name == name)
    }
}

inventory::collect!(NodeKind);

/// Makes a node known to every program that links its crate: one visible line a node.
#[macro_export]
macro_rules! register {
    ($node:ty) => {
        $crate::inventory::submit! { $crate::NodeKind::of::<$node>() }
    };
}

/// Kinds by name.
#[derive(Clone, Default)]
pub struct Registry {
    kinds: BTreeMap<&'static str, NodeKind>,
}

impl Registry {
    /// All kinds linked into this program.
    pub fn compiled_in() -> Self {
        Self::of(inventory::iter::<NodeKind>.into_iter().copied())
    }

    /// These kinds and no others; the first of equal names wins, [`Registry::all_compiled_in`] shows them all.
    pub fn of(kinds: impl IntoIterator<Item = NodeKind>) -> Self {
        let mut registry = Self::default();
        registry.extend(kinds);
        registry
    }

    /// Adds kinds that are not there yet.
    pub(crate) fn extend(&mut self, kinds: impl IntoIterator<Item = NodeKind>) {
        for kind in kinds {
            self.kinds.entry(kind.kind).or_insert(kind);
        }
    }

    /// A port of a built-in kind that carries the artifact type of that name.
    pub(crate) fn artifact(&self, name: &str) -> Option<&'static Port> {
        let built_in = self.kinds.values().filter(|kind| kind.implementation.is_none());
        let mut ports = built_in.flat_map(|kind| kind.inputs.iter().chain(kind.outputs));
        ports.find(|port| port.artifact.name == name)
    }

    /// Every registration, equal names included, for the law that there are none.
    pub fn all_compiled_in() -> Vec<NodeKind> {
        inventory::iter::<NodeKind>.into_iter().copied().collect()
    }

    /// The kind of that name.
    pub fn get(&self, kind: &str) -> Option<&NodeKind> {
        self.kinds.get(kind)
    }

    /// All kinds, in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = &NodeKind> {
        self.kinds.values()
    }
}
