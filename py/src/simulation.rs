//! Simulated runs in this process: arguments to the pipeline's options, its summary to a dict.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use pipeline::PipelineConfig;
use pipeline::config::apply_overlay;
use pipeline::log::{ImageCompression, LogConfig};
use pipeline::run::{Progress, ScenarioOptions, ScenarioRun};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyMapping, PyString};

use crate::errors;

/// Ctrl-C and `progress` wait for at most this long.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);
/// Longest simulation, seconds: a month, as on the command line.
const DURATION_MAX: f64 = 2_678_400.0;

/// Runs a scenario and returns its summary, the same as `mirrorball sim --json` prints.
///
/// `change` and `config` replace single values of scenario and settings by dotted key. `progress` gets the simulated
/// seconds about ten times a second; an exception that it raises ends the run, and leaves the log complete.
#[pyfunction]
#[pyo3(signature = (scenario, *, seed=None, duration_s=None, preset="default", change=None, config=None, record=None, images="png", progress=None))]
#[expect(
    clippy::too_many_arguments,
    reason = "keyword arguments of a Python function"
)]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    scenario: PathBuf,
    seed: Option<u64>,
    duration_s: Option<f64>,
    preset: &str,
    change: Option<&Bound<'py, PyDict>>,
    config: Option<&Bound<'py, PyDict>>,
    record: Option<PathBuf>,
    images: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    if let Some(seconds) = duration_s
        && !(seconds > 0.0 && seconds <= DURATION_MAX)
    {
        return Err(PyValueError::new_err(format!(
            "invalid duration_s: {seconds} (expected seconds above 0 and at most {DURATION_MAX})"
        )));
    }
    let images = ImageCompression::from_name(images).ok_or_else(|| {
        PyValueError::new_err(format!(
            "invalid images: {images:?} (expected png, jpeg or none)"
        ))
    })?;
    let log_config = LogConfig {
        images,
        ..LogConfig::default()
    };
    let overlay = overrides(config)?;
    let settings = PipelineConfig::preset(preset).and_then(|base| apply_overlay(&base, overlay));
    let options = ScenarioOptions {
        scenario,
        changes: overrides(change)?,
        seed,
        duration: duration_s,
        config: settings.map_err(|error| errors::from_anyhow(&error))?,
        record: record.map(|path| (path, log_config)),
    };
    let mut monitor = Monitor::new(progress);
    let summary =
        py.detach(|| ScenarioRun::load(options)?.run(|progress| Ok(monitor.poll(&progress))));
    if let Some(error) = monitor.error {
        return Err(error);
    }
    let summary = summary.map_err(|error| errors::from_anyhow(&error))?;
    let text = serde_json::to_string(&summary)
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

/// Every file that a scenario needs, itself first.
#[pyfunction]
pub(crate) fn scenario_files(scenario: PathBuf) -> PyResult<Vec<PathBuf>> {
    pipeline::run::scenario_files(&scenario).map_err(|error| errors::from_anyhow(&error))
}

/// Attaches to Python now and then while a run goes on without it.
struct Monitor {
    progress: Option<Py<PyAny>>,
    last: Instant,
    error: Option<PyErr>,
}

#[expect(
    clippy::disallowed_methods,
    reason = "how often Python is asked is no part of the results"
)]
impl Monitor {
    fn new(progress: Option<Py<PyAny>>) -> Self {
        Monitor {
            progress,
            last: Instant::now(),
            error: None,
        }
    }

    fn poll(&mut self, progress: &Progress<'_>) -> ControlFlow<()> {
        if self.last.elapsed() < PROGRESS_PERIOD {
            return ControlFlow::Continue(());
        }
        self.last = Instant::now();
        let polled = Python::attach(|py| {
            py.check_signals()?;
            if let Some(callback) = &self.progress {
                callback.call1(py, (progress.seconds,))?;
            }
            Ok(())
        });
        match polled {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                self.error = Some(error);
                ControlFlow::Break(())
            }
        }
    }
}

/// Values by dotted key as nested tables.
fn overrides(values: Option<&Bound<'_, PyDict>>) -> PyResult<toml::Table> {
    let mut table = toml::Table::new();
    for (key, value) in values.into_iter().flatten() {
        let key: String = key.extract()?;
        insert(&mut table, &key, to_toml(&value, &key)?);
    }
    Ok(table)
}

fn insert(table: &mut toml::Table, key: &str, value: toml::Value) {
    let one = match key.rsplit_once('.') {
        None => toml::Table::from_iter([(key.to_owned(), value)]),
        Some((outer, name)) => {
            let inner = toml::Table::from_iter([(name.to_owned(), value)]);
            return insert(table, outer, inner.into());
        }
    };
    pipeline::config::merge_tables(table, one);
}

fn to_toml(value: &Bound<'_, PyAny>, key: &str) -> PyResult<toml::Value> {
    // A bool is an int, too.
    if value.is_instance_of::<PyBool>() {
        return Ok(value.extract::<bool>()?.into());
    }
    if value.is_instance_of::<PyInt>() {
        return Ok(value.extract::<i64>()?.into());
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(value.extract::<f64>()?.into());
    }
    if value.is_instance_of::<PyString>() {
        return Ok(value.extract::<String>()?.into());
    }
    if let Ok(mapping) = value.cast::<PyMapping>() {
        let mut table = toml::Table::new();
        for item in mapping.items()?.iter() {
            let (name, inner): (String, Bound<'_, PyAny>) = item.extract()?;
            let inner = to_toml(&inner, &format!("{key}.{name}"))?;
            table.insert(name, inner);
        }
        return Ok(table.into());
    }
    if value.hasattr("tolist")? {
        return to_toml(&value.call_method0("tolist")?, key);
    }
    if value.hasattr("__len__")? {
        let items = value.try_iter()?;
        let items: PyResult<Vec<toml::Value>> = items.map(|item| to_toml(&item?, key)).collect();
        return Ok(items?.into());
    }
    Err(PyValueError::new_err(format!(
        "invalid {key}: {} (expected a bool, number, text, list or table)",
        value.repr()?
    )))
}
