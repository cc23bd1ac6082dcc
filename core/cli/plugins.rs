//! `heartian plugins`, and the kinds of nodes that all commands know: those linked in and those that plugins bring.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::OnceLock;
use std::time::Duration;

use heartian_graph::{
    HostCommand, Plugin, PluginError, PluginLimits, PluginLock, Plugins, Registry, TrustedPlugin, plugin_files,
};
use miette::{IntoDiagnostic, Result, miette};

use crate::arguments::{PluginArguments, PluginsAction};
use crate::manual;
use crate::sizes;
use crate::summary::table;

/// Who may run inside the program, in the current folder.
const LOCK: &str = "plugins.lock";

/// A library and what came of it.
type Found = (PathBuf, Result<Plugin, PluginError>);

static ARGUMENTS: OnceLock<PluginArguments> = OnceLock::new();

/// Keeps what the command line says about plugins, for [`registry`].
pub fn remember(arguments: PluginArguments) {
    ARGUMENTS.get_or_init(|| arguments);
}

fn arguments() -> &'static PluginArguments {
    ARGUMENTS.get_or_init(PluginArguments::default)
}

/// The files that the command line names.
pub fn named_files() -> &'static [PathBuf] {
    &arguments().files
}

/// All kinds of nodes, those of plugins included. A plugin that cannot be used is a warning, unless its file is named
/// and not there.
pub fn registry() -> Result<&'static Registry> {
    static REGISTRY: OnceLock<Registry> = OnceLock::new();
    if let Some(registry) = REGISTRY.get() {
        return Ok(registry);
    }
    let (registry, found) = load_all()?;
    for (path, error) in found.iter().filter_map(|(path, loaded)| Some((path, loaded.as_ref().err()?))) {
        eprintln!("warning: {}; `heartian plugins check {}` tries again", one_line(error), path.display());
    }
    Ok(REGISTRY.get_or_init(|| registry))
}

fn one_line(error: &PluginError) -> String {
    let help = miette::Diagnostic::help(error).map_or(String::new(), |help| format!(" ({help})"));
    format!("{error}{help}")
}

/// Every plugin that is found, and the registry of those that can be used.
fn load_all() -> Result<(Registry, Vec<Found>)> {
    let mut registry = Registry::compiled_in();
    let named = &arguments().files;
    if let Some(missing) = named.iter().find(|file| !file.is_file()) {
        let reason = "there is no such file".to_owned();
        return Err(PluginError::Read { path: missing.clone(), reason }.into());
    }
    let files = plugin_files(&[named.clone(), places()].concat());
    if files.is_empty() {
        return Ok((registry, Vec::new()));
    }
    let plugins = plugins()?;
    let mut found: Vec<Found> = Vec::new();
    for file in files {
        let loaded = plugins.load(&file, &registry);
        // The same library in two places is one library.
        let known = |plugin: &Plugin| {
            found.iter().any(|(_, other)| other.as_ref().is_ok_and(|other| other.digest == plugin.digest))
        };
        if loaded.as_ref().is_ok_and(known) {
            continue;
        }
        let added = loaded.and_then(|plugin| registry.add(&plugin).map(|()| plugin));
        found.push((file, added));
    }
    Ok((registry, found))
}

/// How plugins are loaded.
fn plugins() -> Result<Plugins> {
    let program = std::env::current_exe().into_diagnostic()?;
    let lock = PluginLock::read(Path::new(LOCK)).map_err(|reason| {
        miette!(help = format!("delete `{LOCK}` and trust your plugins again: heartian plugins trust FILE"), "{reason}")
    })?;
    Ok(Plugins {
        host: HostCommand { program, arguments: vec![OsString::from("plugin-host")] },
        limits: limits(arguments())?,
        memory: folder(&["XDG_CACHE_HOME"], ".cache").map(|folder| folder.join("plugins")),
        lock,
    })
}

fn limits(arguments: &PluginArguments) -> Result<PluginLimits> {
    let mut limits = PluginLimits::default();
    if let Some(seconds) = arguments.silence {
        let usable = Duration::try_from_secs_f64(seconds).ok().filter(|silence| !silence.is_zero());
        limits.silence =
            usable.ok_or_else(|| miette!("--plugin-timeout takes a number of seconds above 0, not {seconds}"))?;
    }
    if let Some(text) = &arguments.memory {
        limits.memory_bytes = sizes::parse(text).map_err(|wrong| {
            miette!(help = "for example 4G or 512M", "--plugin-memory does not understand `{text}`: {wrong}")
        })?;
    }
    Ok(limits)
}

