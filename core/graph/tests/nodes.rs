//! Small nodes over lists of numbers, and a workbench that runs graphs of them against a cache of its own.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};
use heartian_graph::{
    Cache, Cancel, Context, Event, Graph, Inputs, Node, NodeError, NodeKind, NodeReport, Observer, Outputs, ParamError,
    Plan, Port, Problem, Registry, Run, RunOptions, SourceFile, Status, load, params,
};
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq)]
pub struct Numbers(pub Vec<f64>);

impl Artifact for Numbers {
    const TYPE: ArtifactType = ArtifactType { name: "numbers", version: 1 };
    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        Bundle::new().tensor("values", &[self.0.len()], &self.0)
    }
    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Ok(Self(reader.shaped("values", &[None])?))
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Word(pub String);

impl Artifact for Word {
    const TYPE: ArtifactType = ArtifactType { name: "word", version: 1 };
    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        Bundle::new().meta("word", &self.0)
    }
    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Ok(Self(reader.meta("word")?))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Rounding {
    Exact,
    Down,
}

params! {
    /// Gives the numbers it is told.
    pub struct Constant {
        /// The numbers.
        values: Vec<f64> = vec![1.0, 2.0], range(-1e6, 1e6);
        /// Names the numbers.
        label: Option<String> = None;
        /// Does not matter.
        threads: usize = 1, unkeyed();
    }
}
params! {
    /// Adds to each number.
    pub struct Add {
        /// What is added.
        amount: f64 = 0.0, unit("units"), range(-100.0, 100.0);
        /// Whether the sum is rounded.
        rounding: Rounding = Rounding::Exact;
        /// How the sum is spelt.
        spelling: String = "plain".to_owned(), choices(&["plain", "fancy"]);
    }
}
params! {
    /// Adds lists number by number.
    pub struct Sum {}
}
params! {
    /// Reads the bytes of a file or folder as numbers.
    pub struct ReadFile {
        /// The file.
        path: String = "none".to_owned();
    }
}
params! {
    /// Gives an output only when asked.
    pub struct Maybe {
        /// Whether it does.
        give: bool = false;
    }
}
params! {
    /// Ends badly.
    pub struct Trouble {
        /// How: `fail`, `panic`, `forget`, `wait`.
        how: String = "fail".to_owned();
    }
}
params! {
    /// Spells a number.
    pub struct Spell {}
}
params! {
    /// Computes on a device whose arithmetic may be its own.
    pub struct Devised {
        /// The device; the CPU when not given.
        device: Option<String> = None, unkeyed();
    }
}

const NUMBERS: Port = Port::one::<Numbers>("numbers", "Numbers.");

impl Node for Constant {
    const KIND: &'static str = "Constant";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[NUMBERS];
    fn validate(&self) -> Vec<ParamError> {
        let empty = self.values.is_empty();
        empty.then(|| ParamError::new("values", "is empty; give at least one number")).into_iter().collect()
    }
    fn run(&self, _: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        if self.label.is_none() {
            context.warn("these numbers have no label");
        }
        Ok(Outputs::new().put("numbers", Numbers(self.values.clone())))
    }
}

impl Node for Add {
    const KIND: &'static str = "Add";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[NUMBERS];
    const OUTPUTS: &'static [Port] = &[NUMBERS];
    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let add = |x: &f64| match self.rounding {
            Rounding::Exact => x + self.amount,
            Rounding::Down => (x + self.amount).floor(),
        };
        let values = inputs.get::<Numbers>("numbers")?.0.iter().map(add).collect();
        Ok(Outputs::new().put("numbers", Numbers(values)))
    }
}

impl Node for Devised {
    const KIND: &'static str = "Devised";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[NUMBERS];
    fn numerics(&self) -> Option<String> {
        // What the machine makes of "auto" here.
        self.device.clone().filter(|device| device != "auto")
    }
    fn run(&self, _: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        Ok(Outputs::new().put("numbers", Numbers(vec![0.5])))
    }
}

impl Node for Sum {
    const KIND: &'static str = "Sum";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[
        Port::many::<Numbers>("terms", "What is added."),
        Port::one::<Numbers>("extra", "Added too, if given.").optional(),
    ];
    const OUTPUTS: &'static [Port] = &[NUMBERS];
    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let mut terms = inputs.many::<Numbers>("terms")?;
        terms.extend(inputs.optional::<Numbers>("extra")?);
        let mut sums: Vec<f64> = Vec::new();
        for (step, term) in terms.iter().enumerate() {
            sums.resize(sums.len().max(term.0.len()), 0.0);
            sums.iter_mut().zip(&term.0).for_each(|(sum, x)| *sum += x);
            let _ = context.progress(step as u64 + 1, terms.len() as u64, Some(("sum", sums.iter().sum())));
        }
        Ok(Outputs::new().put("numbers", Numbers(sums)))
    }
}

