//! Which Python interpreter is embedded, and how does it start? That of the user's virtual environment, with our package.

use std::env;
use std::ffi::CString;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use mirrorball_py::_core;
use pyo3::exceptions::{
    PyImportError, PyKeyboardInterrupt, PyMemoryError, PyOSError, PyValueError,
};
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;

/// The Python that the executable was built with.
const BUILD_PYTHON: &str = env!("MIRRORBALL_BUILD_PYTHON");

/// The virtual environment that `make` creates in the source folder. Empty in tarballs.
const BUILD_VENV: &str = env!("MIRRORBALL_BUILD_VENV");

/// Starts Python once: the interpreter of `--python`, else of `$VIRTUAL_ENV`, else of the build.
///
/// `python` is an interpreter or the folder of a virtual environment.
pub(crate) fn start(python: Option<&Path>) -> Result<()> {
    let program = interpreter(python)?;
    pyo3::append_to_inittab!(_core);
    initialize(&program)
        .with_context(|| format!("cannot start Python as {}", program.display()))?;
    Python::attach(|py| {
        let prepared = prepare(py);
        prepared.map_err(|error| match error {
            error if error.is_instance_of::<PyKeyboardInterrupt>(py) => anyhow!("interrupted"),
            error if error.is_instance_of::<PyImportError>(py) => {
                let text = format!(
                    "{}: no numpy. Install requirements.txt there, or choose another environment with --python",
                    program.display()
                );
                anyhow::Error::from(error).context(text)
            }
            error => anyhow::Error::from(error).context("cannot prepare Python"),
        })
    })
}

/// Makes our package and numpy importable, and lets signals interrupt scripts. A signal meanwhile waits: an import that it broke off
/// would fail later, and with another error.
fn prepare(py: Python<'_>) -> PyResult<()> {
    let signal = py.import("signal")?;
    let signals = ["SIGINT", "SIGTERM"].map(|name| signal.getattr(name));
    let [interrupt, terminate] = signals;
    let signals = [interrupt?, terminate?];
    let mask = |how: &str| {
        let how = signal.getattr(how)?;
        signal.call_method1("pthread_sigmask", (how, &signals))
    };
    mask("SIG_BLOCK")?;
    let handler = signal.getattr("default_int_handler")?;
    // Both signals raise KeyboardInterrupt, so that a script can clean up.
    for number in &signals {
        signal.call_method1("signal", (number, &handler))?;
    }
    // A pool ends its forked processes so.
    let reset = (
        signal.getattr("signal")?,
        &signals[1],
        signal.getattr("SIG_DFL")?,
    );
    let reset = py.import("functools")?.call_method1("partial", reset)?;
    let hooks = [("after_in_child", reset)].into_py_dict(py)?;
    py.import("os")?
        .call_method("register_at_fork", (), Some(&hooks))?;
    mirrorball_py::embedded::install(py)?;
    let loaded = mirrorball_py::embedded::load_numpy(py);
    mask("SIG_UNBLOCK")?;
    loaded
}

/// Starts Python as `script` does; returns its version and folder.
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
    version.context("cannot read Python's version")
}

/// Waits for threads, runs the `atexit` functions and flushes the streams, as the interpreter does at its end.
pub(crate) fn finish() {
    Python::attach(|py| {
        let flush = || -> PyResult<()> {
            // Threads that are no daemons, and the tasks of executors.
            py.import("threading")?.call_method0("_shutdown")?;
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

/// Prints an error by Python's `traceback`, which finds the source lines of the embedded modules.
pub(crate) fn print_traceback(py: Python<'_>, error: &PyErr) {
    let printed = py
        .import("traceback")
        .and_then(|module| module.call_method1("print_exception", (error.value(py),)));
    if let Err(other) = printed {
        other.display(py);
    }
}

fn interpreter(python: Option<&Path>) -> Result<PathBuf> {
    if let Some(path) = python {
        let program = if path.is_dir() {
            path.join("bin/python3")
        } else {
            path.to_owned()
        };
        ensure!(
            program.exists(),
            "--python {}: no interpreter found (expected bin/python3)",
            path.display()
        );
        return ensure_matching_version(program);
    }
    if let Some(folder) = env::var_os("VIRTUAL_ENV").filter(|folder| !folder.is_empty()) {
        let program = Path::new(&folder).join("bin/python3");
        ensure!(
            program.exists(),
            "VIRTUAL_ENV={}: no interpreter found (expected bin/python3)",
            Path::new(&folder).display()
        );
        return ensure_matching_version(program);
    }
    let build_venv = Path::new(BUILD_VENV).join("bin/python3");
    Ok(if !BUILD_VENV.is_empty() && build_venv.exists() {
        build_venv
    } else {
        PathBuf::from(BUILD_PYTHON)
    })
}

/// Rejects a virtual environment of another Python version, whose compiled packages do not fit this libpython.
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
            "{}: Python {version} (expected {ours}, which mirrorball is linked with). Make an environment with python{ours} -m venv",
            folder.display()
        ),
        _ => Ok(program),
    }
}

fn linked_minor() -> u8 {
    #[expect(
        unsafe_code,
        reason = "a constant C string, valid without an interpreter"
    )]
    let version = unsafe { std::ffi::CStr::from_ptr(ffi::Py_GetVersion()) };
    let text = version.to_string_lossy();
    let minor = text.split(['.', ' ', '+', 'r', 'a', 'b']).nth(1);
    minor.and_then(|minor| minor.parse().ok()).unwrap_or(11)
}

/// An embedded interpreter ignores `VIRTUAL_ENV`, so its program name is set to the environment's interpreter.
#[expect(
    unsafe_code,
    reason = "Python's start-up configuration has only a C interface"
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
    // Releases the interpreter lock; `Python::attach` acquires it again.
    unsafe { ffi::PyEval_SaveThread() };
    Ok(())
}

/// Errors of the user become one line; other errors are bugs and print their traceback.
pub(crate) fn explain_error(py: Python<'_>, error: &PyErr) -> anyhow::Error {
    if error.is_instance_of::<PyKeyboardInterrupt>(py) {
        return anyhow!("interrupted");
    }
    let value = error.value(py);
    let attribute = |name: &str| value.getattr(name).ok().filter(|found| !found.is_none());
    if error.is_instance_of::<PyOSError>(py)
        && let (Some(file), Some(reason)) = (attribute("filename"), attribute("strerror"))
    {
        return anyhow!("cannot use {file}: {reason}");
    }
    if error.is_instance_of::<PyMemoryError>(py) {
        return anyhow!("not enough memory: {value}");
    }
    let expected =
        error.is_instance_of::<PyValueError>(py) || error.is_instance_of::<PyOSError>(py);
    if !expected {
        print_traceback(py, error);
    }
    anyhow!("{value}")
}
