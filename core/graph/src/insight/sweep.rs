//! One graph at many points: which values are tried, what the points share, and about how long all of it takes.

use std::collections::{HashMap, HashSet};

use serde::Serialize;
use serde_json::json;

use crate::diagnostic::{Place, Problem, Problems, Source};
use crate::digest::Digest;
use crate::plan::Plan;
use crate::scheduler::Preview;
use crate::syntax::{Span, Tree, read_prefixed};

use super::history::History;

/// More points than this are refused.
const POINTS_LIMIT: usize = 10_000;

/// The points of a sweep: at each, one `node.param=value` an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// What varies: `node.param` or a parameter of the graph.
    pub axes: Vec<String>,
    /// At each point, the text of the value on each axis.
    pub points: Vec<Vec<String>>,
}

impl Sweep {
    /// Reads `node.param=[value, ..]`, once an axis. All combinations, the last axis fastest; with `zip`, the first
    /// values together, then the second, and so on.
    ///
    /// # Errors
    /// What is not of that form; with `zip`, lists of different lengths; more than 10,000 points.
    pub fn parse(overs: &[String], zip: bool) -> Result<Self, Problems> {
        let mut problems = Problems::default();
        let mut axes: Vec<(String, Vec<String>, Place)> = Vec::new();
        for text in overs {
            match axis(text) {
                Ok((target, values, place)) => {
                    if let Some((_, _, first)) = axes.iter().find(|(known, _, _)| *known == target) {
                        let problem = Problem::new(&place, format!("`{target}` is varied twice"));
                        problems.push(problem.also(first, "first here"));
                    }
                    axes.push((target, values, place));
                }
                Err(found) => problems.0.extend(found.0),
            }
        }
        let lengths: Vec<usize> = axes.iter().map(|(_, values, _)| values.len()).collect();
        let count = if zip {
            lengths.first().copied().unwrap_or(1)
        } else {
            lengths.iter().fold(1usize, |product, length| product.saturating_mul(*length))
        };
        for (target, values, place) in axes.iter().filter(|(_, values, _)| zip && values.len() != count) {
            let message = format!("`{target}` has {} values where `{}` has {count}", values.len(), axes[0].0);
            problems.push(Problem::new(place, message).help("give as many, or leave --zip out for all combinations"));
        }
        if count > POINTS_LIMIT
            && let Some((_, _, place)) = axes.last()
        {
            let message = format!("the sweep has {count} points; at most {POINTS_LIMIT} are run");
            problems.push(Problem::new(place, message).help("vary fewer values at a time"));
        }
        let sweep = Self { axes: axes.iter().map(|(target, _, _)| target.clone()).collect(), points: Vec::new() };
        problems.or(())?;
        let at = |point: usize| {
            let mut rest = point;
            let mut values: Vec<String> = Vec::with_capacity(axes.len());
            for (_, choices, _) in axes.iter().rev() {
                let index = if zip { point } else { rest % choices.len() };
                rest /= choices.len();
                values.push(choices[index].clone());
            }
            values.reverse();
            values
        };
        Ok(Self { points: (0..count).map(at).collect(), ..sweep })
    }

    /// What [`crate::Graph::set_from`] is told at a point.
    pub fn settings(&self, point: usize) -> Vec<String> {
        self.axes.iter().zip(&self.points[point]).map(|(axis, value)| format!("{axis}={value}")).collect()
    }
}

/// `target=[values]`: the values as their texts.
fn axis(text: &str) -> Result<(String, Vec<String>, Place), Problems> {
    let source = Source::new("--over", text.to_owned());
    let place = |span: Span| Place { source: source.clone(), span };
    let whole = place(Span { start: 0, end: text.len() });
    let form = || {
        Problem::new(&whole, "this is not of the form `node.param=[value, ..]`")
            .help("for example `--over 'phase.heart_rate_bpm=[60, 72, 96]'`")
    };
    let (target, _) = text.split_once('=').ok_or_else(form)?;
    let list = read_prefixed(text, target.len() + 1)
        .map_err(|error| Problem::new(&place(error.span), error.message).maybe_help(error.help))?;
    let Tree::List(items) = &list.tree else { return Err(form().into()) };
    if items.is_empty() || target.is_empty() {
        return Err(form().into());
    }
    let values = items.iter().map(|item| text[item.span.start..item.span.end].to_owned());
    Ok((target.to_owned(), values.collect(), whole))
}

/// What several plans have in common, and what is left to do.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Forecast {
    /// Plans.
    pub points: usize,
    /// Nodes in all of them.
    pub nodes: usize,
    /// Nodes that are not the same as one before: same kind, same parameters, fed by the same.
    pub distinct: usize,
    /// Of those, what the cache holds.
    pub cached: usize,
    /// Of those, what will run.
    pub runs: usize,
    /// Of those, what waits for one that will run, and is a hit after all if that writes the bytes it wrote before.
    pub waits: usize,
    /// Sum of the times that such nodes took, in seconds, for what runs or waits.
    pub seconds: f64,
    /// Kinds of what runs or waits that never ran before: their time is not in the sum.
    pub untimed: Vec<String>,
}