impl Node for ReadFile {
    const KIND: &'static str = "ReadFile";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[NUMBERS];
    fn sources(&self) -> Vec<SourceFile> {
        if self.path == "none" { Vec::new() } else { vec![SourceFile::new("path", &self.path).remedy("give a file")] }
    }
    fn run(&self, _: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        if self.path == "none" {
            return Ok(Outputs::new().put("numbers", Numbers(vec![0.0])));
        }
        let bytes = std::fs::read(&self.path).map_err(|error| NodeError::from(error).parameter("path"))?;
        Ok(Outputs::new().put("numbers", Numbers(bytes.into_iter().map(f64::from).collect())))
    }
}

impl Node for Maybe {
    const KIND: &'static str = "Maybe";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one::<Numbers>("numbers", "Perhaps.").optional()];
    fn run(&self, _: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        Ok(Outputs::new().put_some("numbers", self.give.then(|| Numbers(vec![5.0]))))
    }
}

impl Node for Trouble {
    const KIND: &'static str = "Trouble";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[Port::one::<Numbers>("numbers", "Ignored.").optional()];
    const OUTPUTS: &'static [Port] = &[NUMBERS];
    fn run(&self, _: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        match self.how.as_str() {
            "panic" => panic!("index {} is no good", 7),
            "forget" => Ok(Outputs::new()),
            "wait" => {
                while context.progress(0, 0, None).is_continue() {}
                Err(NodeError::new("some error of its own"))
            }
            _ => Err(NodeError::new("it was told to fail").parameter("how").remedy("tell it otherwise")),
        }
    }
}

impl Node for Spell {
    const KIND: &'static str = "Spell";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[NUMBERS];
    const OUTPUTS: &'static [Port] = &[Port::one::<Word>("word", "The first number, spelt.")];
    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let numbers = inputs.get::<Numbers>("numbers")?;
        Ok(Outputs::new().put("word", Word(format!("{:?}", numbers.0.first()))))
    }
}

pub fn registry() -> Registry {
    Registry::of([
        NodeKind::of::<Constant>(),
        NodeKind::of::<Add>(),
        NodeKind::of::<Sum>(),
        NodeKind::of::<ReadFile>(),
        NodeKind::of::<Maybe>(),
        NodeKind::of::<Trouble>(),
        NodeKind::of::<Spell>(),
    ])
}

/// A cache in a folder of its own, and the runs against it.
pub struct Bench {
    pub folder: tempfile::TempDir,
    pub cache: Cache,
}

/// What a run did.
pub struct Done {
    pub reports: Vec<NodeReport>,
    pub problems: Vec<Problem>,
    pub fingerprint: String,
}

impl Bench {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(&folder.path().join("cache")).unwrap();
        Self { folder, cache }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn run(&self, text: &str) -> Done {
        self.run_with(text, &[], &RunOptions::default())
    }

    pub fn run_with(&self, text: &str, set: &[&str], options: &RunOptions) -> Done {
        let mut graph = Graph::parse("test.ron", text).unwrap();
        set.iter().for_each(|argument| graph.set(argument));
        self.run_plan(&plan(&graph), options)
    }

    pub fn run_plan(&self, plan: &Plan, options: &RunOptions) -> Done {
        let run = Run::prepare(plan, &self.cache);
        let reports = run.execute(options);
        let problems = reports.iter().filter_map(|report| report.problem(plan)).collect();
        Done { reports, problems, fingerprint: run.fingerprint().to_string() }
    }

    pub fn numbers(&self, done: &Done, node: &str) -> Vec<f64> {
        let report = done.reports.iter().find(|report| &*report.id == node).unwrap();
        load::<Numbers>(&self.cache, &report.outputs["numbers"]).unwrap().unwrap().0.clone()
    }
}

pub fn plan(graph: &Graph) -> Plan {
    match graph.plan(&registry(), &[]) {
        Ok(plan) => plan,
        Err(problems) => panic!("{:?}", problems.0.iter().map(Problem::one_line).collect::<Vec<_>>()),
    }
}

impl Done {
    /// `a:hit b:ran` in plan order.
    pub fn statuses(&self) -> String {
        let words = self.reports.iter().map(|report| format!("{}:{}", report.id, report.status.word()));
        words.collect::<Vec<_>>().join(" ")
    }

    pub fn count(&self, status: Status) -> usize {
        self.reports.iter().filter(|report| report.status == status).count()
    }
}

/// Collects events as lines, and may ask to stop at the first progress report.
#[derive(Default)]
pub struct Listener {
    pub lines: std::sync::Mutex<Vec<String>>,
    pub stop_at_progress: Option<Cancel>,
}

impl Observer for Listener {
    fn event(&self, event: &Event<'_>) {
        if let (Event::Progress { .. }, Some(cancel)) = (event, &self.stop_at_progress) {
            cancel.request();
        }
        self.lines.lock().unwrap().push(format!("{event:?}"));
    }
}

/// All files below the cache, by relative path, with their bytes.
pub fn cache_files(bench: &Bench) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![bench.cache.root().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let bytes = std::fs::read(&path).unwrap();
                found.insert(path, bytes);
            }
        }
    }
    found
}

/// Options with an observer that keeps all events.
pub fn listened() -> (Arc<Listener>, RunOptions) {
    let listener = Arc::new(Listener::default());
    (listener.clone(), RunOptions { observer: listener, ..RunOptions::default() })
}
