//! Which columns does a message type have? One row per message; field `a.b` becomes column `a_b`.
//!
//! | field | column |
//! | --- | --- |
//! | number of the message itself | f64, i64 or bool |
//! | number in a nested message, or an optional number | f64, NaN where absent |
//! | the same with a name that ends in `_ns` | i64, −1 where absent: f64 would round stamps to 256 ns |
//! | text | text, empty where absent |
//! | repeated field | i64: its length, as `a_count` |
//! | google.protobuf.Timestamp or Duration | f64 seconds, as `a_s`, NaN where absent |
//! | bytes; a message nested in one of its own type | none |

use std::collections::HashMap;

use anyhow::{Context, Result, bail};

use super::layout::{FieldKind, FieldLayout, MessageLayout, NumberKind, Schema};
use super::protobuf::{FieldReader, ProtobufError, WireValue};

/// The values of a column.
#[derive(Debug, Clone, PartialEq)]
pub enum ColumnData {
    /// Floating-point numbers; NaN where absent.
    F64(Vec<f64>),
    /// Integers.
    I64(Vec<i64>),
    /// Truth values.
    Bool(Vec<bool>),
    /// Texts, as indices into the list of distinct texts.
    Text {
        /// Index of each row's text.
        codes: Vec<u32>,
        /// Distinct texts. The first one is empty.
        texts: Vec<String>,
    },
}

/// A column and its name.
pub type Column = (String, ColumnData);

/// Columns of a message type, filled row by row.
pub(super) struct ColumnTable {
    names: Vec<String>,
    data: Vec<ColumnData>,
    /// Value of a column for an absent field, as f64 and as i64.
    missing: Vec<(f64, i64)>,
    text_codes: Vec<HashMap<String, u32>>,
    root: Node,
}

/// How each field of a message is stored. Fields without a column are skipped.
#[derive(Default)]
struct Node {
    /// By ascending field number.
    actions: Vec<(u32, Action)>,
    /// Numbers whose default is 0, not absent, if their message is present.
    defaults: Vec<usize>,
}

enum Action {
    Number {
        column: usize,
        kind: NumberKind,
    },
    Text(usize),
    /// A repeated field: its length, and columns of single elements by their index.
    Repeated {
        count: usize,
        kind: Option<NumberKind>,
        elements: Vec<(i64, usize)>,
    },
    Time(usize),
    Message(Node),
}

impl ColumnTable {
    /// Columns of a message type; `elements`: further columns of single list elements, as `a.b[2]` in column `a_b_2`.
    pub(super) fn new(
        schema: &Schema,
        message: &MessageLayout,
        elements: &[String],
    ) -> Result<Self> {
        let mut table = ColumnTable {
            names: Vec::new(),
            data: Vec::new(),
            missing: Vec::new(),
            text_codes: Vec::new(),
            root: Node::default(),
        };
        table.root = table.build_node(schema, message, "", &mut Vec::new());
        for element in elements {
            table
                .add_element(schema, message, element)
                .with_context(|| format!("invalid element: {element:?} (expected LIST[INDEX])"))?;
        }
        Ok(table)
    }

