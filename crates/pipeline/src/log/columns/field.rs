//! Which value does one field have in each message of a topic? Found by its path, as `/cycle.estimate.pose.x`.
//!
//! A path is the topic, a dot, and the names of the nested fields. `name[2]` is an element of a list, `name.length` the
//! list's length. Messages are protobuf, by the schema in the file, or JSON.

use std::collections::BTreeMap;

use anyhow::{Context, Result, anyhow, bail};

use super::layout::{FieldKind, FieldLayout, MessageLayout, NumberKind, Schema};
use super::protobuf::{FieldReader, ProtobufError, WireValue};
use super::{RawMessage, Topic};

/// Name of a list's length in a path.
pub(super) const LENGTH: &str = "length";

/// A field of a topic.
#[derive(Debug, Clone)]
pub struct Field {
    topic: String,
    access: Access,
}

#[derive(Debug, Clone)]
enum Access {
    Protobuf(ProtobufField),
    Json(Vec<Step>),
}

/// A part of a path.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    Name(String),
    Index(usize),
}

/// A field in protobuf's wire format.
#[derive(Debug, Clone)]
struct ProtobufField {
    /// Field number of each enclosing message, and its index in a list of messages.
    steps: Vec<(u32, usize)>,
    number: u32,
    leaf: Leaf,
}

#[derive(Debug, Clone, Copy)]
enum Leaf {
    Number { kind: NumberKind, optional: bool },
    Element { kind: NumberKind, index: usize },
    Text { index: usize },
    Time { index: usize },
    Length { kind: Option<NumberKind> },
}

/// The value of a field in a message.
#[derive(Debug, Clone, PartialEq)]
pub enum FieldValue {
    /// Numbers; true is 1, a time is in seconds.
    Number(f64),
    /// Texts.
    Text(String),
    /// The message does not hold the field.
    Absent,
}

impl Field {
    /// The field of a path, among these topics.
    pub fn find(topics: &BTreeMap<String, Topic>, path: &str) -> Result<Self> {
        let holds = |name: &&String| {
            let rest = path.strip_prefix(name.as_str());
            rest.is_some_and(|rest| rest.starts_with('.'))
        };
        let name = topics.keys().filter(holds).max_by_key(|name| name.len());
        let name = name.with_context(|| format!("no topic for {path} (expected /TOPIC.FIELD)"))?;
        let topic = &topics[name];
        let steps = parse_path(&path[name.len() + 1..]).with_context(|| path.to_owned())?;
        let access = if topic.is_json {
            Access::Json(steps)
        } else {
            let schema = topic.layout.as_ref();
            let schema = schema.map_err(|reason| anyhow!("topic {name}: {reason}"))?;
            Access::Protobuf(
                ProtobufField::find(schema, schema.root(), &steps)
                    .with_context(|| path.to_owned())?,
            )
        };
        Ok(Field {
            topic: name.clone(),
            access,
        })
    }

    /// Its topic.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Its value in a message of its topic.
    pub fn read(&self, message: &RawMessage) -> Result<FieldValue> {
        match &self.access {
            Access::Protobuf(field) => field
                .read(&message.data)
                .map_err(|error| anyhow!("a message of {}: {error}", self.topic)),
            Access::Json(steps) => {
                let value: serde_json::Value = serde_json::from_slice(&message.data)
                    .with_context(|| format!("a message of {}", self.topic))?;
                Ok(json_value(&value, steps))
            }
        }
    }
}

/// Splits `a.b[2].c`.
fn parse_path(path: &str) -> Result<Vec<Step>> {
    let mut steps = Vec::new();
    for part in path.split('.') {
        let (name, rest) = part.split_at(part.find('[').unwrap_or(part.len()));
        if name.is_empty() {
            bail!("an empty name");
        }
        steps.push(Step::Name(name.to_owned()));
        for index in rest.split_terminator(']') {
            let index = index.strip_prefix('[').and_then(|text| text.parse().ok());
            steps.push(Step::Index(
                index.context("an index is a number in brackets")?,
            ));
        }
    }
    Ok(steps)
}

