//! What a run leaves in its folder: `metrics.json`, `run.json`, reports and exported clips.
//!
//! Always holds: files are written beside their place and renamed into it; what `run.json` says is there for the same
//! artifact is not written again, so that a cached rerun touches almost nothing; files of an earlier run in the same
//! folder that this run does not make are removed.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use heartian_artifact::Artifact;
use heartian_capture::export::{AviForm, write_clip};
use heartian_graph::{Cache, Digest, Files, Graph, NodeReport, Plan, Status, load};
use heartian_space::{Clip, Labels, Metrics};
use miette::{IntoDiagnostic, Result, WrapErr};
use serde::{Deserialize, Serialize};

/// What is delivered.
pub struct Delivery<'a> {
    /// The graph as loaded.
    pub graph: &'a Graph,
    /// What the command line changed in it.
    pub sets: &'a [String],
    /// The plan run.
    pub plan: &'a Plan,
    /// Where its artifacts are.
    pub cache: &'a Cache,
    /// The plan's digest.
    pub fingerprint: Digest,
}

/// What came of it.
#[derive(Default)]
pub struct Delivered {
    /// All figures of the run.
    pub metrics: BTreeMap<String, f64>,
    /// Names that belong beside them.
    pub labels: BTreeMap<String, String>,
    /// Some artifact was damaged in the cache and has been dropped: run again and deliver again.
    pub damaged: bool,
    /// One line each.
    pub warnings: Vec<String>,
    /// The artifact that each figure stands in.
    pub origins: BTreeMap<String, Digest>,
    /// Files in the folder, and the artifact that each was made of.
    pub files: BTreeMap<String, Digest>,
}

/// `metrics.json`. Keys are stable: later versions add and never rename.
#[derive(Debug, Serialize, Deserialize)]
pub struct MetricsFile {
    /// The graph's name.
    pub graph: String,
    /// What ran.
    pub nodes: Vec<NodeLine>,
    /// Figures by name, null when they could not be measured; names of models by theirs; and for every node with outputs
    /// `ID.seconds`, how long it ran when it made them.
    pub metrics: BTreeMap<String, Option<Figure>>,
}

impl MetricsFile {
    /// A figure that is a number.
    pub fn number(&self, key: &str) -> Option<f64> {
        match self.metrics.get(key) {
            Some(Some(Figure::Number(value))) => Some(*value),
            _ => None,
        }
    }
}

/// A value of `metrics.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Figure {
    /// A figure of merit.
    Number(f64),
    /// The name of what made or measured the others.
    Name(String),
}

/// One node of `metrics.json`.
#[derive(Debug, Serialize, Deserialize)]
pub struct NodeLine {
    /// Its id.
    pub id: String,
    /// Its kind.
    pub kind: String,
    /// How its turn ended.
    pub status: Status,
    /// Wall time of its turn.
    pub seconds: f64,
}

/// `run.json`: where the results come from.
#[derive(Serialize)]
struct RunFile<'a> {
    heartian: &'static str,
    graph: GraphPart<'a>,
    fingerprint: Digest,
    nodes: Vec<NodePart<'a>>,
    written: &'a Written,
}

#[derive(Serialize)]
struct GraphPart<'a> {
    name: &'a str,
    file: &'a str,
    text: &'a str,
    set: &'a [String],
    seed: u64,
}

#[derive(Serialize)]
struct NodePart<'a> {
    id: &'a str,
    kind: &'static str,
    revision: u32,
    params: &'a serde_json::Map<String, serde_json::Value>,
    status: Status,
    key: Option<Digest>,
    outputs: &'a BTreeMap<&'static str, Digest>,
    error: Option<&'a str>,
}

/// Files written, by the output they came from.
type Written = BTreeMap<String, Entry>;

#[derive(Serialize, Deserialize)]
struct Entry {
    digest: Digest,
    /// Size in bytes by path below the folder.
    files: BTreeMap<String, u64>,
}