    fn build_node<'a>(
        &mut self,
        schema: &'a Schema,
        message: &'a MessageLayout,
        prefix: &str,
        above: &mut Vec<&'a str>,
    ) -> Node {
        let mut node = Node::default();
        above.push(&message.full_name);
        for field in &message.fields {
            let name = format!("{prefix}{}", field.name);
            let inside = !prefix.is_empty();
            if let Some(action) = self.build_action(schema, field, name, inside, above) {
                if let Action::Number { column, .. } = action
                    && inside
                    && !field.optional
                {
                    node.defaults.push(column);
                }
                node.actions.push((field.number, action));
            }
        }
        above.pop();
        node.actions.sort_by_key(|(number, _)| *number);
        node
    }

    fn build_action<'a>(
        &mut self,
        schema: &'a Schema,
        field: &FieldLayout,
        name: String,
        inside: bool,
        above: &mut Vec<&'a str>,
    ) -> Option<Action> {
        if field.repeated {
            let kind = match field.kind {
                FieldKind::Number(kind) => Some(kind),
                _ => None,
            };
            return Some(Action::Repeated {
                count: self.add_column(format!("{name}_count"), ColumnData::I64(Vec::new())),
                kind,
                elements: Vec::new(),
            });
        }
        match field.kind {
            FieldKind::Bytes => None,
            FieldKind::Text => {
                let texts = ColumnData::Text {
                    codes: Vec::new(),
                    texts: vec![String::new()],
                };
                Some(Action::Text(self.add_column(name, texts)))
            }
            FieldKind::Number(kind) => {
                let may_be_absent = inside || field.optional;
                let stamp = name.ends_with("_ns") && !kind.is_float();
                let (data, missing) = match kind {
                    _ if stamp && may_be_absent => (ColumnData::I64(Vec::new()), (0.0, -1)),
                    _ if may_be_absent => (ColumnData::F64(Vec::new()), (f64::NAN, 0)),
                    NumberKind::Bool => (ColumnData::Bool(Vec::new()), (0.0, 0)),
                    kind if kind.is_float() => (ColumnData::F64(Vec::new()), (0.0, 0)),
                    _ => (ColumnData::I64(Vec::new()), (0.0, 0)),
                };
                let column = self.add_column(name, data);
                self.missing[column] = missing;
                Some(Action::Number { column, kind })
            }
            FieldKind::Message(index) => {
                let message = schema.message(index);
                if message.is_time() {
                    let column = self.add_column(format!("{name}_s"), ColumnData::F64(Vec::new()));
                    self.missing[column] = (f64::NAN, 0);
                    return Some(Action::Time(column));
                }
                if above.contains(&message.full_name.as_str()) {
                    return None;
                }
                let prefix = format!("{name}_");
                Some(Action::Message(
                    self.build_node(schema, message, &prefix, above),
                ))
            }
        }
    }

    fn add_column(&mut self, name: String, data: ColumnData) -> usize {
        self.names.push(name);
        self.data.push(data);
        self.missing.push((0.0, 0));
        self.text_codes.push(HashMap::new());
        self.names.len() - 1
    }

    fn add_element(
        &mut self,
        schema: &Schema,
        message: &MessageLayout,
        element: &str,
    ) -> Result<()> {
        let (path, index) = element
            .strip_suffix(']')
            .and_then(|rest| rest.split_once('['))
            .context("no [INDEX] at its end")?;
        let index: i64 = index.parse().context("the index is no integer")?;
        let column = self.add_column(
            format!("{}_{index}", path.replace('.', "_")),
            ColumnData::F64(Vec::new()),
        );
        self.missing[column] = (f64::NAN, 0);
        let (mut layout, mut node) = (message, &mut self.root);
        for name in path.split('.') {
            let field = layout
                .field_by_name(name)
                .with_context(|| format!("{} has no field {name}", layout.full_name))?;
            let position = node
                .actions
                .binary_search_by_key(&field.number, |(number, _)| *number);
            let Some((_, action)) = position.ok().and_then(|at| node.actions.get_mut(at)) else {
                bail!("{name} has no columns");
            };
            match (action, field.kind) {
                (Action::Message(inner), FieldKind::Message(index)) => {
                    (layout, node) = (schema.message(index), inner);
                }
                (
                    Action::Repeated {
                        kind: Some(_),
                        elements,
                        ..
                    },
                    _,
                ) => {
                    elements.push((index, column));
                    return Ok(());
                }
                _ => bail!("{name} is no list of numbers"),
            }
        }
        bail!("{path} is no list of numbers")
    }

    /// Appends a row.
    pub(super) fn push(&mut self, message: &[u8]) -> Result<(), ProtobufError> {
        for (data, missing) in self.data.iter_mut().zip(&self.missing) {
            match data {
                ColumnData::F64(values) => values.push(missing.0),
                ColumnData::I64(values) => values.push(missing.1),
                ColumnData::Bool(values) => values.push(false),
                ColumnData::Text { codes, .. } => codes.push(0),
            }
        }
        let mut row = RowWriter {
            data: &mut self.data,
            text_codes: &mut self.text_codes,
        };
        row.fill(&self.root, message)
    }

    pub(super) fn finish(self) -> Vec<Column> {
        self.names.into_iter().zip(self.data).collect()
    }
}

