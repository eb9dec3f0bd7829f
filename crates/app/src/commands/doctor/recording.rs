//! Which set-up explains a recording or a log best? Prints the edits that make it fit better.

use std::path::Path;

use anyhow::{Result, bail};

use crate::commands::arguments::UsageError;
use crate::commands::locate::EXTERNAL_POINT_STD;
use pipeline::PipelineConfig;
use pipeline::recording::Recording;
use pipeline::run::{RecordingOptions, RecordingRun};
use pipeline::setup::Setup;
use pipeline::setup_check::{self, Effort, HALF_HINT, SetupReport, Suggestion};

/// Tries other set-ups on the recording folder or log.
pub(super) fn run(folder: &Path, map: Option<&Path>, json: bool) -> Result<()> {
    let report = if folder.is_file() {
        setup_check::check_log(folder, Effort::Full)?
    } else if folder.is_dir() {
        let setup = Setup::load(&folder.join("robot.toml"), map)?;
        let recording = Recording::open(folder, EXTERNAL_POINT_STD)?;
        let config = PipelineConfig::default();
        let report = setup_check::check_recording(&recording, &setup, &config, Effort::Full)?;
        let is_fine = report.warnings.is_empty() && report.figures.is_some();
        let path_warnings = is_fine.then(|| locate(folder, map)).transpose()?;
        report.with_path_warnings(path_warnings.unwrap_or_default())
    } else {
        let place = folder.display();
        return Err(UsageError(format!("{place} is neither a folder nor a log")).into());
    };
    if json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        print(&report);
    }
    match report.warnings.len() {
        0 if report.figures.is_none() => bail!("nothing could be compared"),
        0 => Ok(()),
        1 => bail!("one doubt about the recording"),
        count => bail!("{count} doubts about the recording"),
    }
}

/// What the path of all poses betrays: a single place where the field file is wrong says little in the sum.
fn locate(folder: &Path, map: Option<&Path>) -> Result<Vec<String>> {
    let run = RecordingRun::open(&RecordingOptions {
        folder: folder.to_owned(),
        map: map.map(Path::to_owned),
        save_map: None,
        config: PipelineConfig::default(),
        external_point_std: EXTERNAL_POINT_STD,
    })?;
    let bar = crate::progress::bar(run.frames() as u64, "frames");
    let result = run.run(|_| {
        bar.inc(1);
        Ok(())
    })?;
    bar.finish_and_clear();
    Ok(result.path_warnings)
}

fn has_bad_images(report: &SetupReport) -> bool {
    let faults = report.image_faults.as_ref();
    faults.is_some_and(|faults| !faults.problems.is_empty())
}

fn print(report: &SetupReport) {
    match &report.figures {
        Some(figures) => println!("{} ({} keyframes)", figures.text(), figures.keyframes),
        None if has_bad_images(report) => {
            println!("too few images can be used to compare set-ups");
        }
        None => {
            println!("too few images with line points, or too little motion, to compare set-ups")
        }
    }
    if report.suggestions.is_empty() && report.warnings.is_empty() {
        if report.figures.is_some() {
            println!("no other set-up explains the recording better");
        }
        return;
    }
    let mut last_step = 0;
    for suggestion in &report.suggestions {
        let Suggestion {
            change,
            cause,
            firm,
            step,
            half_unknown,
            ..
        } = suggestion;
        let is_twin = *half_unknown && *step == last_step;
        let joint = match (*step == last_step, firm) {
            (true, _) => "or  ",
            (false, true) => "BAD ",
            (false, false) => "BAD perhaps ",
        };
        last_step = *step;
        println!("{joint}{cause}");
        println!("       -> {change}: {}", suggestion.explained_text());
        if is_twin {
            println!("       {HALF_HINT}");
        }
    }
    for doubt in &report.doubts {
        println!("BAD {doubt}");
    }
}
