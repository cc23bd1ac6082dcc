//! What is wrong with a graph, and where: every problem knows its file, line and column, and all are shown at once.

use std::fmt;
use std::sync::Arc;

use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode};

use crate::syntax::Span;

/// A text that values come from: a graph file, or a `--set` argument.
#[derive(Debug)]
pub struct Source {
    name: String,
    named: NamedSource<String>,
}

impl Source {
    /// `name` is what errors print before line and column.
    pub fn new(name: &str, text: String) -> Arc<Self> {
        Arc::new(Self { name: name.to_owned(), named: NamedSource::new(name, text) })
    }

    /// The text.
    pub fn text(&self) -> &str {
        self.named.inner()
    }

    /// The name given.
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// A range of a source.
#[derive(Clone, Debug)]
pub struct Place {
    /// The text.
    pub source: Arc<Source>,
    /// The range.
    pub span: Span,
}

impl Place {
    /// Line and column, from 1, of the range's start; columns count characters.
    pub fn line_column(&self) -> (usize, usize) {
        let text = self.source.text();
        let before = text.get(..self.span.start).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
    }
}

impl fmt::Display for Place {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (line, column) = self.line_column();
        write!(formatter, "{}:{line}:{column}", self.source.name)
    }
}

/// One problem.
#[derive(Clone, Debug)]
pub struct Problem {
    message: String,
    label: String,
    help: Option<String>,
    place: Place,
    also: Option<(Place, String)>,
}

impl Problem {
    /// `message` about what stands at `place`.
    pub fn new(place: &Place, message: impl Into<String>) -> Self {
        Self { message: message.into(), label: "here".to_owned(), help: None, place: place.clone(), also: None }
    }

    /// The text under the underline.
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }

    /// What to do.
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// What to do, if known.
    pub fn maybe_help(mut self, help: Option<String>) -> Self {
        self.help = help.or(self.help);
        self
    }

    /// A second place that matters.
    pub fn also(mut self, place: &Place, label: impl Into<String>) -> Self {
        self.also = Some((place.clone(), label.into()));
        self
    }

    /// Where it is.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// `file:line:column: message (help)`.
    pub fn one_line(&self) -> String {
        let help = self.help.as_ref().map_or(String::new(), |help| format!(" ({help})"));
        format!("{}: {}{help}", self.place, self.message)
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.message)
    }
}

impl std::error::Error for Problem {}

impl Diagnostic for Problem {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        let elsewhere = self.also.as_ref().filter(|(place, _)| !Arc::ptr_eq(&place.source, &self.place.source));
        let elsewhere = elsewhere.map(|(place, label)| format!("{label}: {place}"));
        let lines: Vec<String> = elsewhere.into_iter().chain(self.help.clone()).collect();
        if lines.is_empty() { None } else { Some(Box::new(lines.join("\n"))) }
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        Some(&self.place.source.named)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let label = |place: &Place, text: &str| {
            LabeledSpan::new(Some(text.to_owned()), place.span.start, place.span.end - place.span.start)
        };
        let also = self.also.as_ref().filter(|(place, _)| Arc::ptr_eq(&place.source, &self.place.source));
        let main = label(&self.place, &self.label);
        Some(Box::new(std::iter::once(main).chain(also.map(|(place, text)| label(place, text)))))
    }
}

/// All problems of a graph; never empty when returned as an error.
#[derive(Clone, Debug, Default)]
pub struct Problems(pub Vec<Problem>);

/// More than this many are counted, not shown.
const SHOWN: usize = 30;

impl Problems {
    /// Adds one.
    pub fn push(&mut self, problem: Problem) {
        self.0.push(problem);
    }

    /// In the order of files and places; what is said of one place in the same words is said once, as when a subgraph
    /// with a mistake is used twice.
    pub(crate) fn sort(&mut self) {
        let place = |problem: &Problem| (problem.place.source.name.clone(), problem.place.span.start);
        self.0.sort_by_cached_key(|problem| (place(problem), problem.message.clone()));
        self.0.dedup_by(|a, b| {
            let also = |problem: &Problem| problem.also.as_ref().map(|(place, _)| place.span);
            Arc::ptr_eq(&a.place.source, &b.place.source)
                && place(a) == place(b)
                && a.message == b.message
                && also(a) == also(b)
        });
    }

    /// `value` if there are no problems.
    ///
    /// # Errors
    /// The problems, if there are any.
    pub fn or<T>(self, value: T) -> Result<T, Self> {
        if self.0.is_empty() { Ok(value) } else { Err(self) }
    }
}

impl From<Problem> for Problems {
    fn from(problem: Problem) -> Self {
        Self(vec![problem])
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.len() {
            1 => write!(formatter, "the graph has a problem"),
            count if count > SHOWN => write!(formatter, "the graph has {count} problems; the first {SHOWN}"),
            count => write!(formatter, "the graph has {count} problems"),
        }
    }
}

impl std::error::Error for Problems {}

impl Diagnostic for Problems {
    fn related<'a>(&'a self) -> Option<Box<dyn Iterator<Item = &'a dyn Diagnostic> + 'a>> {
        Some(Box::new(self.0.iter().take(SHOWN).map(|problem| problem as &dyn Diagnostic)))
    }
}

/// More candidates than this are not compared, so that a large graph with many mistakes is still refused at once.
pub(crate) const CANDIDATES: usize = 5000;

/// "did you mean `x`?" for the nearest of `known`, or the list of them when few.
pub(crate) fn suggest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>, what: &str) -> Option<String> {
    let known: Vec<&str> = known.into_iter().take(CANDIDATES).collect();
    let score = |candidate: &&str| strsim::jaro_winkler(&word.to_lowercase(), &candidate.to_lowercase());
    let nearest = known.iter().copied().map(|candidate| (score(&candidate), candidate));
    let nearest = nearest.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(score, _)| *score >= 0.8);
    match nearest {
        Some((_, candidate)) => Some(format!("did you mean `{candidate}`?")),
        None if known.is_empty() => None,
        None if known.len() <= 16 => Some(format!("{what}: {}", known.join(", "))),
        None => None,
    }
}
