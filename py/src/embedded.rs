//! Import of the package that the executable embeds: sources from memory, the compiled half from the executable.

use std::ffi::CString;

use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

/// The package's Python files: path inside `mirrorball/`, text.
const SOURCES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/sources.rs"));

const FINDER: &str = include_str!("finder.py");

/// Imports numpy and its C interface, which panics if it cannot be had later.
pub fn load_numpy(py: Python<'_>) -> PyResult<()> {
    py.import("numpy")?;
    let _loads_the_interface = PyArray1::<f64>::zeros(py, 0, false);
    Ok(())
}

/// Makes `import mirrorball` find the package that this executable carries, whatever else is installed.
///
/// The module `_core` must have been added to the inittab before Python started. It is known as `mirrorball._core` before
/// the package is imported, or a second copy would be loaded from the virtual environment.
pub fn install(py: Python<'_>) -> PyResult<()> {
    let modules: Bound<'_, PyDict> = py.import("sys")?.getattr("modules")?.cast_into()?;
    modules.set_item("mirrorball._core", py.import("_core")?)?;
    let sources = PyDict::new(py);
    for (path, text) in SOURCES {
        let inside = path.trim_end_matches(".py").replace('/', ".");
        let (name, is_package) = match inside.strip_suffix("__init__") {
            Some(package) => (package.trim_end_matches('.').to_owned(), true),
            None => (inside, false),
        };
        let name = if name.is_empty() {
            "mirrorball".to_owned()
        } else {
            format!("mirrorball.{name}")
        };
        sources.set_item(name, (*text, is_package))?;
    }
    let finder = PyModule::from_code(
        py,
        &CString::new(FINDER)?,
        c"<mirrorball>/finder.py",
        c"mirrorball_finder",
    )?;
    let finder = finder.getattr("Carried")?.call1((sources,))?;
    let path: Bound<'_, PyList> = py.import("sys")?.getattr("meta_path")?.cast_into()?;
    path.insert(0, finder)
}
