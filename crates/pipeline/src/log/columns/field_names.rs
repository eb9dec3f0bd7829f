//! Which fields does a topic have? The paths that [`super::Field::find`] knows, for completion.

use super::field::LENGTH;
use super::layout::{FieldKind, MessageLayout, Schema};
use super::{RawMessage, Topic};

/// Elements of a list that are listed. Others can still be read by their index.
const LISTED_ELEMENTS: usize = 3;
/// Most paths of one JSON message.
const JSON_PATHS_MAX: usize = 1000;

impl Topic {
    /// Paths of its numbers and texts, without the topic. Empty if its schema cannot be read.
    ///
    /// `sample`: a message, which names the fields of a JSON topic.
    pub fn field_names(&self, sample: Option<&RawMessage>) -> Vec<String> {
        let mut names = Vec::new();
        if self.is_json {
            let value = sample.and_then(|message| serde_json::from_slice(&message.data).ok());
            if let Some(value) = value {
                json_names(&value, "", &mut names);
            }
        } else if let Ok(schema) = &self.layout {
            message_names(schema, schema.root(), "", &mut Vec::new(), &mut names);
        }
        names
    }
}

fn message_names<'a>(
    schema: &'a Schema,
    layout: &'a MessageLayout,
    prefix: &str,
    above: &mut Vec<&'a str>,
    names: &mut Vec<String>,
) {
    above.push(&layout.full_name);
    for field in &layout.fields {
        let mut bases = vec![format!("{prefix}{}", field.name)];
        if field.repeated {
            let list = &bases[0];
            names.push(format!("{list}.{LENGTH}"));
            bases = (0..LISTED_ELEMENTS)
                .map(|index| format!("{list}[{index}]"))
                .collect();
        }
        match field.kind {
            FieldKind::Bytes => {}
            FieldKind::Number(_) | FieldKind::Text => names.extend(bases),
            FieldKind::Message(index) => {
                let message = schema.message(index);
                if message.is_time() {
                    names.extend(bases);
                } else if !above.contains(&message.full_name.as_str()) {
                    for base in bases {
                        message_names(schema, message, &format!("{base}."), above, names);
                    }
                }
            }
        }
    }
    above.pop();
}

fn json_names(value: &serde_json::Value, prefix: &str, names: &mut Vec<String>) {
    if names.len() >= JSON_PATHS_MAX {
        return;
    }
    match value {
        serde_json::Value::Object(fields) => {
            for (name, value) in fields {
                // A dot or a bracket in a name would be read as a part of the path.
                if !name.is_empty() && !name.contains(['.', '[']) {
                    let dot = if prefix.is_empty() { "" } else { "." };
                    json_names(value, &format!("{prefix}{dot}{name}"), names);
                }
            }
        }
        serde_json::Value::Array(list) if !prefix.is_empty() => {
            names.push(format!("{prefix}.{LENGTH}"));
            for (index, value) in list.iter().take(LISTED_ELEMENTS).enumerate() {
                json_names(value, &format!("{prefix}[{index}]"), names);
            }
        }
        serde_json::Value::Null | serde_json::Value::Array(_) => {}
        _ if prefix.is_empty() => {}
        _ => names.push(prefix.to_owned()),
    }
}
