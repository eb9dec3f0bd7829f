//! What does a message of any type contain? A tree of names and values, decoded by the schema.

use super::layout::{FieldKind, FieldLayout, MessageLayout, Number, NumberKind, Schema};
use super::protobuf::{DEPTH_MAX, FieldReader, ProtobufError, WireValue};

/// Fields of a message in the order of their declaration.
pub type Fields = Vec<(String, Value)>;

/// The value of a field.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// An absent message, or an absent `optional` value.
    Absent,
    /// float and double.
    Float(f64),
    /// Integers and enumerations.
    Int(i64),
    /// bool.
    Bool(bool),
    /// string.
    Text(String),
    /// bytes.
    Bytes(Vec<u8>),
    /// Repeated float or double.
    Floats(Vec<f64>),
    /// Repeated integers, enumerations or bool.
    Ints(Vec<i64>),
    /// Repeated string, bytes or message.
    List(Vec<Value>),
    /// A message.
    Message(Fields),
}

/// Decodes a message. Fields that the schema does not declare are skipped.
pub(super) fn decode(
    schema: &Schema,
    layout: &MessageLayout,
    message: &[u8],
) -> Result<Fields, ProtobufError> {
    decode_nested(schema, layout, message, 0)
}

fn decode_nested(
    schema: &Schema,
    layout: &MessageLayout,
    message: &[u8],
    depth: usize,
) -> Result<Fields, ProtobufError> {
    if depth > DEPTH_MAX {
        return Err(ProtobufError::Depth);
    }
    let fields = layout.fields.iter();
    let mut fields: Fields = fields
        .map(|field| (field.name.clone(), default_value(field)))
        .collect();
    let mut reader = FieldReader::new(message);
    while let Some((number, value)) = reader.next_field()? {
        let Some(index) = layout.index_by_number(number) else {
            continue;
        };
        let (field, target) = (&layout.fields[index], &mut fields[index].1);
        if let (true, FieldKind::Number(kind)) = (field.repeated, field.kind) {
            kind.decode_repeated(number, value, |number| match target {
                Value::Floats(values) => values.push(number.as_f64()),
                Value::Ints(values) => values.push(number.as_i64()),
                _ => {}
            })?;
            continue;
        }
        let value = decode_single(schema, field, value, depth)?;
        match target {
            Value::List(values) => values.push(value),
            target => *target = value,
        }
    }
    Ok(fields)
}

fn decode_single(
    schema: &Schema,
    field: &FieldLayout,
    value: WireValue<'_>,
    depth: usize,
) -> Result<Value, ProtobufError> {
    Ok(match (field.kind, value) {
        (FieldKind::Number(kind), value) => match kind.decode(field.number, value)? {
            Number::Float(value) => Value::Float(value),
            Number::Int(value) => Value::Int(value),
            Number::Bool(value) => Value::Bool(value),
        },
        (FieldKind::Text, WireValue::Bytes(bytes)) => {
            let text = std::str::from_utf8(bytes).map_err(|_not_utf8| ProtobufError::Text)?;
            Value::Text(text.to_owned())
        }
        (FieldKind::Bytes, WireValue::Bytes(bytes)) => Value::Bytes(bytes.to_vec()),
        (FieldKind::Message(index), WireValue::Bytes(bytes)) => {
            let layout = schema.message(index);
            Value::Message(decode_nested(schema, layout, bytes, depth + 1)?)
        }
        _ => return Err(ProtobufError::Mismatch(field.number)),
    })
}

fn default_value(field: &FieldLayout) -> Value {
    match field.kind {
        FieldKind::Number(kind) if field.repeated && kind.is_float() => Value::Floats(Vec::new()),
        FieldKind::Number(_) if field.repeated => Value::Ints(Vec::new()),
        _ if field.repeated => Value::List(Vec::new()),
        FieldKind::Message(_) => Value::Absent,
        _ if field.optional => Value::Absent,
        FieldKind::Number(NumberKind::Bool) => Value::Bool(false),
        FieldKind::Number(kind) if kind.is_float() => Value::Float(0.0),
        FieldKind::Number(_) => Value::Int(0),
        FieldKind::Text => Value::Text(String::new()),
        FieldKind::Bytes => Value::Bytes(Vec::new()),
    }
}
