//! Parity with rPPG-Toolbox and SciPy: every `signals/` and `unsupervised/` file of the golden manifest, at the tolerance
//! the manifest states. The folder is `$HEARTIAN_GOLDEN`, or `../shared/golden` beside the repository; without it the
//! tests say "skipped" and pass. Each file reports its largest deviation in units of its tolerance (must be ≤ 1).

mod golden {
    pub mod file;
    pub mod metrics;
    pub mod signals;
    pub mod unsupervised;
}

use golden::file::{Checks, Golden, Outcome};

/// What checks one golden file.
type Comparer = fn(&Golden, &mut Checks) -> Outcome<()>;

/// The check of a manifest entry; `None` for the files of other crates.
fn comparer(file: &str) -> Option<Comparer> {
    match file {
        "signals/detrend.npz" => Some(golden::signals::detrend),
        "signals/bandpass_filtfilt.npz" => Some(golden::signals::bandpass),
        "signals/hr_snr.npz" => Some(golden::signals::heart_rate),
        "signals/macc.npz" => Some(golden::signals::macc),
        "signals/per_video.npz" => Some(golden::metrics::per_video),
        "signals/dataset_metrics.npz" => Some(golden::metrics::dataset),
        "signals/metric_formulas.npz" => Some(golden::metrics::formulas),
        _ if file.starts_with("unsupervised/") => Some(golden::unsupervised::case),
        _ => None,
    }
}

#[test]
fn every_golden_file_agrees() -> Outcome<()> {
    let Some(folder) = golden::file::folder() else {
        println!("skipped: no golden folder; set HEARTIAN_GOLDEN to one");
        return Ok(());
    };
    let entries = golden::file::manifest(&folder)?;
    let ours = |file: &str| file.starts_with("signals/") || file.starts_with("unsupervised/");
    let mut failures = Vec::new();
    let mut walked = 0;
    for entry in entries.iter().filter(|entry| ours(&entry.file)) {
        let compare = comparer(&entry.file).ok_or_else(|| format!("{}: nothing checks it", entry.file))?;
        let mut checks = Checks::default();
        compare(&Golden::open(&folder, entry)?, &mut checks)?;
        println!("{:32} {checks}", entry.file);
        failures.extend(checks.failures().map(|failure| format!("{}: {failure}", entry.file)));
        walked += 1;
    }
    assert!(walked >= 11, "only {walked} golden files were walked");
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    Ok(())
}
