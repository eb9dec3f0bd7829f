//! Odd moments of a log, as the view shows them.

use pipeline::findings::RunHistory;
use pipeline::log::LogIndex;
use pyo3::prelude::*;

use crate::arguments;
use crate::log::log_error;
use crate::threads::detached;

/// Kind, severity, start, stop and worst stamp (s), size, causes and sentence of a finding.
type FindingTuple = (
    &'static str,
    &'static str,
    f64,
    f64,
    f64,
    f64,
    Vec<String>,
    String,
);

/// Number of cycles of a log, and its findings in order of time.
#[pyfunction]
pub(crate) fn findings(
    py: Python<'_>,
    path: &Bound<'_, PyAny>,
) -> PyResult<(usize, Vec<FindingTuple>)> {
    let path = arguments::path("path", path)?;
    let read = detached(py, || {
        let index = LogIndex::open(&path)?;
        let check = || {
            Python::attach(|py| py.check_signals())?;
            Ok(false)
        };
        let history = RunHistory::read(&index, check)?;
        anyhow::Ok((history.len(), history.findings()))
    });
    let (cycles, found) = read.map_err(log_error)?;
    let tuples = found.into_iter().map(|finding| {
        let sentence = finding.sentence();
        (
            finding.kind.name(),
            finding.kind.severity().name(),
            finding.start,
            finding.stop,
            finding.worst,
            finding.size,
            finding.causes,
            sentence,
        )
    });
    Ok((cycles, tuples.collect()))
}
