//! What a node is: parameters, typed ports, and one pure function.

use serde_json::{Value, json};

use crate::call::{Call, Error, Inputs, Outputs};
use crate::params::Params;

/// A kind of node. The struct's fields are its parameters; write it with [`crate::params!`].
///
/// `run` is a pure function of the parameters, the inputs and `call.seed()`: equal ones give equal bytes at any thread
/// count. The cache relies on it. It may run in several threads at once.
pub trait Node: Params {
    /// The name graphs use: UpperCamelCase, unique among all nodes.
    const KIND: &'static str;
    /// Raised whenever `run` gives other outputs than before for the same inputs.
    const REVISION: u32;
    /// Ports read.
    const INPUTS: &'static [Port];
    /// Ports written; never empty.
    const OUTPUTS: &'static [Port];

    /// Does the work.
    ///
    /// # Errors
    /// Says what is wrong and what the user can do; the host adds the node and the library.
    fn run(&self, inputs: &Inputs<'_>, call: &Call) -> Result<Outputs, Error>;
}

/// A typed connection point. An optional input may be left unwired; an optional output may be left unwritten.
#[derive(Clone, Copy, Debug)]
pub struct Port {
    pub(crate) name: &'static str,
    pub(crate) type_name: &'static str,
    doc: &'static str,
    many: bool,
    required: bool,
}

impl Port {
    /// One value of a type: `clip/1` and its kin for the house's own, `org.example.thing/1` for new ones.
    pub const fn one(name: &'static str, type_name: &'static str, doc: &'static str) -> Self {
        Self { name, type_name, doc, many: false, required: true }
    }

    /// A list of one or more values, in the order of the graph file. Inputs only.
    pub const fn many(name: &'static str, type_name: &'static str, doc: &'static str) -> Self {
        Self { many: true, ..Self::one(name, type_name, doc) }
    }

    /// May be absent (for a list: empty).
    pub const fn optional(self) -> Self {
        Self { required: false, ..self }
    }

    fn describe(&self) -> Value {
        json!({
            "name": self.name,
            "type": self.type_name,
            "doc": self.doc,
            "many": self.many,
            "required": self.required,
        })
    }
}

/// A node of any kind, its type forgotten; [`crate::export!`] makes them.
#[derive(Clone, Copy)]
pub struct Kind {
    pub(crate) kind: &'static str,
    pub(crate) describe: fn() -> Result<Value, Error>,
    pub(crate) outputs: &'static [Port],
    pub(crate) run: fn(&str, &Inputs<'_>, &Call) -> Result<Outputs, Error>,
}

impl Kind {
    /// The kind of `N`.
    pub const fn of<N: Node>() -> Self {
        Self { kind: N::KIND, describe: describe::<N>, outputs: N::OUTPUTS, run: run::<N> }
    }
}

fn describe<N: Node>() -> Result<Value, Error> {
    let defaults = serde_json::to_value(N::default())?;
    Ok(json!({
        "kind": N::KIND,
        "revision": N::REVISION,
        "doc": N::DOC.trim(),
        "inputs": N::INPUTS.iter().map(Port::describe).collect::<Vec<_>>(),
        "outputs": N::OUTPUTS.iter().map(Port::describe).collect::<Vec<_>>(),
        "params": N::PARAMS.iter().map(|param| param.describe(&defaults[param.name()])).collect::<Vec<_>>(),
    }))
}

fn run<N: Node>(params: &str, inputs: &Inputs<'_>, call: &Call) -> Result<Outputs, Error> {
    let node: N = serde_json::from_str(params)?;
    node.run(inputs, call)
}