/// Writes what the run made into `folder`.
pub fn deliver(delivery: &Delivery<'_>, reports: &[NodeReport], folder: &Path) -> Result<Delivered> {
    std::fs::create_dir_all(folder)
        .into_diagnostic()
        .wrap_err_with(|| format!("cannot make `{}`", folder.display()))?;
    let mut courier =
        Courier { delivery, folder, before: written_before(folder), now: Written::new(), done: Delivered::default() };
    for (index, report) in reports.iter().enumerate() {
        for port in delivery.plan.nodes[index].kind.outputs {
            let Some(digest) = report.outputs.get(port.name) else { continue };
            let name = format!("{}.{}", report.id, port.name);
            if port.artifact == Metrics::TYPE {
                courier.metrics(&name, digest)?;
            } else if port.artifact == Labels::TYPE {
                courier.labels(digest)?;
            } else if port.artifact == Files::TYPE {
                courier.files(&name, digest)?;
            }
            if delivery.plan.exports.iter().any(|(node, export)| *node == index && export.name == port.name) {
                courier.export(&name, digest, port.artifact.name)?;
            }
        }
    }
    courier.sweep();
    courier.write_reports(reports)?;
    for entry in courier.now.values() {
        courier.done.files.extend(entry.files.keys().map(|path| (path.clone(), entry.digest)));
    }
    Ok(courier.done)
}

/// What an earlier run left; unreadable counts as nothing.
fn written_before(folder: &Path) -> Written {
    #[derive(Deserialize)]
    struct Before {
        written: Written,
    }
    let bytes = std::fs::read(folder.join("run.json")).ok();
    bytes
        .and_then(|bytes| serde_json::from_slice::<Before>(&bytes).ok())
        .map_or(Written::new(), |before| before.written)
}

struct Courier<'a> {
    delivery: &'a Delivery<'a>,
    folder: &'a Path,
    before: Written,
    now: Written,
    done: Delivered,
}

impl Courier<'_> {
    fn metrics(&mut self, name: &str, digest: &Digest) -> Result<()> {
        let Some(metrics) = load::<Metrics>(self.delivery.cache, digest)? else {
            self.done.damaged = true;
            return Ok(());
        };
        for (key, value) in &metrics.0 {
            self.done.origins.insert(key.clone(), *digest);
            let clash =
                self.done.metrics.insert(key.clone(), *value).is_some_and(|other| other.to_bits() != value.to_bits());
            if clash {
                self.done
                    .warnings
                    .push(format!("`{name}` and an earlier node both give `{key}`; the later one counts"));
            }
        }
        Ok(())
    }

    fn labels(&mut self, digest: &Digest) -> Result<()> {
        match load::<Labels>(self.delivery.cache, digest)? {
            Some(labels) => self.done.labels.extend(labels.0.clone()),
            None => self.done.damaged = true,
        }
        Ok(())
    }

    /// Whether the files of an output are there already, as `run.json` says; then they are kept.
    fn is_there(&mut self, name: &str, digest: &Digest) -> bool {
        let Some(entry) = self.before.get(name).filter(|entry| entry.digest == *digest) else { return false };
        let size = |path: &str| std::fs::metadata(self.folder.join(path)).map(|metadata| metadata.len()).ok();
        let there = entry.files.iter().all(|(path, bytes)| size(path) == Some(*bytes));
        if there && let Some(entry) = self.before.remove(name) {
            self.now.insert(name.to_owned(), entry);
        }
        there
    }

    fn files(&mut self, name: &str, digest: &Digest) -> Result<()> {
        if self.is_there(name, digest) {
            return Ok(());
        }
        let Some(files) = load::<Files>(self.delivery.cache, digest)? else {
            self.done.damaged = true;
            return Ok(());
        };
        let mut entry = Entry { digest: *digest, files: BTreeMap::new() };
        for (path, bytes) in files.iter() {
            if self.now.values().any(|other| other.files.contains_key(path)) {
                self.done
                    .warnings
                    .push(format!("`{name}` and an earlier node both write `{path}`; the later one counts"));
            }
            write(&self.folder.join(path), |file| file.write_all(bytes))?;
            entry.files.insert(path.to_owned(), bytes.len() as u64);
        }
        self.now.insert(name.to_owned(), entry);
        Ok(())
    }

    fn export(&mut self, name: &str, digest: &Digest, artifact: &str) -> Result<()> {
        if self.is_there(name, digest) {
            return Ok(());
        }
        let (path, size) = if artifact == Clip::TYPE.name {
            let Some(clip) = load::<Clip>(self.delivery.cache, digest)? else {
                self.done.damaged = true;
                return Ok(());
            };
            let Some(size) = AviForm::of(&clip).size() else {
                self.done.warnings.push(format!("`{name}` is too long for an AVI file and stays in the cache only"));
                return Ok(());
            };
            let path = format!("{name}.avi");
            write(&self.folder.join(&path), |file| write_clip(&clip, file))?;
            (path, size)
        } else {
            let Some(mut stored) = self.delivery.cache.open_verified(digest)? else {
                self.done.damaged = true;
                return Ok(());
            };
            let path = format!("{name}.safetensors");
            let size = stored.metadata().into_diagnostic()?.len();
            write(&self.folder.join(&path), |file| std::io::copy(&mut stored, file).map(drop))?;
            (path, size)
        };
        self.now.insert(name.to_owned(), Entry { digest: *digest, files: BTreeMap::from([(path, size)]) });
        Ok(())
    }

    /// Removes files that an earlier run wrote here and this one does not make.
    fn sweep(&self) {
        let kept: BTreeSet<&String> = self.now.values().flat_map(|entry| entry.files.keys()).collect();
        for path in self.before.values().flat_map(|entry| entry.files.keys()).filter(|path| !kept.contains(path)) {
            let below = Path::new(path).components().all(|part| matches!(part, std::path::Component::Normal(_)));
            if below {
                // A file that stays is not lost, only old.
                let _ = std::fs::remove_file(self.folder.join(path));
            }
        }
    }

    fn write_reports(&self, reports: &[NodeReport]) -> Result<()> {
        let Delivery { graph, sets, plan, fingerprint, .. } = self.delivery;
        let number = |value: &f64| value.is_finite().then_some(Figure::Number(*value));
        let figures = self.done.metrics.iter().map(|(key, value)| (key.clone(), number(value)));
        let labels = self.done.labels.iter().map(|(key, name)| (key.clone(), Some(Figure::Name(name.clone()))));
        let made = reports.iter().filter(|report| !report.outputs.is_empty());
        let times = made.map(|report| (format!("{}.seconds", report.id), number(&rounded(report.work_seconds))));
        let metrics = MetricsFile {
            graph: plan.name.clone(),
            nodes: reports.iter().map(line).collect(),
            metrics: times.chain(labels).chain(figures).collect(),
        };
        let nodes = reports.iter().zip(&plan.nodes).map(|(report, node)| NodePart {
            id: &report.id,
            kind: report.kind,
            revision: node.kind.revision,
            params: &node.values,
            status: report.status,
            key: report.key,
            outputs: &report.outputs,
            error: report.error.as_ref().map(|error| error.message.as_str()),
        });
        let graph =
            GraphPart { name: graph.name(), file: graph.file(), text: graph.text(), set: sets, seed: graph.seed() };
        let run = RunFile {
            heartian: env!("CARGO_PKG_VERSION"),
            graph,
            fingerprint: *fingerprint,
            nodes: nodes.collect(),
            written: &self.now,
        };
        write_json(&self.folder.join("metrics.json"), &metrics)?;
        write_json(&self.folder.join("run.json"), &run)
    }
}

