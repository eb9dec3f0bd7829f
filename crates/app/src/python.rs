//! Which Python runs inside, and how is it started? The user's virtual environment, with our package in it.

use std::env;
use std::ffi::CString;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use mirrorball_py::_core;
use pyo3::ffi;
use pyo3::prelude::*;

/// The Python that the executable was built with.
const BUILD_PYTHON: &str = env!("MIRRORBALL_BUILD_PYTHON");

/// The virtual environment that `make` keeps beside the sources.
const BUILD_VENV: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../.venv");

/// Starts Python once, in the environment of `--python`, else of `$VIRTUAL_ENV`, else of the build.
///
/// `python` is an interpreter or the folder of a virtual environment.
pub(crate) fn start(python: Option<&Path>) -> Result<()> {
    let program = interpreter(python)?;
    pyo3::append_to_inittab!(_core);
    initialize(&program)
        .with_context(|| format!("cannot start Python as {}", program.display()))?;
    Python::attach(|py| {
        mirrorball_py::embedded::install(py)?;
        let signal = py.import("signal")?;
        let handler = signal.getattr("default_int_handler")?;
        // Who is asked to end cleans up, whichever way he is asked.
        for name in ["SIGINT", "SIGTERM"] {
            signal.call_method1("signal", (signal.getattr(name)?, &handler))?;
        }
        PyResult::Ok(())
    })
    .context("cannot prepare Python")?;
    Python::attach(|py| {
        let Err(error) = py.import("numpy") else {
            return Ok(());
        };
        if error.is_instance_of::<pyo3::exceptions::PyKeyboardInterrupt>(py) {
            anyhow::bail!("interrupted");
        }
        Err(error).with_context(|| {
            format!(
                "{} has no numpy: install requirements.txt there, or name another environment with --python",
                program.display()
            )
        })
    })
}

/// Starts Python as `script` would; its version and where it is.
pub(crate) fn check() -> Result<String> {
    start(None)?;
    let version = Python::attach(|py| -> PyResult<String> {
        let sys = py.import("sys")?;
        let version: String = sys.getattr("version")?.extract()?;
        let prefix: String = sys.getattr("prefix")?.extract()?;
        let number = version.split_whitespace().next().unwrap_or_default();
        Ok(format!("{number} in {prefix}"))
    });
    finish();
    version.context("Python does not say its version")
}

/// Lets what was registered with `atexit` run and empties the buffers, as a Python of its own would do at its end.
pub(crate) fn finish() {
    Python::attach(|py| {
        let flush = || -> PyResult<()> {
            py.import("atexit")?.call_method0("_run_exitfuncs")?;
            for stream in ["stdout", "stderr"] {
                py.import("sys")?.getattr(stream)?.call_method0("flush")?;
            }
            Ok(())
        };
        if let Err(error) = flush() {
            error.print(py);
        }
    });
}

/// As Python's own `traceback` prints it, which knows the lines of the modules that we carry.
pub(crate) fn print_traceback(py: Python<'_>, error: &PyErr) {
    let printed = py
        .import("traceback")
        .and_then(|module| module.call_method1("print_exception", (error.value(py),)));
    if let Err(other) = printed {
        other.display(py);
    }
}

fn interpreter(python: Option<&Path>) -> Result<PathBuf> {
    if let Some(given) = python {
        let program = if given.is_dir() {
            given.join("bin/python3")
        } else {
            given.to_owned()
        };
        ensure!(
            program.exists(),
            "--python {}: no interpreter there",
            given.display()
        );
        return ensure_matching_version(program);
    }
    if let Some(folder) = env::var_os("VIRTUAL_ENV").filter(|folder| !folder.is_empty()) {
        let program = Path::new(&folder).join("bin/python3");
        ensure!(
            program.exists(),
            "VIRTUAL_ENV={}: no interpreter there",
            Path::new(&folder).display()
        );
        return ensure_matching_version(program);
    }
    let kept = Path::new(BUILD_VENV).join("bin/python3");
    Ok(if kept.exists() {
        kept
    } else {
        PathBuf::from(BUILD_PYTHON)
    })
}

/// Refuses a virtual environment of another Python version: its compiled packages do not fit this libpython.
fn ensure_matching_version(program: PathBuf) -> Result<PathBuf> {
    let ours = format!("3.{}", linked_minor());
    let Some(folder) = program.parent().and_then(Path::parent) else {
        return Ok(program);
    };
    let Ok(text) = std::fs::read_to_string(folder.join("pyvenv.cfg")) else {
        return Ok(program);
    };
    let version = text.lines().find_map(|line| {
        let (key, value) = line.split_once('=')?;
        matches!(key.trim(), "version" | "version_info").then(|| value.trim().to_owned())
    });
    match version {
        Some(version) if version != ours && !version.starts_with(&format!("{ours}.")) => bail!(
            "{} is a Python {version}, but mirrorball is linked with Python {ours}: make an environment with python{ours} -m venv",
            folder.display()
        ),
        _ => Ok(program),
    }
}

fn linked_minor() -> u8 {
    #[expect(
        unsafe_code,
        reason = "a C string that never changes and needs no interpreter"
    )]
    let version = unsafe { std::ffi::CStr::from_ptr(ffi::Py_GetVersion()) };
    let text = version.to_string_lossy();
    let minor = text.split(['.', ' ', '+', 'r', 'a', 'b']).nth(1);
    minor.and_then(|minor| minor.parse().ok()).unwrap_or(11)
}

/// An embedded interpreter ignores `VIRTUAL_ENV`; one that is told it runs as the environment's own program does not.
#[expect(
    unsafe_code,
    reason = "Python's start-up configuration exists in C alone"
)]
fn initialize(program: &Path) -> Result<()> {
    let name = CString::new(program.as_os_str().as_bytes())?;
    let status = unsafe {
        let mut config = std::mem::MaybeUninit::<ffi::PyConfig>::zeroed();
        ffi::PyConfig_InitPythonConfig(config.as_mut_ptr());
        let mut config = config.assume_init();
        config.parse_argv = 0;
        let field = &raw mut config.program_name;
        let mut status = ffi::PyConfig_SetBytesString(&raw mut config, field, name.as_ptr());
        if ffi::PyStatus_Exception(status) == 0 {
            status = ffi::Py_InitializeFromConfig(&raw const config);
        }
        ffi::PyConfig_Clear(&raw mut config);
        status
    };
    if unsafe { ffi::PyStatus_Exception(status) } != 0 {
        let reason = if status.err_msg.is_null() {
            "no reason given".into()
        } else {
            unsafe { std::ffi::CStr::from_ptr(status.err_msg) }.to_string_lossy()
        };
        bail!("{reason}");
    }
    // This thread lets go of the interpreter; `Python::attach` takes it again wherever it is needed.
    unsafe { ffi::PyEval_SaveThread() };
    Ok(())
}
