//! Arguments from Python: settings, numbers and arrays, and errors that name the argument and what was expected.

use std::path::PathBuf;

use localize::Stamp;
use numpy::{
    PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pipeline::PipelineConfig;
use pipeline::config::apply_overlay;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyMapping, PyString, PyTuple};

use crate::errors;

/// Positional and keyword arguments that make an equal object, for pickle and copy.
pub(crate) type Keywords<'py> = (Bound<'py, PyTuple>, Bound<'py, PyDict>);

/// A preset overridden by `config`: values by dotted key, or the path of an overlay file.
pub(crate) fn settings(
    preset: &str,
    config: Option<&Bound<'_, PyAny>>,
) -> PyResult<PipelineConfig> {
    let loaded = match config {
        None => PipelineConfig::preset(preset),
        Some(values) if values.is_instance_of::<PyDict>() => {
            let overlay = overrides(Some(values.cast()?))?;
            PipelineConfig::preset(preset).and_then(|base| apply_overlay(&base, overlay))
        }
        Some(path) => {
            let Ok(path) = path.extract::<PathBuf>() else {
                return Err(PyTypeError::new_err(format!(
                    "invalid config: {} (expected a dict, or the path of an overlay file)",
                    path.get_type()
                )));
            };
            PipelineConfig::load(preset, Some(&path))
        }
    };
    loaded.map_err(|error| errors::from_anyhow(&error))
}

/// A stamp from seconds.
pub(crate) fn stamp(stamp_s: f64) -> PyResult<Stamp> {
    // Larger values do not fit into nanoseconds.
    if !(stamp_s.abs() < 9e9) {
        return Err(PyValueError::new_err(format!(
            "invalid stamp_s: {stamp_s} (expected seconds, below 9e9)"
        )));
    }
    Ok(Stamp::from_seconds(stamp_s))
}

/// Numbers that must be finite.
pub(crate) fn finite<const N: usize>(name: &str, values: [f32; N]) -> PyResult<[f32; N]> {
    if values.iter().all(|value| value.is_finite()) {
        return Ok(values);
    }
    Err(PyValueError::new_err(format!(
        "invalid {name}: {values:?} (expected finite numbers)"
    )))
}

/// An array of bytes; anything else is an error that states its type and shape.
pub(crate) fn byte_array<'py>(
    name: &str,
    value: &Bound<'py, PyAny>,
    expected: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, u8>> {
    match value.cast::<PyArrayDyn<u8>>() {
        Ok(array) => Ok(array.readonly()),
        Err(_) => Err(PyValueError::new_err(format!(
            "invalid {name}: {} (expected uint8, {expected})",
            describe(value)
        ))),
    }
}

/// Rows of `columns` numbers, from any array or list of lists of numbers.
pub(crate) fn rows(
    name: &str,
    value: &Bound<'_, PyAny>,
    columns: &[usize],
) -> PyResult<(usize, Vec<f32>)> {
    let py = value.py();
    let counts: Vec<String> = columns.iter().map(ToString::to_string).collect();
    let invalid = || {
        PyValueError::new_err(format!(
            "invalid {name}: {} (expected numbers, n × {})",
            describe(value),
            counts.join(" or n × ")
        ))
    };
    let numpy = py.import("numpy")?;
    let keywords = PyDict::new(py);
    keywords.set_item("dtype", "float32")?;
    let array = numpy.call_method("ascontiguousarray", (value,), Some(&keywords));
    let Ok(array) = array else {
        return Err(invalid());
    };
    let array = array.cast::<PyArrayDyn<f32>>()?.readonly();
    match *array.shape() {
        [count, width] if columns.contains(&width) => {
            let values: Vec<f32> = array.as_slice()?.to_vec();
            debug_assert_eq!(values.len(), count * width);
            Ok((width, values))
        }
        // An empty list has no second axis.
        [0] => Ok((columns[0], Vec::new())),
        _ => Err(invalid()),
    }
}

/// What an argument is: the type and shape of an array, or its Python type.
fn describe(value: &Bound<'_, PyAny>) -> String {
    match value.cast::<PyUntypedArray>() {
        Ok(array) => format!("{} array of shape {:?}", array.dtype(), array.shape()),
        Err(_) if value.is_none() => "None, no array".to_owned(),
        Err(_) => format!("{}, no array of numbers", value.get_type()),
    }
}

/// Values by dotted key as nested tables.
pub(crate) fn overrides(values: Option<&Bound<'_, PyDict>>) -> PyResult<toml::Table> {
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
