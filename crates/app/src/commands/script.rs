//! `mirrorball script`: runs a Python file in the embedded interpreter, where `import mirrorball` works without installation.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use pyo3::exceptions::{PyKeyboardInterrupt, PySystemExit};
use pyo3::prelude::*;

use crate::python;

/// Run a Python file; `import mirrorball` gives this program's optics, renderer and mirror design.
///
/// The interpreter is that of --python, else of $VIRTUAL_ENV, else the build's. Ends with the exit code of the file, as
/// Python does: `sys.exit(3)` with 3, an exception with 1. SIGINT and SIGTERM raise KeyboardInterrupt; uncaught, it ends with 1.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball script py/examples/lima2001.py --out out/lima2001.png")]
pub(crate) struct Args {
    /// Python interpreter or folder of a virtual environment.
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// The file to run.
    file: PathBuf,
    /// Arguments of the file in `sys.argv`.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// The code with which a script ended by `SystemExit`; the program ends with it.
#[derive(Debug, thiserror::Error)]
#[error("the script ended with code {0}")]
pub(crate) struct ScriptExit(i64);

impl ScriptExit {
    /// The lowest eight bits, as in Python.
    pub(crate) fn code(&self) -> u8 {
        self.0.to_le_bytes()[0]
    }
}

/// Runs the file as `__main__`. An exception prints its traceback on standard error.
pub(crate) fn run(args: &Args) -> Result<()> {
    ensure!(args.file.is_file(), "{}: no such file", args.file.display());
    python::start(args.python.as_deref())?;
    let outcome = Python::attach(|py| execute(py, args).or_else(|error| script_result(py, &error)));
    python::finish();
    outcome
}

fn execute(py: Python<'_>, args: &Args) -> PyResult<()> {
    let sys = py.import("sys")?;
    let mut argv = vec![args.file.display().to_string()];
    argv.extend(args.arguments.iter().cloned());
    sys.setattr("argv", argv)?;
    // Modules in the script's folder can be imported, as usual in Python, even if the script changes the working folder.
    let file = args.file.canonicalize();
    if let Some(folder) = file.as_deref().unwrap_or(&args.file).parent() {
        sys.getattr("path")?
            .call_method1("insert", (0, folder.display().to_string()))?;
    }
    let run = py.import("runpy")?.getattr("run_path")?;
    run.call1((args.file.display().to_string(), py.None(), "__main__"))
        .map(drop)
}

/// The result of a script that ended with an exception.
fn script_result(py: Python<'_>, error: &PyErr) -> Result<()> {
    if error.is_instance_of::<PySystemExit>(py) {
        let code = error.value(py).getattr("code")?;
        if code.is_none() {
            return Ok(());
        }
        match code.extract::<i64>() {
            Ok(0) => return Ok(()),
            Ok(number) => return Err(ScriptExit(number).into()),
            Err(_) => bail!("{code}"),
        }
    }
    if error.is_instance_of::<PyKeyboardInterrupt>(py) {
        bail!("interrupted");
    }
    python::print_traceback(py, error);
    bail!("the script failed")
}
