//! Which type do a topic's messages have? Read from the schema in the file, a serialized `FileDescriptorSet`.

use std::collections::HashMap;

use anyhow::{Context, Result};
use foxglove::prost_types::field_descriptor_proto::{Label, Type};
use foxglove::prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorSet};
use prost::Message;

use super::protobuf::{ProtobufError, WireValue, read_varint};

/// Message types of a schema, and the one of the topic's messages.
#[derive(Debug)]
pub(super) struct Schema {
    messages: Vec<MessageLayout>,
    root: usize,
}

/// Fields of a message type, by ascending number in `by_number`, in the order of their declaration in `fields`.
#[derive(Debug)]
pub(super) struct MessageLayout {
    pub(super) full_name: String,
    pub(super) fields: Vec<FieldLayout>,
    by_number: HashMap<u32, usize>,
}

/// A field of a message type.
#[derive(Debug, Clone)]
pub(super) struct FieldLayout {
    pub(super) number: u32,
    pub(super) name: String,
    pub(super) repeated: bool,
    /// Declared `optional`: an absent value differs from the default one.
    pub(super) optional: bool,
    pub(super) kind: FieldKind,
}

/// Type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FieldKind {
    Number(NumberKind),
    Text,
    Bytes,
    /// Index into the schema's messages.
    Message(usize),
}

/// Type of a number, which determines its encoding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NumberKind {
    Double,
    Float,
    /// int32, int64, uint32, uint64 and enumerations.
    Varint,
    /// sint32 and sint64.
    ZigZag,
    Bool,
    Fixed32,
    SignedFixed32,
    Fixed64,
}

/// A decoded number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Number {
    Float(f64),
    Int(i64),
    Bool(bool),
}

impl Number {
    pub(super) fn as_f64(self) -> f64 {
        match self {
            Number::Float(value) => value,
            Number::Int(value) => value as f64,
            Number::Bool(value) => f64::from(u8::from(value)),
        }
    }

    pub(super) fn as_i64(self) -> i64 {
        match self {
            Number::Float(value) => value as i64,
            Number::Int(value) => value,
            Number::Bool(value) => i64::from(value),
        }
    }
}

impl NumberKind {
    pub(super) fn is_float(self) -> bool {
        matches!(self, NumberKind::Double | NumberKind::Float)
    }

    /// Decodes an unpacked value.
    pub(super) fn decode(self, field: u32, value: WireValue<'_>) -> Result<Number, ProtobufError> {
        Ok(match (self, value) {
            (NumberKind::Double, WireValue::Fixed64(bytes)) => {
                Number::Float(f64::from_le_bytes(bytes))
            }
            (NumberKind::Float, WireValue::Fixed32(bytes)) => {
                Number::Float(f64::from(f32::from_le_bytes(bytes)))
            }
            (NumberKind::Varint, WireValue::Varint(bits)) => Number::Int(bits as i64),
            (NumberKind::ZigZag, WireValue::Varint(bits)) => {
                Number::Int((bits >> 1) as i64 ^ -((bits & 1) as i64))
            }
            (NumberKind::Bool, WireValue::Varint(bits)) => Number::Bool(bits != 0),
            (NumberKind::Fixed32, WireValue::Fixed32(bytes)) => {
                Number::Int(u32::from_le_bytes(bytes).into())
            }
            (NumberKind::SignedFixed32, WireValue::Fixed32(bytes)) => {
                Number::Int(i32::from_le_bytes(bytes).into())
            }
            (NumberKind::Fixed64, WireValue::Fixed64(bytes)) => {
                Number::Int(i64::from_le_bytes(bytes))
            }
            _ => return Err(ProtobufError::Mismatch(field)),
        })
    }

    /// Calls `visit` with each number of one occurrence of a repeated field, packed or not.
    pub(super) fn decode_repeated(
        self,
        field: u32,
        value: WireValue<'_>,
        mut visit: impl FnMut(Number),
    ) -> Result<(), ProtobufError> {
        let WireValue::Bytes(mut packed) = value else {
            visit(self.decode(field, value)?);
            return Ok(());
        };
        while !packed.is_empty() {
            let value = match self {
                NumberKind::Double | NumberKind::Fixed64 => {
                    WireValue::Fixed64(split_array(&mut packed)?)
                }
                NumberKind::Float | NumberKind::Fixed32 | NumberKind::SignedFixed32 => {
                    WireValue::Fixed32(split_array(&mut packed)?)
                }
                NumberKind::Varint | NumberKind::ZigZag | NumberKind::Bool => {
                    WireValue::Varint(read_varint(&mut packed)?)
                }
            };
            visit(self.decode(field, value)?);
        }
        Ok(())
    }
}