fn line(report: &NodeReport) -> NodeLine {
    NodeLine {
        id: report.id.to_string(),
        kind: report.kind.to_owned(),
        status: report.status,
        seconds: rounded(report.seconds),
    }
}

/// Seconds to the microsecond.
fn rounded(seconds: f64) -> f64 {
    (seconds * 1e6).round() / 1e6
}

/// Writes a value as JSON, as [`write_text`] does.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_string_pretty(value).into_diagnostic()?;
    text.push('\n');
    write_text(path, &text)
}

/// Writes a text beside its place and renames it into it.
pub fn write_text(path: &Path, text: &str) -> Result<()> {
    write(path, |file| file.write_all(text.as_bytes()))
}

/// Writes a file beside its place and renames it into it.
fn write(path: &Path, content: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let attempt = || -> std::io::Result<()> {
        let folder: PathBuf = path.parent().unwrap_or(Path::new(".")).to_owned();
        std::fs::create_dir_all(&folder)?;
        let mut file = std::io::BufWriter::with_capacity(1 << 20, tempfile::NamedTempFile::new_in(&folder)?);
        content(&mut file)?;
        let file = file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
        make_readable(file.as_file())?;
        file.persist(path).map(drop).map_err(|error| error.error)
    };
    attempt().into_diagnostic().wrap_err_with(|| format!("cannot write `{}`", path.display()))
}

/// Temporary files are the owner's alone; results are for whoever may read the folder.
#[cfg(unix)]
fn make_readable(file: &std::fs::File) -> std::io::Result<()> {
    file.set_permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644))
}

#[cfg(not(unix))]
fn make_readable(_: &std::fs::File) -> std::io::Result<()> {
    Ok(())
}
