//! How is the HTML page made? The Python package draws it; without Python there are only the tables.

use std::path::{Path, PathBuf};

use anyhow::Result;

/// Draws index.html from results.json and the CSV files in its folder.
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

/// Fails: this build has no Python.
#[cfg(not(feature = "python"))]
pub(super) fn write(_: &Path, _: Option<&Path>) -> Result<PathBuf> {
    anyhow::bail!("built without Python. Build with the feature `python`")
}