impl Forecast {
    /// Looks at all plans together; each with [`crate::Run::preview`] of it.
    pub fn of(plans: &[(&Plan, Vec<Preview>)], history: &History) -> Self {
        let mut forecast = Self { points: plans.len(), ..Self::default() };
        let mut seen = HashSet::new();
        let mut times: HashMap<String, Option<f64>> = HashMap::new();
        for (plan, previews) in plans {
            let mut identities: Vec<Digest> = Vec::with_capacity(plan.nodes.len());
            for (at, preview) in previews.iter().enumerate() {
                let identity = preview.key.as_ref().map_or_else(|| identity(plan, at, &identities), |(key, _)| *key);
                identities.push(identity);
                forecast.nodes += 1;
                if !seen.insert(identity) {
                    continue;
                }
                forecast.distinct += 1;
                match (&preview.record, &preview.key) {
                    (Some(_), _) => {
                        forecast.cached += 1;
                        continue;
                    }
                    (None, Some(_)) => forecast.runs += 1,
                    (None, None) => forecast.waits += 1,
                }
                let node = &plan.nodes[at];
                let about = format!("{}{}", node.kind.kind, json!(node.values));
                let seconds = *times.entry(about).or_insert_with(|| history.seconds(node.kind.kind, &node.values));
                match seconds {
                    Some(seconds) => forecast.seconds += seconds,
                    None => forecast.untimed.push(node.kind.kind.to_owned()),
                }
            }
        }
        forecast.untimed.sort();
        forecast.untimed.dedup();
        forecast
    }
}

/// What a node is while the bytes that feed it are not known: its kind, parameters and the identities of its producers.
fn identity(plan: &Plan, at: usize, identities: &[Digest]) -> Digest {
    let node = &plan.nodes[at];
    let inputs = node.inputs.iter().map(|input| {
        let from: Vec<_> = input.from.iter().map(|(from, port)| json!([identities[*from], port.name])).collect();
        json!([input.port.name, from])
    });
    let implementation = node.kind.implementation;
    Digest::of_json(&json!({
        "kind": node.kind.kind,
        "revision": node.kind.revision,
        "implementation": implementation,
        "params": node.values,
        "inputs": inputs.collect::<Vec<_>>(),
        "seed": plan.seed,
    }))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn parse(overs: &[&str], zip: bool) -> Result<Sweep, Vec<String>> {
        let overs: Vec<String> = overs.iter().map(|text| (*text).to_owned()).collect();
        Sweep::parse(&overs, zip).map_err(|problems| problems.0.iter().map(Problem::one_line).collect())
    }

    #[test]
    fn points_are_all_combinations_or_pairs() {
        let sweep = parse(&["a.x=[1, 2.5]", "b.word=[\"p q\", Down]"], false).unwrap();
        let settings: Vec<Vec<String>> = (0..sweep.points.len()).map(|point| sweep.settings(point)).collect();
        assert_eq!(settings[0], ["a.x=1", "b.word=\"p q\""]);
        assert_eq!(settings[1], ["a.x=1", "b.word=Down"]);
        assert_eq!(settings[3], ["a.x=2.5", "b.word=Down"]);
        let zipped = parse(&["a.x=[1, 2]", "b.y=[[3], [4]]"], true).unwrap();
        assert_eq!(zipped.points, [["1", "[3]"], ["2", "[4]"]]);
        assert_eq!(parse(&[], false).unwrap().points, [[] as [&str; 0]]);
    }

    #[test]
    fn mistakes_point_into_the_argument() {
        let found = parse(&["a.x", "a.x=3", "a.x=[1, 2", "b.y=[]", "c.z=[1]", "c.z=[1]"], false).unwrap_err();
        let form = "(for example `--over 'phase.heart_rate_bpm=[60, 72, 96]'`)";
        let expected = [
            format!("--over:1:1: this is not of the form `node.param=[value, ..]` {form}"),
            format!("--over:1:1: this is not of the form `node.param=[value, ..]` {form}"),
            "--over:1:5: this is never closed; `]` is missing".to_owned(),
            format!("--over:1:1: this is not of the form `node.param=[value, ..]` {form}"),
            "--over:1:1: `c.z` is varied twice".to_owned(),
        ];
        assert_eq!(found, expected);
        let uneven = parse(&["a.x=[1, 2]", "b.y=[3]"], true).unwrap_err();
        assert_eq!(uneven.len(), 1, "{uneven:?}");
        let many = format!("x=[{}]", "1,".repeat(101));
        let many = [many.clone(), many.replace('x', "y")];
        assert!(parse(&[&many[0], &many[1]], false).unwrap_err()[0].contains("10201 points"));
    }
}
