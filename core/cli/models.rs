//! `heartian models`: the face models that real videos need.

use std::process::ExitCode;

use heartian_face::models::{Set, State, Status, install, list, verify};
use miette::{IntoDiagnostic, Result};

use crate::arguments::{ModelsAction, ModelsChoice};
use crate::sizes;
use crate::summary::table;

/// Fetches, lists or verifies.
pub fn act(action: ModelsAction) -> Result<ExitCode> {
    let all = match action {
        ModelsAction::Install { what } => {
            for set in what.sets() {
                install(*set, &mut |line| eprintln!("{line}")).into_diagnostic()?;
            }
            list().into_diagnostic()?
        }
        ModelsAction::Ls => list().into_diagnostic()?,
        ModelsAction::Verify => {
            verify().into_diagnostic()?;
            list().into_diagnostic()?
        }
    };
    let mut rows =
        vec![["model", "set", "state", "size", "licence", "from", "sha256", "file"].map(str::to_owned).to_vec()];
    rows.extend(all.iter().map(row));
    print!("{}", table(&rows, &[false, false, false, true]));
    Ok(ExitCode::SUCCESS)
}

impl ModelsChoice {
    fn sets(self) -> &'static [Set] {
        match self {
            Self::Face => &[Set::Face],
            Self::Irises => &[Set::Irises],
            Self::Head => &[Set::Head],
            Self::All => &Set::ALL,
        }
    }
}

fn row(status: &Status) -> Vec<String> {
    let state = match status.state {
        State::Installed => "installed",
        State::Missing => "missing",
        State::Damaged => "damaged",
    };
    let size = if status.bytes == 0 { String::new() } else { sizes::show(status.bytes) };
    vec![
        status.name.to_owned(),
        status.set.name().to_owned(),
        state.to_owned(),
        size,
        status.licence.to_owned(),
        status.source.clone(),
        status.sha256.chars().take(12).collect(),
        status.path.display().to_string(),
    ]
}