/// The user's folder of a sort for Heartian: that of an environment variable, or one below the home folder.
fn folder(variables: &[&str], below_home: &str) -> Option<PathBuf> {
    let from = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let named = variables.iter().find_map(|name| from(name).filter(|path| path.is_absolute()));
    let found = named.or_else(|| from("HOME").map(|home| home.join(below_home))).or_else(|| from("LOCALAPPDATA"))?;
    Some(found.join("heartian"))
}

/// Where plugins are looked for, in order.
fn places() -> Vec<PathBuf> {
    let path = std::env::var_os("HEARTIAN_PLUGIN_PATH").unwrap_or_default();
    let mut places: Vec<PathBuf> = std::env::split_paths(&path).filter(|place| !place.as_os_str().is_empty()).collect();
    places.extend(folder(&["XDG_DATA_HOME"], ".local/share").map(|folder| folder.join("plugins")));
    let program = std::env::current_exe().ok();
    places.extend(program.and_then(|program| Some(program.parent()?.join("plugins"))));
    places
}

/// Lists, checks or trusts.
pub fn act(action: &PluginsAction) -> Result<ExitCode> {
    match action {
        PluginsAction::Ls => list(),
        PluginsAction::Check { file } => check(file),
        PluginsAction::Trust { file } => trust(file),
    }
}

fn list() -> Result<ExitCode> {
    let (_, found) = load_all()?;
    let mut rows = Vec::new();
    for (path, loaded) in &found {
        let path = path.display().to_string();
        rows.push(match loaded {
            Ok(plugin) => {
                let kinds: Vec<&str> = plugin.kinds.iter().map(|kind| kind.kind).collect();
                vec![format!("{} {}", plugin.name, plugin.version), kinds.join(", "), runs(plugin).to_owned(), path]
            }
            Err(_) => vec!["-".to_owned(), "-".to_owned(), "cannot be used".to_owned(), path],
        });
    }
    print!("{}", table(&rows, &[]));
    let broken: Vec<&PluginError> = found.iter().filter_map(|(_, loaded)| loaded.as_ref().err()).collect();
    broken.iter().for_each(|error| println!("\n{}", one_line(error)));
    if found.is_empty() {
        println!("No plugins. They are looked for in:");
        places().iter().for_each(|place| println!("  {}", place.display()));
    }
    Ok(if broken.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn runs(plugin: &Plugin) -> &'static str {
    if plugin.trusted { "trusted" } else { "in its own process" }
}

/// Loads a library in a child process, whatever is remembered of it.
fn load_afresh(file: &Path) -> Result<Plugin> {
    let registry = Registry::compiled_in();
    let plugin = plugins()?.load_afresh(file, &registry)?;
    registry.clone().add(&plugin)?;
    Ok(plugin)
}

fn check(file: &Path) -> Result<ExitCode> {
    let plugin = load_afresh(file)?;
    println!("{} {}, {}\n{}\n", plugin.name, plugin.version, runs(&plugin), plugin.digest);
    for kind in &plugin.kinds {
        println!("{}", manual::page(kind));
    }
    println!("nothing wrong.");
    Ok(ExitCode::SUCCESS)
}

fn trust(file: &Path) -> Result<ExitCode> {
    let plugin = load_afresh(file)?;
    let path = Path::new(LOCK);
    let mut lock = PluginLock::read(path).map_err(|reason| miette!("{reason}"))?;
    let (name, version) = (plugin.name.to_owned(), plugin.version.to_owned());
    lock.add(TrustedPlugin { name, version, digest: plugin.digest });
    lock.write(path).map_err(|error| {
        miette!(help = "check free space and permissions of this folder", "`{LOCK}` cannot be written: {error}")
    })?;
    println!("{} {} now runs inside Heartian when started from this folder.", plugin.name, plugin.version);
    println!("A mistake in it can now end a whole run. To take it back, remove its entry from `{LOCK}`.");
    Ok(ExitCode::SUCCESS)
}
