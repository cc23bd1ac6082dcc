//! `heartian datasets`: what a folder of a public data set holds.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};
use heartian_capture::dataset::{Recording, list};
use miette::{IntoDiagnostic, Result, miette};

use crate::summary::table;

/// What to do with data sets.
#[derive(Subcommand)]
pub enum DatasetsAction {
    /// List the recordings below a folder: labels, length, frame rate, and what is missing
    Ls(ListArguments),
}

/// A listing.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian datasets ls MMPD
  heartian datasets ls MMPD --light LED-low,LED-high --motion Stationary --skin-tone 5,6
  heartian datasets ls PURE --where motion='Small Rotation' --json
  heartian run graphs/ubfc.ron --set frames.source=UBFC/subject1
  for r in $(heartian datasets ls UBFC --paths); do heartian measure $r; done

Recordings are recognised by their layout:
  UBFC-rPPG  subjectN/vid.avi, ground_truth.txt (second data set)
  PURE       SS-TT/SS-TT/*.png, SS-TT.json
  MMPD       subjectN/pN_k.mat (MATLAB 5)
  SCAMPS     *.mat (MATLAB 7.3)
  iBVP       pXX_y/pXX_y_rgb/*.bmp, pXX_y_bvp.csv
Labels keep each data set's own words; letters' case does not matter in filters. Several values: separated by commas.")]
pub struct ListArguments {
    /// The data set's folder, or one recording
    pub dir: PathBuf,
    /// Only recordings in this light (MMPD: LED-low, LED-high, Incandescent, Nature)
    #[arg(long, value_name = "WORDS", value_delimiter = ',')]
    pub light: Vec<String>,
    /// Only recordings with this motion (MMPD: Stationary, Rotation, Talking, Walking; PURE: Steady, Talking, …)
    #[arg(long, value_name = "WORDS", value_delimiter = ',')]
    pub motion: Vec<String>,
    /// Only subjects of this Fitzpatrick skin type (MMPD's `skin_color`: 3 to 6)
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    pub skin_tone: Vec<String>,
    /// Only recordings whose label has one of these values; may be repeated
    #[arg(long = "where", value_name = "LABEL=WORDS")]
    pub labels: Vec<String>,
    /// Only recordings of which nothing is missing
    #[arg(long)]
    pub complete: bool,
    /// Print paths only, one a line, for `--set frames.source=`
    #[arg(long, conflicts_with = "json")]
    pub paths: bool,
    /// For machines
    #[arg(long)]
    pub json: bool,
}

/// Lists.
pub fn act(action: &DatasetsAction) -> Result<ExitCode> {
    let DatasetsAction::Ls(arguments) = action;
    let wanted = filters(arguments)?;
    let all = list(&arguments.dir).into_diagnostic()?;
    let found = all.len();
    let fits = |one: &Recording| one.fits(&wanted) && (!arguments.complete || one.missing.is_empty());
    let chosen: Vec<Recording> = all.into_iter().filter(fits).collect();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&chosen).into_diagnostic()?);
        return Ok(ExitCode::SUCCESS);
    }
    if found == 0 {
        let help = "give the folder that holds the subjects; `heartian datasets ls --help` shows the layouts";
        return Err(miette!(help = help, "`{}` holds no recording of a data set known here", arguments.dir.display()));
    }
    if arguments.paths {
        chosen.iter().for_each(|one| println!("{}", one.source.display()));
        return Ok(ExitCode::SUCCESS);
    }
    let heading = ["set", "recording", "seconds", "fps", "pulse", "labels", "missing", "path"].map(str::to_owned);
    let rows: Vec<Vec<String>> = std::iter::once(heading.to_vec()).chain(chosen.iter().map(row)).collect();
    print!("{}", table(&rows, &[false, false, true, true, true]));
    let bad = chosen.iter().filter(|one| !one.missing.is_empty()).count();
    println!("{} of {found} recordings, {bad} with something missing", chosen.len());
    Ok(ExitCode::SUCCESS)
}

/// The labels asked for, by the data sets' names.
fn filters(arguments: &ListArguments) -> Result<BTreeMap<String, Vec<String>>> {
    let mut wanted = BTreeMap::new();
    let named = [("light", &arguments.light), ("motion", &arguments.motion), ("skin_color", &arguments.skin_tone)];
    for (label, values) in named.into_iter().filter(|(_, values)| !values.is_empty()) {
        wanted.insert(label.to_owned(), values.clone());
    }
    for text in &arguments.labels {
        let (label, values) = text.split_once('=').ok_or_else(|| {
            miette!(help = "write `--where gender=female`", "`--where {text}` names no label and value")
        })?;
        wanted.insert(label.to_owned(), values.split(',').map(str::to_owned).collect());
    }
    Ok(wanted)
}

fn row(one: &Recording) -> Vec<String> {
    let number = |value: Option<f64>, digits: usize| value.map_or("?".into(), |value| format!("{value:.digits$}"));
    let labels = one.labels.iter().map(|(label, value)| format!("{label}={value}"));
    vec![
        one.set.name().to_owned(),
        one.name.clone(),
        number(one.seconds, 1),
        number(one.hertz, 2),
        one.ppg_hertz.map_or("-".into(), |hertz| format!("{hertz:.1} Hz")),
        labels.collect::<Vec<_>>().join(", "),
        if one.missing.is_empty() { "-".into() } else { one.missing.join("; ") },
        one.source.display().to_string(),
    ]
}
