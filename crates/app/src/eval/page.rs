//! How do the figures become a page? The Python package draws it; without Python the tables stand alone.

use std::path::{Path, PathBuf};

use anyhow::Result;

/// Draws index.html from results.json and the rows beside it.
#[cfg(feature = "python")]
pub(super) fn write(folder: &Path, interpreter: Option<&Path>) -> Result<PathBuf> {
    use pyo3::prelude::*;

    use crate::python;

    python::start(interpreter)?;
    let page = Python::attach(|py| -> PyResult<String> {
        let evaluation = py.import("mirrorball.evaluation")?;
        let folder = folder.display().to_string();
        evaluation
            .call_method1("write_page", (folder,))?
            .str()?
            .extract()
    });
    let page = page.map_err(|error| anyhow::anyhow!("{error}"));
    python::finish();
    page.map(PathBuf::from)
}

/// This build has no Python.
#[cfg(not(feature = "python"))]
pub(super) fn write(_: &Path, _: Option<&Path>) -> Result<PathBuf> {
    anyhow::bail!("this mirrorball was built without Python")
}
