//! Which columns does a list in a message have? One row per entry of the list.

use anyhow::{Context, Result, bail};

use super::layout::{FieldKind, MessageLayout, NumberKind, Schema};
use super::plan::{Column, ColumnData, ColumnTable};
use super::protobuf::{FieldReader, ProtobufError, WireValue};

/// Entries of a repeated message, or of parallel lists of numbers in one message.
pub(super) struct RowTable {
    /// Field numbers that lead to the list.
    path: Vec<u32>,
    entries: Entries,
    /// Log time of each row's message.
    times: Vec<u64>,
}

enum Entries {
    Messages(ColumnTable),
    /// Field number, type and values of each list.
    Lists(Vec<ListColumn>),
}

struct ListColumn {
    number: u32,
    name: String,
    kind: NumberKind,
    values: Vec<f64>,
}

impl RowTable {
    /// `field`: dotted name of the list, such as `points` or `team.mates`.
    pub(super) fn new(schema: &Schema, root: &MessageLayout, field: &str) -> Result<Self> {
        let (mut layout, mut path, mut repeated) = (root, Vec::new(), false);
        for name in field.split('.') {
            if repeated {
                bail!("{field}: a list inside a list has no rows");
            }
            let found = layout
                .field_by_name(name)
                .with_context(|| format!("{} has no field {name}", layout.full_name))?;
            let FieldKind::Message(index) = found.kind else {
                bail!("{field} is neither a list of messages nor a message of lists");
            };
            (layout, repeated) = (schema.message(index), found.repeated);
            path.push(found.number);
        }
        let entries = if repeated {
            Entries::Messages(ColumnTable::new(schema, layout, &[])?)
        } else {
            let lists = layout.fields.iter().filter(|field| field.repeated);
            let lists = lists.filter_map(|field| match field.kind {
                FieldKind::Number(kind) => Some(ListColumn {
                    number: field.number,
                    name: field.name.clone(),
                    kind,
                    values: Vec::new(),
                }),
                _ => None,
            });
            Entries::Lists(lists.collect())
        };
        Ok(RowTable {
            path,
            entries,
            times: Vec::new(),
        })
    }

    /// Appends the rows of a message.
    pub(super) fn push(&mut self, message: &[u8], log_time: u64) -> Result<(), ProtobufError> {
        let path = std::mem::take(&mut self.path);
        let pushed = self.descend(&path, message, log_time);
        self.path = path;
        pushed
    }

    fn descend(&mut self, path: &[u32], message: &[u8], time: u64) -> Result<(), ProtobufError> {
        let Some((first, rest)) = path.split_first() else {
            return self.push_entry(message, time);
        };
        let mut fields = FieldReader::new(message);
        while let Some((number, value)) = fields.next_field()? {
            if let (true, WireValue::Bytes(inner)) = (number == *first, value) {
                self.descend(rest, inner, time)?;
            }
        }
        Ok(())
    }

    fn push_entry(&mut self, message: &[u8], time: u64) -> Result<(), ProtobufError> {
        let lists = match &mut self.entries {
            Entries::Messages(table) => {
                table.push(message)?;
                self.times.push(time);
                return Ok(());
            }
            Entries::Lists(lists) => lists,
        };
        let mut fields = FieldReader::new(message);
        while let Some((number, value)) = fields.next_field()? {
            if let Some(list) = lists.iter_mut().find(|list| list.number == number) {
                let values = &mut list.values;
                list.kind
                    .decode_repeated(number, value, |number| values.push(number.as_f64()))?;
            }
        }
        // Shorter lists are padded with NaN, so that rows stay aligned.
        let longest = lists.iter().map(|list| list.values.len()).max();
        let length = longest.unwrap_or(0).max(self.times.len());
        for list in lists {
            list.values.resize(length, f64::NAN);
        }
        self.times.resize(length, time);
        Ok(())
    }

    /// Log times and columns.
    pub(super) fn finish(self) -> (Vec<u64>, Vec<Column>) {
        let columns = match self.entries {
            Entries::Messages(table) => table.finish(),
            Entries::Lists(lists) => lists
                .into_iter()
                .map(|list| (list.name, ColumnData::F64(list.values)))
                .collect(),
        };
        (self.times, columns)
    }
}