/// Writes into the last row.
struct RowWriter<'a> {
    data: &'a mut [ColumnData],
    text_codes: &'a mut [HashMap<String, u32>],
}

impl RowWriter<'_> {
    fn fill(&mut self, node: &Node, message: &[u8]) -> Result<(), ProtobufError> {
        for &column in &node.defaults {
            match &mut self.data[column] {
                ColumnData::F64(values) => set_last(values, 0.0),
                ColumnData::I64(values) => set_last(values, 0),
                _ => {}
            }
        }
        let mut fields = FieldReader::new(message);
        while let Some((number, value)) = fields.next_field()? {
            let found = node
                .actions
                .binary_search_by_key(&number, |(number, _)| *number);
            if let Ok(at) = found {
                self.apply(&node.actions[at].1, number, value)?;
            }
        }
        Ok(())
    }

    fn apply(
        &mut self,
        action: &Action,
        number: u32,
        value: WireValue<'_>,
    ) -> Result<(), ProtobufError> {
        match (action, value) {
            (Action::Number { column, kind }, value) => {
                let value = kind.decode(number, value)?;
                match &mut self.data[*column] {
                    ColumnData::F64(values) => set_last(values, value.as_f64()),
                    ColumnData::I64(values) => set_last(values, value.as_i64()),
                    ColumnData::Bool(values) => set_last(values, value.as_i64() != 0),
                    ColumnData::Text { .. } => {}
                }
            }
            (Action::Text(column), WireValue::Bytes(bytes)) => self.set_text(*column, bytes)?,
            (
                Action::Repeated {
                    count,
                    kind,
                    elements,
                },
                value,
            ) => {
                let before = self.last_count(*count);
                let mut after = before;
                match kind {
                    None => after += 1,
                    Some(kind) => kind.decode_repeated(number, value, |value| {
                        for (_, column) in elements.iter().filter(|(index, _)| *index == after) {
                            if let ColumnData::F64(values) = &mut self.data[*column] {
                                set_last(values, value.as_f64());
                            }
                        }
                        after += 1;
                    })?,
                }
                if let ColumnData::I64(values) = &mut self.data[*count] {
                    set_last(values, after);
                }
            }
            (Action::Time(column), WireValue::Bytes(bytes)) => {
                let seconds = decode_seconds(bytes)?;
                if let ColumnData::F64(values) = &mut self.data[*column] {
                    set_last(values, seconds);
                }
            }
            (Action::Message(node), WireValue::Bytes(bytes)) => self.fill(node, bytes)?,
            _ => return Err(ProtobufError::Mismatch(number)),
        }
        Ok(())
    }

    fn last_count(&self, column: usize) -> i64 {
        match &self.data[column] {
            ColumnData::I64(values) => values.last().copied().unwrap_or(0),
            _ => 0,
        }
    }

    fn set_text(&mut self, column: usize, bytes: &[u8]) -> Result<(), ProtobufError> {
        let text = std::str::from_utf8(bytes).map_err(|_not_utf8| ProtobufError::Text)?;
        let ColumnData::Text { codes, texts } = &mut self.data[column] else {
            return Ok(());
        };
        let code = match self.text_codes[column].get(text) {
            Some(code) => *code,
            None if text.is_empty() => 0,
            None => {
                let code = texts.len() as u32;
                texts.push(text.to_owned());
                self.text_codes[column].insert(text.to_owned(), code);
                code
            }
        };
        set_last(codes, code);
        Ok(())
    }
}

fn set_last<T>(values: &mut [T], value: T) {
    if let Some(last) = values.last_mut() {
        *last = value;
    }
}

/// Seconds of a google.protobuf.Timestamp or Duration.
pub(super) fn decode_seconds(message: &[u8]) -> Result<f64, ProtobufError> {
    let (mut seconds, mut nanos) = (0i64, 0i64);
    let mut fields = FieldReader::new(message);
    while let Some((number, value)) = fields.next_field()? {
        match (number, value) {
            (1, WireValue::Varint(bits)) => seconds = bits as i64,
            (2, WireValue::Varint(bits)) => nanos = bits as i64,
            _ => {}
        }
    }
    Ok(seconds as f64 + 1e-9 * nanos as f64)
}
