//! How do viewers change settings? Foxglove's parameters: one for each setting, and an overlay with its seal.

use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, ParameterType, ParameterValue,
    SetParametersResponder,
};

use crate::run::tuning::{TuningHandle, flatten};

/// Number that the next seal must contain.
pub(crate) const NONCE: &str = "tuning.nonce";
/// Result of the last change.
pub(crate) const MESSAGE: &str = "tuning.message";
/// Changes so far, with time and author: a line each.
pub(crate) const HISTORY: &str = "tuning.history";
/// Changes (TOML), all at once. `by = "NAME"` names the author. `revoke = true` returns to the settings of the start first.
pub(super) const OVERLAY: &str = "tuning.overlay";
/// The overlay's seal under the key.
pub(super) const SEAL: &str = "tuning.seal";
/// True returns to the settings of the start, where no key is set.
const REVOKE: &str = "tuning.revoke";

/// Answers the parameter requests of all viewers.
pub(super) struct SettingsHandler(pub(super) TuningHandle);

impl ParameterHandler for SettingsHandler {
    fn get(
        &self,
        _: AnyClient,
        names: Vec<String>,
        _: Option<String>,
        responder: GetParametersResponder,
    ) {
        let mut parameters = all_parameters(&self.0);
        parameters.retain(|parameter| names.is_empty() || names.contains(&parameter.name));
        responder.respond(parameters);
    }

    fn set(
        &self,
        _: AnyClient,
        parameters: Vec<Parameter>,
        _: Option<String>,
        responder: SetParametersResponder,
    ) {
        let names: Vec<String> = parameters.iter().map(|one| one.name.clone()).collect();
        // The reason of a rejection is in the message.
        let _reported = request_change(&self.0, parameters);
        let mut answer = all_parameters(&self.0);
        answer.retain(|parameter| {
            [NONCE, MESSAGE, HISTORY].contains(&parameter.name.as_str())
                || names.contains(&parameter.name)
        });
        responder.respond(answer);
    }
}

fn request_change(desk: &TuningHandle, parameters: Vec<Parameter>) -> anyhow::Result<()> {
    let (mut overlay, mut seal) = (String::new(), None);
    let settings = flatten(&desk.view().config.to_table()?);
    for Parameter { name, value, .. } in parameters {
        match (name.as_str(), value) {
            (OVERLAY, Some(ParameterValue::String(text))) => overlay += &text,
            (SEAL, Some(ParameterValue::String(text))) => seal = Some(text),
            (REVOKE, Some(ParameterValue::Bool(true))) => overlay += "revoke = true\n",
            (NONCE | MESSAGE | HISTORY | REVOKE, _) | (_, None) => {}
            (name, Some(value)) => {
                let is_float = matches!(settings.get(name), Some(toml::Value::Float(_)));
                if let Some(value) = toml_value(value, is_float) {
                    overlay += &format!("{name} = {value}\n");
                }
            }
        }
    }
    desk.request(&overlay, seal.as_deref())
}

/// All parameters with their present values.
pub(super) fn all_parameters(desk: &TuningHandle) -> Vec<Parameter> {
    let view = desk.view();
    let text = |name: &str, text: &str| Parameter {
        name: name.to_owned(),
        r#type: None,
        value: Some(ParameterValue::String(text.to_owned())),
    };
    let mut parameters = vec![text(MESSAGE, &view.message), text(HISTORY, &view.history)];
    if view.is_sealed {
        parameters.push(text(NONCE, &view.nonce));
    }
    // A table of settings that were accepted is always made.
    let settings = flatten(&view.config.to_table().unwrap_or_default());
    for (name, value) in settings {
        let Some(value) = parameter_value(&value) else {
            continue;
        };
        let kind = match &value {
            ParameterValue::Float64(_) => Some(ParameterType::Float64),
            ParameterValue::Array(values)
                if matches!(values.first(), Some(ParameterValue::Float64(_))) =>
            {
                Some(ParameterType::Float64Array)
            }
            _ => None,
        };
        parameters.push(Parameter {
            name,
            r#type: kind,
            value: Some(value),
        });
    }
    parameters
}

/// A setting as a parameter. None for lists of tables.
fn parameter_value(value: &toml::Value) -> Option<ParameterValue> {
    Some(match value {
        toml::Value::Boolean(on) => ParameterValue::Bool(*on),
        toml::Value::Integer(number) => ParameterValue::Integer(*number),
        // The shortest decimal of the f32 value: 0.1 instead of 0.10000000149.
        toml::Value::Float(number) => {
            let short = format!("{:?}", *number as f32).parse();
            ParameterValue::Float64(short.unwrap_or(*number))
        }
        toml::Value::String(text) => ParameterValue::String(text.clone()),
        toml::Value::Array(values) => {
            ParameterValue::Array(values.iter().map(parameter_value).collect::<Option<_>>()?)
        }
        toml::Value::Table(_) | toml::Value::Datetime(_) => return None,
    })
}

/// A parameter as a setting; `is_float`: the setting has decimals, whatever the viewer sent.
fn toml_value(value: ParameterValue, is_float: bool) -> Option<toml::Value> {
    Some(match value {
        ParameterValue::Bool(on) => on.into(),
        ParameterValue::Integer(number) if is_float => (number as f64).into(),
        ParameterValue::Integer(number) => number.into(),
        ParameterValue::Float64(number) => number.into(),
        ParameterValue::String(text) => text.into(),
        ParameterValue::Array(values) => {
            let values = values.into_iter().map(|value| toml_value(value, false));
            toml::Value::Array(values.collect::<Option<_>>()?)
        }
        ParameterValue::Dict(_) => return None,
    })
}
