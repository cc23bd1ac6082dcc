//! `$name`: parameters of a graph as values inside its nodes' parameters.
//!
//! A graph file is one scope. The scope of a subgraph is filled by the parameters of the node that it is, whose own
//! `$name`s belong to the scope around it; so looking a name up only ever goes outwards, and ends.

use std::borrow::Cow;

use crate::diagnostic::{Place, Problem, Problems, suggest};
use crate::syntax::{Span, Spanned, Tree};

use super::{Located, ParamValue};

/// More values than this in one parameter, after all names are replaced, are refused.
const VALUES_LIMIT: usize = 4_000_000;

/// A parameter of a graph with its value.
#[derive(Clone, Debug)]
pub(crate) struct Setting {
    pub name: Located<String>,
    pub value: ParamValue,
    /// Where the value's own `$name`s are looked up; nowhere for what a graph file declares.
    pub scope: Option<usize>,
}

/// The parameters of one graph file, or of one instance of it.
#[derive(Clone, Debug)]
pub(crate) struct Scope {
    /// Full id of the instance; empty for the outermost graph.
    pub instance: String,
    /// The file.
    pub file: String,
    pub settings: Vec<Setting>,
}

/// Where a value was given that a `$name` stands for.
#[derive(Clone, Debug)]
pub(crate) struct Origin {
    pub name: String,
    pub place: Place,
}

/// A parameter's value with every `$name` replaced.
pub(crate) struct Resolved<'a> {
    /// In the order in which they are tried.
    pub readings: Vec<Cow<'a, Spanned>>,
    /// Set when the whole value is one `$name`.
    pub origin: Option<Origin>,
}

impl Scope {
    pub fn find(&self, name: &str) -> Option<&Setting> {
        self.settings.iter().find(|setting| setting.name.value == name)
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.settings.iter().map(|setting| setting.name.value.as_str())
    }

    pub fn put(&mut self, setting: Setting) {
        match self.settings.iter_mut().find(|known| known.name.value == setting.name.value) {
            Some(known) => *known = setting,
            None => self.settings.push(setting),
        }
    }

    /// How messages call it.
    pub fn what(&self) -> String {
        if self.instance.is_empty() { "the graph".to_owned() } else { format!("`{}`", self.file) }
    }
}

/// The value of a node's parameter in the scope of that node.
pub(crate) fn resolve<'a>(scopes: &'a [Scope], scope: usize, value: &'a ParamValue) -> Result<Resolved<'a>, Problems> {
    let (mut given, mut scope, mut origin) = (value, Some(scope), None);
    while let Some(name) = given.tree.as_ref().and_then(Spanned::reference) {
        let setting = look_up(scopes, scope, name, given.place.span).map_err(|error| error.at(value))?;
        origin.get_or_insert_with(|| Origin { name: name.to_owned(), place: setting.value.place.clone() });
        (given, scope) = (&setting.value, setting.scope);
    }
    let mut readings: Vec<Cow<'_, Spanned>> = Vec::with_capacity(2);
    for tree in given.tree.iter() {
        let mut reading = Cow::Borrowed(tree);
        if tree_needs_work(tree) {
            let mut budget = VALUES_LIMIT;
            substitute(scopes, scope, reading.to_mut(), &mut budget).map_err(|error| error.at(value))?;
        }
        readings.push(reading);
    }
    readings.extend(given.bare.iter().map(Cow::Borrowed));
    if origin.is_some() {
        // What the name stands for lies elsewhere; mistakes with it are shown where it is used.
        readings.iter_mut().for_each(|reading| place_at(reading.to_mut(), value.place.span));
    }
    Ok(Resolved { readings, origin })
}

/// A `$name` that cannot be replaced.
struct Unresolved {
    span: Span,
    message: String,
    help: Option<String>,
}

impl Unresolved {
    fn at(self, value: &ParamValue) -> Problems {
        // The span may lie in another text, if the name was reached through other names.
        let inside = self.span.start >= value.place.span.start && self.span.end <= value.place.span.end;
        let place = if inside { Place { span: self.span, ..value.place.clone() } } else { value.place.clone() };
        Problem::new(&place, self.message).maybe_help(self.help).into()
    }
}

fn look_up<'a>(scopes: &'a [Scope], scope: Option<usize>, name: &str, span: Span) -> Result<&'a Setting, Unresolved> {
    let scope = scope.and_then(|index| scopes.get(index));
    scope.and_then(|scope| scope.find(name)).ok_or_else(|| {
        let what = scope.map_or("the graph".to_owned(), Scope::what);
        let proposal = scope.and_then(|scope| suggest(name, scope.names(), "parameters"));
        let declare = format!("declare it: `params: {{\"{name}\": ..}}`; `\"$${name}\"` is the plain text");
        Unresolved { span, message: format!("{what} has no parameter `{name}`"), help: proposal.or(Some(declare)) }
    })
}

fn tree_needs_work(tree: &Spanned) -> bool {
    match &tree.tree {
        Tree::Reference(_) => true,
        Tree::Text(text) => text.starts_with('$'),
        _ => tree.children().any(tree_needs_work),
    }
}

/// Replaces names inside a value; `$$` at the start of a text stands for one `$`. Depth is bounded by the reader's for
/// each scope passed.
fn substitute(
    scopes: &[Scope],
    scope: Option<usize>,
    tree: &mut Spanned,
    budget: &mut usize,
) -> Result<(), Unresolved> {
    let span = tree.span;
    let spent = || Unresolved {
        span,
        message: format!("this stands for more than {VALUES_LIMIT} values"),
        help: Some("give fewer".to_owned()),
    };
    *budget = budget.checked_sub(1).ok_or_else(spent)?;
    if let Some(name) = tree.reference() {
        let setting = look_up(scopes, scope, name, span)?;
        let mut value = setting.value.tree.clone().or(setting.value.bare.clone()).ok_or_else(spent)?;
        substitute(scopes, setting.scope, &mut value, budget)?;
        place_at(&mut value, span);
        *tree = value;
        return Ok(());
    }
    if let Tree::Text(text) = &mut tree.tree
        && text.starts_with("$$")
    {
        text.remove(0);
    }
    tree.children_mut().try_for_each(|child| substitute(scopes, scope, child, budget))
}

fn place_at(tree: &mut Spanned, span: Span) {
    tree.span = span;
    tree.children_mut().for_each(|child| place_at(child, span));
}