fn split_array<const N: usize>(bytes: &mut &[u8]) -> Result<[u8; N], ProtobufError> {
    let (taken, rest) = bytes.split_first_chunk().ok_or(ProtobufError::Truncated)?;
    *bytes = rest;
    Ok(*taken)
}

impl Schema {
    /// Reads a schema record: the name of the topic's message type and its descriptor set.
    pub(super) fn parse(name: &str, descriptors: &[u8]) -> Result<Self> {
        let files = FileDescriptorSet::decode(descriptors)
            .with_context(|| format!("the schema {name} is no descriptor set"))?;
        let mut declared: Vec<(String, &DescriptorProto)> = Vec::new();
        for file in &files.file {
            for message in &file.message_type {
                collect_types(file.package(), message, &mut declared);
            }
        }
        let indices: HashMap<&str, usize> = declared
            .iter()
            .enumerate()
            .map(|(index, (name, _))| (name.as_str(), index))
            .collect();
        let messages = declared
            .iter()
            .map(|(name, message)| {
                let fields = message.field.iter();
                let fields: Vec<FieldLayout> = fields
                    .filter_map(|field| field_layout(field, name, &indices))
                    .collect();
                let numbers = fields.iter().enumerate();
                MessageLayout {
                    full_name: name.clone(),
                    by_number: numbers
                        .map(|(index, field)| (field.number, index))
                        .collect(),
                    fields,
                }
            })
            .collect();
        let root = *indices
            .get(name)
            .with_context(|| format!("the schema {name} does not declare that message"))?;
        Ok(Schema { messages, root })
    }

    /// The topic's message type.
    pub(super) fn root(&self) -> &MessageLayout {
        &self.messages[self.root]
    }

    pub(super) fn message(&self, index: usize) -> &MessageLayout {
        &self.messages[index]
    }
}

impl MessageLayout {
    pub(super) fn field_by_name(&self, name: &str) -> Option<&FieldLayout> {
        self.fields.iter().find(|field| field.name == name)
    }

    /// Index of the field of that number in `fields`.
    pub(super) fn index_by_number(&self, number: u32) -> Option<usize> {
        self.by_number.get(&number).copied()
    }

    /// True for google.protobuf.Timestamp and Duration: seconds and nanoseconds.
    pub(super) fn is_time(&self) -> bool {
        ["google.protobuf.Timestamp", "google.protobuf.Duration"].contains(&self.full_name.as_str())
    }
}

fn collect_types<'a>(
    scope: &str,
    message: &'a DescriptorProto,
    declared: &mut Vec<(String, &'a DescriptorProto)>,
) {
    let name = match scope {
        "" => message.name().to_owned(),
        scope => format!("{scope}.{}", message.name()),
    };
    for nested in &message.nested_type {
        collect_types(&name, nested, declared);
    }
    declared.push((name, message));
}

/// `None` for types without a representation here: groups, and messages that the schema does not declare.
fn field_layout(
    field: &FieldDescriptorProto,
    scope: &str,
    indices: &HashMap<&str, usize>,
) -> Option<FieldLayout> {
    let kind = match field.r#type() {
        Type::Double => FieldKind::Number(NumberKind::Double),
        Type::Float => FieldKind::Number(NumberKind::Float),
        Type::Int64 | Type::Uint64 | Type::Int32 | Type::Uint32 | Type::Enum => {
            FieldKind::Number(NumberKind::Varint)
        }
        Type::Sint32 | Type::Sint64 => FieldKind::Number(NumberKind::ZigZag),
        Type::Bool => FieldKind::Number(NumberKind::Bool),
        Type::Fixed32 => FieldKind::Number(NumberKind::Fixed32),
        Type::Sfixed32 => FieldKind::Number(NumberKind::SignedFixed32),
        Type::Fixed64 | Type::Sfixed64 => FieldKind::Number(NumberKind::Fixed64),
        Type::String => FieldKind::Text,
        Type::Bytes => FieldKind::Bytes,
        Type::Message => FieldKind::Message(resolve_type(field.type_name(), scope, indices)?),
        Type::Group => return None,
    };
    Some(FieldLayout {
        number: u32::try_from(field.number()).ok()?,
        name: field.name().to_owned(),
        repeated: field.label() == Label::Repeated,
        optional: field.proto3_optional(),
        kind,
    })
}

/// A name with a leading dot is absolute. Others are searched from the innermost scope outwards.
fn resolve_type(name: &str, scope: &str, indices: &HashMap<&str, usize>) -> Option<usize> {
    if let Some(full) = name.strip_prefix('.') {
        return indices.get(full).copied();
    }
    let mut scope = Some(scope);
    while let Some(outer) = scope {
        if let Some(index) = indices.get(format!("{outer}.{name}").as_str()) {
            return Some(*index);
        }
        scope = outer.rsplit_once('.').map(|(outer, _)| outer);
    }
    indices.get(name).copied()
}
