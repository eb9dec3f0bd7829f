//! How do the parameter services of ROS 2 change settings? Every setting is a parameter; a change takes the way of the live
//! stream's settings.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ros2_client::{NodeOptions, ParameterValue};

use super::super::config::Ros2Config;
use crate::run::tuning::{TuningHandle, flatten};

/// Options of a node whose parameters are the settings. Without `tuning` it has none.
///
/// `is_started`: until it is true the values are those of the declaration, which are not checked.
pub(super) fn options(
    config: &Ros2Config,
    tuning: Option<&TuningHandle>,
    is_started: Arc<AtomicBool>,
) -> NodeOptions {
    let mut options = NodeOptions::new().enable_rosout(false);
    let Some(tuning) = tuning else {
        return options;
    };
    // Settings are numbers and texts: they always have a table.
    let table = tuning.view().config.to_table().unwrap_or_default();
    for (name, value) in flatten(&table) {
        if let Some(value) = parameter(&value) {
            options = options.declare_parameter(&name, value);
        }
    }
    let accepts = config.accept_parameters;
    let tuning = tuning.clone();
    options.parameter_validator(Box::new(move |name, value| {
        if !is_started.load(Ordering::Relaxed) {
            return Ok(());
        }
        if !accepts {
            return Err(
                "read-only: set accept_parameters = true in [ros2] of network.toml".to_owned(),
            );
        }
        // `use_sim_time` is ros2-client's own.
        let Some(value) = toml_value(value).filter(|_| name.contains('.')) else {
            return Err(format!("{name} is no setting"));
        };
        tuning
            .request(&format!("{name} = {value}"), None)
            .map_err(|error| format!("{error:#}"))
    }))
}

fn parameter(value: &toml::Value) -> Option<ParameterValue> {
    Some(match value {
        toml::Value::Boolean(value) => ParameterValue::Boolean(*value),
        toml::Value::Integer(value) => ParameterValue::Integer(*value),
        // Settings are 32-bit numbers: 0.1, not 0.10000000149.
        toml::Value::Float(value) => {
            let short = (*value as f32).to_string();
            ParameterValue::Double(short.parse().unwrap_or(*value))
        }
        toml::Value::String(value) => ParameterValue::String(value.clone()),
        toml::Value::Array(values) => {
            let numbers: Option<Vec<f64>> = values.iter().map(toml::Value::as_float).collect();
            ParameterValue::DoubleArray(numbers?)
        }
        toml::Value::Datetime(_) | toml::Value::Table(_) => return None,
    })
}

fn toml_value(value: &ParameterValue) -> Option<toml::Value> {
    Some(match value {
        ParameterValue::Boolean(value) => toml::Value::Boolean(*value),
        ParameterValue::Integer(value) => toml::Value::Integer(*value),
        ParameterValue::Double(value) => toml::Value::Float(*value),
        ParameterValue::String(value) => toml::Value::String(value.clone()),
        ParameterValue::DoubleArray(values) => {
            toml::Value::Array(values.iter().copied().map(toml::Value::Float).collect())
        }
        ParameterValue::NotSet
        | ParameterValue::ByteArray(_)
        | ParameterValue::BooleanArray(_)
        | ParameterValue::IntegerArray(_)
        | ParameterValue::StringArray(_) => return None,
    })
}
