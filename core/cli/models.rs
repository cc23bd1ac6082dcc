//! `heartian models`: the face models that real videos need.

use std::process::ExitCode;

use heartian_face::models::{State, Status, install, list, verify};
use miette::{IntoDiagnostic, Result};

use crate::arguments::ModelsAction;
use crate::summary::table;

/// Fetches, lists or verifies.
pub fn act(action: ModelsAction) -> Result<ExitCode> {
    let all = match action {
        ModelsAction::Install => install(&mut |line| eprintln!("{line}")).into_diagnostic()?,
        ModelsAction::Ls => list().into_diagnostic()?,
        ModelsAction::Verify => {
            verify().into_diagnostic()?;
            list().into_diagnostic()?
        }
    };
    let word = |state: &State| match state {
        State::Installed => "installed",
        State::Missing => "missing",
        State::Damaged => "damaged",
    };
    let row = |status: &Status| {
        vec![status.name.to_owned(), word(&status.state).to_owned(), status.path.display().to_string()]
    };
    print!("{}", table(&all.iter().map(row).collect::<Vec<_>>(), &[]));
    Ok(ExitCode::SUCCESS)
}
