//! `node.param=value` from the command line.

use crate::diagnostic::{Place, Problem, Problems, Source, suggest};
use crate::syntax::{Span, Spanned, Tree, read_prefixed};

use super::scope::Setting;
use super::{Graph, Located, NodeSpec, ParamValue};

impl Graph {
    /// Applies `node.param=value`, or `name=value` for a parameter of the graph itself, from the command line. The value
    /// is RON; what is not RON, or does not fit the parameter, is taken as a string. Mistakes are kept for
    /// [`Graph::plan`] to report.
    pub fn set(&mut self, argument: &str) {
        self.set_from("--set", argument);
    }

    /// The same for another `flag`, which errors name.
    pub fn set_from(&mut self, flag: &str, argument: &str) {
        if let Err(problems) = self.try_set(flag, argument) {
            self.problems.0.extend(problems.0);
        }
    }

    fn try_set(&mut self, flag: &str, argument: &str) -> Result<(), Problems> {
        let source = Source::new(flag, argument.to_owned());
        let place = |start: usize, end: usize| Place { source: source.clone(), span: Span { start, end } };
        let whole = place(0, argument.len());
        let form = || {
            Problem::new(&whole, "this is not of the form `node.param=value`")
                .help("for example `--set phase.heart_rate_bpm=96`")
        };
        let (target, raw) = argument.split_once('=').ok_or_else(form)?;
        let span = Span { start: target.len() + 1, end: argument.len() };
        let value = ParamValue {
            tree: read_prefixed(argument, span.start).ok(),
            bare: Some(Spanned { span, tree: Tree::Text(raw.to_owned()) }),
            place: place(span.start, span.end),
        };
        let (id, param) = target.rsplit_once('.').unwrap_or(("", target));
        let start = target.len() - param.len();
        let name = Located { value: param.to_owned(), place: place(start, target.len()) };
        if let Some(index) = self.node_index(id) {
            self.nodes[index].set_param(name, value);
            return Ok(());
        }
        let Some(scope) = self.scopes.iter_mut().find(|scope| scope.instance == id) else {
            let problem = Problem::new(&place(0, id.len()), format!("the graph has no node `{id}`"));
            return Err(problem.maybe_help(suggest(id, self.node_ids(), "nodes")).into());
        };
        if scope.find(param).is_none() && id.is_empty() && scope.settings.is_empty() {
            return Err(form().into());
        }
        if scope.find(param).is_none() {
            let problem = Problem::new(&name.place, format!("{} has no parameter `{param}`", scope.what()));
            return Err(problem.maybe_help(suggest(param, scope.names(), "parameters")).into());
        }
        scope.put(Setting { name, value, scope: Some(0) });
        Ok(())
    }
}

impl NodeSpec {
    fn set_param(&mut self, name: Located<String>, value: ParamValue) {
        match self.params.iter_mut().find(|(known, _)| known.value == name.value) {
            Some(param) => *param = (name, value),
            None => self.params.push((name, value)),
        }
    }
}
