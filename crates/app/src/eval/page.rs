//! How do the figures become a page? The Python package draws it; without Python the tables stand alone.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};
use pyo3::prelude::*;

use crate::python;

/// Draws index.html from results.json and the rows beside it.
pub(super) fn write(folder: &Path, interpreter: Option<&Path>) -> Result<PathBuf> {
    python::start(interpreter)?;
    let page = Python::attach(|py| -> PyResult<String> {
        let proof = py.import("mirrorball.proof")?;
        let folder = folder.display().to_string();
        proof
            .call_method1("write_page", (folder,))?
            .str()?
            .extract()
    });
    let page = page.map_err(|error| anyhow!("{error}"));
    python::finish();
    page.map(PathBuf::from)
}
