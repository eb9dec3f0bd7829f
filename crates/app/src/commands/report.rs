//! `mirrorball report`: where a run went wrong and why, or how two runs differ, as one HTML page of the Python package.

use std::path::PathBuf;

use anyhow::Result;
use pyo3::prelude::*;

use crate::python;

/// Find the moments of a log that need a look, with their causes, and write a page; or compare two logs.
///
/// The moments: large errors, overconfident or uncertain poses, leaps, lost robots, slip, light, gaps.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball report game.mcap --out out/game\n         \
                  mirrorball report before.mcap after.mcap --out out/both"
)]
pub(crate) struct Args {
    /// The log.
    log: PathBuf,
    /// Another log to compare with it.
    second: Option<PathBuf>,
    /// Folder for index.html.
    #[arg(long)]
    out: PathBuf,
    /// Python interpreter or folder of a virtual environment (default: $VIRTUAL_ENV, else the build's).
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
}

/// Writes the page; `json` prints the result object instead of text.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    python::start(args.python.as_deref())?;
    let outcome = Python::attach(|py| {
        let called = || -> PyResult<String> {
            let commands = py.import("mirrorball.analysis.command")?;
            // As Python writes a name that is no UTF-8.
            let arguments = (
                args.log.as_os_str(),
                args.second.as_ref().map(|path| path.as_os_str()),
                args.out.as_os_str(),
            );
            let result = commands.call_method1("report", arguments)?;
            let formatter = if json { "as_json" } else { "as_text" };
            commands.call_method1(formatter, (result,))?.extract()
        };
        called()
            .map(|text| println!("{text}"))
            .map_err(|error| python::explain_error(py, &error))
    });
    python::finish();
    outcome
}
