//! Settings from Python: values by dotted key, nested tables or an overlay file on top of a preset.

use std::path::PathBuf;

use pipeline::PipelineConfig;
use pipeline::config::apply_overlay;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyMapping, PyString};

use crate::arguments;
use crate::errors;

/// A preset overridden by `config`: values by dotted key, or the path of an overlay file.
pub(crate) fn settings(
    preset: &Bound<'_, PyAny>,
    config: Option<&Bound<'_, PyAny>>,
) -> PyResult<PipelineConfig> {
    let preset = arguments::text("preset", preset, "the name of a preset")?;
    let loaded = match config {
        None => PipelineConfig::preset(&preset),
        Some(values) if values.is_instance_of::<PyDict>() => {
            let overlay = overrides("config", Some(values))?;
            PipelineConfig::preset(&preset).and_then(|base| apply_overlay(&base, overlay))
        }
        Some(path) => {
            let expected = "a dict, or the path of an overlay file";
            let path: PathBuf = arguments::extract("config", path, expected)?;
            PipelineConfig::load(&preset, Some(&path))
        }
    };
    loaded.map_err(|error| errors::from_anyhow(&error))
}

/// Values by dotted key as nested tables.
pub(crate) fn overrides(name: &str, values: Option<&Bound<'_, PyAny>>) -> PyResult<toml::Table> {
    let mut table = toml::Table::new();
    let Some(values) = values else {
        return Ok(table);
    };
    let expected = "a dict of values by dotted key";
    let entries: Bound<'_, PyDict> = arguments::extract(name, values, expected)?;
    for (key, value) in entries {
        let key = arguments::text(name, &key, "a dotted key")?;
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
