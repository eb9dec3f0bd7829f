//! Simulated runs in this process: arguments to the pipeline's options, its summary to a dict.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use pipeline::log::{ImageCompression, LogConfig};
use pipeline::run::{Progress, ScenarioOptions, ScenarioRun};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arguments;
use crate::errors;
use crate::settings::{overrides, settings};
use crate::threads::detached;

/// Ctrl-C and `progress` wait for at most this long.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);
/// Shortest simulation, seconds: a millisecond.
const DURATION_MIN: f64 = 0.001;
/// Longest simulation, seconds: a month, as on the command line.
const DURATION_MAX: f64 = 2_678_400.0;

/// Runs a scenario and returns its summary, the same as `mirrorball sim --json` prints.
///
/// `change` and `config` replace single values of scenario and settings by dotted key; `config` may also be an overlay file. `progress` gets the simulated
/// seconds about ten times a second; an exception that it raises ends the run, and leaves the log complete.
#[pyfunction]
#[pyo3(signature = (scenario, *, preset, images, seed=None, duration_s=None, change=None, config=None, record=None, progress=None))]
#[expect(
    clippy::too_many_arguments,
    reason = "keyword arguments of a Python function"
)]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    scenario: &Bound<'py, PyAny>,
    preset: &Bound<'py, PyAny>,
    images: &Bound<'py, PyAny>,
    seed: Option<&Bound<'py, PyAny>>,
    duration_s: Option<&Bound<'py, PyAny>>,
    change: Option<&Bound<'py, PyAny>>,
    config: Option<&Bound<'py, PyAny>>,
    record: Option<&Bound<'py, PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let record = record.map(|path| arguments::path("record", path));
    let compressions = ["png", "jpeg", "none"].map(|name| (name, name));
    let images = arguments::choice("images", images, compressions)?;
    let images = ImageCompression::from_name(images)
        .ok_or_else(|| PyValueError::new_err(format!("invalid images: {images}")))?;
    let record = record.transpose()?;
    let log_config = LogConfig {
        images,
        ..LogConfig::default()
    };
    let options = ScenarioOptions {
        scenario: arguments::path("scenario", scenario)?,
        changes: overrides("change", change)?,
        seed: self::seed(seed)?,
        duration: duration(duration_s)?,
        config: settings(preset, config)?,
        record: record.map(|path| (path, log_config)),
    };
    let mut monitor = Monitor::new(progress);
    let summary = detached(py, || {
        ScenarioRun::load(options)?.run(|progress| Ok(monitor.poll(&progress)))
    });
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
pub(crate) fn scenario_files(scenario: &Bound<'_, PyAny>) -> PyResult<Vec<PathBuf>> {
    let scenario = arguments::path("scenario", scenario)?;
    pipeline::run::scenario_files(&scenario).map_err(|error| errors::from_anyhow(&error))
}

/// The seed of a run, if one is given.
pub(crate) fn seed(seed: Option<&Bound<'_, PyAny>>) -> PyResult<Option<u64>> {
    seed.map(|seed| arguments::whole("seed", seed, 0..=u64::MAX))
        .transpose()
}

/// The length of a run, if one is given, seconds.
pub(crate) fn duration(duration_s: Option<&Bound<'_, PyAny>>) -> PyResult<Option<f64>> {
    duration_s
        .map(|duration| {
            arguments::number_within("duration_s", duration, DURATION_MIN..=DURATION_MAX)
        })
        .transpose()
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
