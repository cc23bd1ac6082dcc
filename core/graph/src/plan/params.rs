//! Parameters of one node, checked one by one so that all misfits are reported.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde_json::{Map, Value};

use crate::diagnostic::{Place, Problem, Problems, suggest};
use crate::graph::{Graph, Located, NodeSpec, Origin, ParamValue, Resolved, resolve};
use crate::params::ParamDoc;
use crate::registry::NodeKind;
use crate::syntax::{DeError, Spanned};

use super::Built;

/// The node with its parameters, or nothing and the reasons.
pub(super) fn build(graph: &Graph, spec: &NodeSpec, kind: &NodeKind, problems: &mut Problems) -> Option<Built> {
    let before = problems.0.len();
    let mut values: Vec<(&str, Cow<'_, Spanned>)> = Vec::with_capacity(spec.params.len());
    let mut places = BTreeMap::new();
    let mut origins = BTreeMap::new();
    for (name, value) in &spec.params {
        match check_one(graph, (spec, kind), (name, value)) {
            Ok((tree, origin)) => {
                values.push((&name.value, tree));
                origins.extend(origin.map(|origin| (name.value.as_str(), origin)));
            }
            Err(found) => problems.0.extend(found.0),
        }
        places.insert(name.value.clone(), value.place.clone());
    }
    if problems.0.len() > before {
        return None;
    }
    let values: Vec<(&str, &Spanned)> = values.iter().map(|(name, tree)| (*name, &**tree)).collect();
    let node = match kind.build(&values) {
        Ok(node) => node,
        Err(error) => {
            problems.push(Problem::new(&spec.id.place, format!("node `{}`: {error}", spec.local())));
            return None;
        }
    };
    let mut report = |parameter: &str, said: String, help: Option<String>| {
        let place = places.get(parameter).unwrap_or(&spec.id.place);
        let problem = Problem::new(place, format!("node `{}`: parameter `{parameter}`{said}", spec.local()));
        problems.push(with_origin(problem.maybe_help(help), origins.get(parameter)));
    };
    for error in node.validate() {
        report(error.parameter, format!(": {}", error.message), None);
    }
    let (values, failure) = match node.values() {
        Ok(values) => (values, None),
        Err(error) => (Map::new(), Some(error)),
    };
    for param in kind.params {
        if let Some(reason) = values.get(param.name).and_then(|value| out_of_bounds(param, value)) {
            report(param.name, format!(" {reason}"), Some(param.text()));
        }
    }
    if let Some(error) = failure {
        problems.push(Problem::new(&spec.id.place, format!("node `{}`: {error}", spec.local())));
    }
    (problems.0.len() == before).then_some(Built { node, values, params: places })
}

/// Says where a `$name`'s value comes from.
fn with_origin(problem: Problem, origin: Option<&Origin>) -> Problem {
    match origin {
        Some(origin) => problem.also(&origin.place, format!("`${}` is given here", origin.name)),
        None => problem,
    }
}

/// The tree that fits the parameter.
fn check_one<'s>(
    graph: &'s Graph,
    (spec, kind): (&NodeSpec, &NodeKind),
    (name, value): (&Located<String>, &'s ParamValue),
) -> Result<(Cow<'s, Spanned>, Option<Origin>), Problems> {
    let id = spec.local();
    let Some(param) = kind.param(&name.value) else {
        let message = format!("node `{id}` ({}) has no parameter `{}`", kind.kind, name.value);
        let known = kind.params.iter().map(|param| param.name);
        let help = suggest(&name.value, known, "parameters").unwrap_or_else(|| {
            if kind.params.is_empty() {
                "it takes none".to_owned()
            } else {
                format!("`heartian nodes {}` lists them", kind.kind)
            }
        });
        return Err(Problem::new(&name.place, message).help(help).into());
    };
    let Resolved { readings, origin } = resolve(&graph.scopes, spec.scope, value)?;
    let mut first: Option<DeError> = None;
    for tree in readings {
        if let Some(number) = tree.non_finite() {
            let place = Place { span: number.span, ..value.place.clone() };
            let message = format!("node `{id}`: parameter `{}` must be a finite number", name.value);
            return Err(with_origin(Problem::new(&place, message), origin.as_ref()).into());
        }
        match kind.build(&[(&name.value, &tree)]) {
            Ok(_) => return Ok((tree, origin)),
            Err(error) => first = first.or(Some(error)),
        }
    }
    let error = first.unwrap_or(DeError { span: None, message: "no value".to_owned(), words: &[] });
    let place = Place { span: error.span.unwrap_or(value.place.span), ..value.place.clone() };
    let unit = param.unit.map_or(String::new(), |unit| format!(", in {unit}"));
    let said = place.source.text().get(place.span.start..place.span.end).unwrap_or_default();
    let proposal =
        suggest(said.trim_matches('"'), error.words.iter().copied(), "").filter(|text| text.starts_with("did"));
    let help = proposal.map_or(param.text(), |proposal| format!("{proposal} {}", param.text()));
    let problem = Problem::new(&place, format!("node `{id}`: parameter `{}`: {}", name.value, error.message));
    let problem = problem.label(format!("takes {}{unit}", param.type_name)).help(help);
    Err(with_origin(problem, origin.as_ref()).into())
}

/// Why a value breaks the parameter's range or choices, if it does.
pub(crate) fn out_of_bounds(param: &ParamDoc, value: &Value) -> Option<String> {
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