impl ProtobufField {
    fn find(schema: &Schema, root: &MessageLayout, path: &[Step]) -> Result<Self> {
        let (mut layout, mut steps, mut rest) = (root, Vec::new(), path);
        loop {
            let Some((Step::Name(name), after)) = rest.split_first() else {
                bail!("{} is a message: name one of its fields", layout.full_name);
            };
            let field = layout
                .field_by_name(name)
                .with_context(|| format!("{} has no field {name}", layout.full_name))?;
            let (index, after) = match after {
                [Step::Name(name), after @ ..] if field.repeated && name == LENGTH => {
                    anyhow::ensure!(after.is_empty(), "a length has no fields");
                    return Ok(ProtobufField {
                        steps,
                        number: field.number,
                        leaf: Leaf::Length {
                            kind: number_kind(field),
                        },
                    });
                }
                [Step::Index(index), after @ ..] if field.repeated => (*index, after),
                [Step::Index(_), ..] => bail!("{name} is no list"),
                _ if field.repeated => bail!("{name} is a list: {name}[0], or {name}.{LENGTH}"),
                after => (0, after),
            };
            if let FieldKind::Message(message) = field.kind
                && !schema.message(message).is_time()
            {
                steps.push((field.number, index));
                (layout, rest) = (schema.message(message), after);
                continue;
            }
            anyhow::ensure!(after.is_empty(), "{name} has no fields");
            let leaf = match field.kind {
                FieldKind::Number(kind) if field.repeated => Leaf::Element { kind, index },
                FieldKind::Number(kind) => Leaf::Number {
                    kind,
                    optional: field.optional,
                },
                FieldKind::Text => Leaf::Text { index },
                FieldKind::Message(_) => Leaf::Time { index },
                FieldKind::Bytes => bail!("{name} holds bytes"),
            };
            return Ok(ProtobufField {
                steps,
                number: field.number,
                leaf,
            });
        }
    }

    fn read(&self, message: &[u8]) -> Result<FieldValue, ProtobufError> {
        let mut message = message;
        for (number, index) in &self.steps {
            let mut found = None;
            let mut reader = FieldReader::new(message);
            let mut position = 0;
            while let Some((at, value)) = reader.next_field()? {
                if let (true, WireValue::Bytes(inner)) = (at == *number, value) {
                    if position == *index {
                        found = Some(inner);
                    }
                    position += 1;
                }
            }
            let Some(inner) = found else {
                return Ok(FieldValue::Absent);
            };
            message = inner;
        }
        self.read_leaf(message)
    }

    fn read_leaf(&self, message: &[u8]) -> Result<FieldValue, ProtobufError> {
        let number = self.number;
        let mut value = match self.leaf {
            Leaf::Number {
                optional: false, ..
            }
            | Leaf::Length { .. } => FieldValue::Number(0.0),
            _ => FieldValue::Absent,
        };
        let mut position = 0usize;
        let mut reader = FieldReader::new(message);
        while let Some((at, field)) = reader.next_field()? {
            if at != number {
                continue;
            }
            match self.leaf {
                Leaf::Number { kind, .. } => {
                    value = FieldValue::Number(kind.decode(number, field)?.as_f64());
                }
                Leaf::Element { kind, index } => {
                    kind.decode_repeated(number, field, |element| {
                        if position == index {
                            value = FieldValue::Number(element.as_f64());
                        }
                        position += 1;
                    })?
                }
                Leaf::Length { kind: Some(kind) } => {
                    kind.decode_repeated(number, field, |_| position += 1)?;
                    value = FieldValue::Number(position as f64);
                }
                Leaf::Length { kind: None } => {
                    position += 1;
                    value = FieldValue::Number(position as f64);
                }
                Leaf::Text { index } | Leaf::Time { index } => {
                    let WireValue::Bytes(bytes) = field else {
                        return Err(ProtobufError::Mismatch(number));
                    };
                    if position == index {
                        value = self.bytes_value(bytes)?;
                    }
                    position += 1;
                }
            }
        }
        // An absent text is the empty one.
        if let (Leaf::Text { index: 0 }, FieldValue::Absent) = (self.leaf, &value) {
            value = FieldValue::Text(String::new());
        }
        Ok(value)
    }

    fn bytes_value(&self, bytes: &[u8]) -> Result<FieldValue, ProtobufError> {
        if let Leaf::Time { .. } = self.leaf {
            return Ok(FieldValue::Number(super::plan::decode_seconds(bytes)?));
        }
        let text = std::str::from_utf8(bytes).map_err(|_not_utf8| ProtobufError::Text)?;
        Ok(FieldValue::Text(text.to_owned()))
    }
}

fn number_kind(field: &FieldLayout) -> Option<NumberKind> {
    match field.kind {
        FieldKind::Number(kind) => Some(kind),
        _ => None,
    }
}

fn json_value(value: &serde_json::Value, steps: &[Step]) -> FieldValue {
    let mut value = value;
    for (number, step) in steps.iter().enumerate() {
        let inner = match step {
            Step::Name(name) => value.get(name),
            Step::Index(index) => value.get(index),
        };
        value = match (inner, step, value) {
            (Some(inner), ..) => inner,
            (None, Step::Name(name), serde_json::Value::Array(list))
                if name == LENGTH && number + 1 == steps.len() =>
            {
                return FieldValue::Number(list.len() as f64);
            }
            _ => return FieldValue::Absent,
        };
    }
    match value {
        serde_json::Value::Number(number) => number
            .as_f64()
            .map_or(FieldValue::Absent, FieldValue::Number),
        serde_json::Value::Bool(value) => FieldValue::Number(f64::from(u8::from(*value))),
        serde_json::Value::String(text) => FieldValue::Text(text.clone()),
        _ => FieldValue::Absent,
    }
}
