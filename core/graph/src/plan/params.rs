//! Parameters of one node, checked one by one so that all misfits are reported.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use crate::diagnostic::{Place, Problem, Problems, suggest};
use crate::graph::{Located, NodeSpec, ParamValue};
use crate::params::ParamDoc;
use crate::registry::NodeKind;
use crate::syntax::{DeError, Spanned};

use super::Built;

/// The node with its parameters, or nothing and the reasons.
pub(super) fn build(spec: &NodeSpec, kind: &NodeKind, problems: &mut Problems) -> Option<Built> {
    let before = problems.0.len();
    let mut values: Vec<(&str, &Spanned)> = Vec::with_capacity(spec.params.len());
    let mut places = BTreeMap::new();
    for (name, value) in &spec.params {
        match check_one(spec, kind, (name, value)) {
            Ok(tree) => values.push((&name.value, tree)),
            Err(found) => problems.0.extend(found.0),
        }
        places.insert(name.value.clone(), value.place.clone());
    }
    if problems.0.len() > before {
        return None;
    }
    let place = |parameter: &str| places.get(parameter).unwrap_or(&spec.id.place);
    let node = match kind.build(&values) {
        Ok(node) => node,
        Err(error) => {
            problems.push(Problem::new(&spec.id.place, format!("node `{}`: {error}", spec.id.value)));
            return None;
        }
    };
    for error in node.validate() {
        let message = format!("node `{}`: parameter `{}`: {}", spec.id.value, error.parameter, error.message);
        problems.push(Problem::new(place(error.parameter), message));
    }
    let values = match node.values() {
        Ok(values) => values,
        Err(error) => {
            problems.push(Problem::new(&spec.id.place, format!("node `{}`: {error}", spec.id.value)));
            Map::new()
        }
    };
    for param in kind.params {
        if let Some(reason) = values.get(param.name).and_then(|value| out_of_bounds(param, value)) {
            let message = format!("node `{}`: parameter `{}` {reason}", spec.id.value, param.name);
            problems.push(Problem::new(place(param.name), message).help(param.text()));
        }
    }
    (problems.0.len() == before).then_some(Built { node, values, params: places })
}

/// The tree that fits the parameter.
fn check_one<'s>(
    spec: &NodeSpec,
    kind: &NodeKind,
    (name, value): (&Located<String>, &'s ParamValue),
) -> Result<&'s Spanned, Problems> {
    let id = &spec.id.value;
    let Some(param) = kind.param(&name.value) else {
        let message = format!("node `{id}` ({}) has no parameter `{}`", kind.kind, name.value);
        let known = kind.params.iter().map(|param| param.name);
        return Err(Problem::new(&name.place, message).maybe_help(suggest(&name.value, known, "parameters")).into());
    };
    let mut first: Option<DeError> = None;
    for tree in value.tree.iter().chain(&value.bare) {
        if let Some(number) = tree.non_finite() {
            let place = Place { span: number.span, ..value.place.clone() };
            let message = format!("node `{id}`: parameter `{}` must be a finite number", name.value);
            return Err(Problem::new(&place, message).into());
        }
        match kind.build(&[(&name.value, tree)]) {
            Ok(_) => return Ok(tree),
            Err(error) => first = first.or(Some(error)),
        }
    }
    let (span, reason) = match first {
        Some(error) => (error.span.unwrap_or(value.place.span), error.message),
        None => (value.place.span, "no value".to_owned()),
    };
    let place = Place { span, ..value.place.clone() };
    let unit = param.unit.map_or(String::new(), |unit| format!(", in {unit}"));
    Err(Problem::new(&place, format!("node `{id}`: parameter `{}`: {reason}", name.value))
        .label(format!("takes {}{unit}", param.type_name))
        .help(param.text())
        .into())
}

/// Why a value breaks the parameter's range or choices, if it does.
fn out_of_bounds(param: &ParamDoc, value: &Value) -> Option<String> {
    match value {
        Value::Number(number) => {
            let (least, greatest) = param.range?;
            let number = number.as_f64()?;
            let unit = param.unit.map_or(String::new(), |unit| format!(" {unit}"));
            let bounds = match (least.is_finite(), greatest.is_finite()) {
                (true, true) => format!("from {least} to {greatest}{unit}"),
                (true, false) => format!("at least {least}{unit}"),
                _ => format!("at most {greatest}{unit}"),
            };
            (!(least..=greatest).contains(&number))
                .then(|| format!("is {}; it must be {bounds}", ParamDoc::show(number)))
        }
        Value::String(word) if !param.choices.is_empty() && !param.choices.contains(&word.as_str()) => {
            let proposal = suggest(word, param.choices.iter().copied(), "").filter(|text| text.starts_with("did"));
            let proposal = proposal.map_or(String::new(), |text| format!(" ({text})"));
            Some(format!("is `{word}`; it must be one of {}{proposal}", param.choices.join(", ")))
        }
        Value::Array(values) => values.iter().find_map(|value| out_of_bounds(param, value)),
        Value::Object(values) => values.values().find_map(|value| out_of_bounds(param, value)),
        _ => None,
    }
}
