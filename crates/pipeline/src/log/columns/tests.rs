use foxglove::prost_types::field_descriptor_proto::{Label, Type};
use foxglove::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
};
use prost::Message;

use std::collections::BTreeMap;

use super::layout::Schema;
use super::plan::{ColumnData, ColumnTable};
use super::rows::RowTable;
use super::value::{self, Value};
use super::{Field, FieldValue, TopicReader};

fn field(name: &str, number: i32, kind: Type) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(Label::Optional as i32),
        r#type: Some(kind as i32),
        ..FieldDescriptorProto::default()
    }
}

fn repeated(field: FieldDescriptorProto) -> FieldDescriptorProto {
    FieldDescriptorProto {
        label: Some(Label::Repeated as i32),
        ..field
    }
}

/// Outer { int64 stamp_ns = 1; string text = 2; Inner inner = 3; repeated Inner items = 4; optional float gain = 5 }
/// Inner { double x = 1; int64 seen_ns = 2; repeated float values = 3; repeated float weights = 4; Outer outer = 5 }
fn schema() -> Schema {
    let typed = |field: FieldDescriptorProto, name: &str| FieldDescriptorProto {
        type_name: Some(name.to_owned()),
        ..field
    };
    let inner = DescriptorProto {
        name: Some("Inner".to_owned()),
        field: vec![
            field("x", 1, Type::Double),
            field("seen_ns", 2, Type::Int64),
            repeated(field("values", 3, Type::Float)),
            repeated(field("weights", 4, Type::Float)),
            typed(field("outer", 5, Type::Message), ".test.Outer"),
        ],
        ..DescriptorProto::default()
    };
    let outer = DescriptorProto {
        name: Some("Outer".to_owned()),
        field: vec![
            field("stamp_ns", 1, Type::Sint64),
            field("text", 2, Type::String),
            typed(field("inner", 3, Type::Message), "Inner"),
            typed(repeated(field("items", 4, Type::Message)), "Inner"),
            FieldDescriptorProto {
                proto3_optional: Some(true),
                ..field("gain", 5, Type::Float)
            },
        ],
        nested_type: vec![inner],
        ..DescriptorProto::default()
    };
    let files = FileDescriptorSet {
        file: vec![FileDescriptorProto {
            package: Some("test".to_owned()),
            message_type: vec![outer],
            ..FileDescriptorProto::default()
        }],
    };
    Schema::parse("test.Outer", &files.encode_to_vec()).expect("a schema")
}

#[derive(Clone, PartialEq, Message)]
struct Inner {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(int64, tag = "2")]
    seen_ns: i64,
    #[prost(float, repeated, tag = "3")]
    values: Vec<f32>,
    #[prost(float, repeated, packed = "false", tag = "4")]
    weights: Vec<f32>,
}

#[derive(Clone, PartialEq, Message)]
struct Outer {
    #[prost(sint64, tag = "1")]
    stamp_ns: i64,
    #[prost(string, tag = "2")]
    text: String,
    #[prost(message, optional, tag = "3")]
    inner: Option<Inner>,
    #[prost(message, repeated, tag = "4")]
    items: Vec<Inner>,
    #[prost(float, optional, tag = "5")]
    gain: Option<f32>,
}

const EPOCH_NS: i64 = 1_700_000_000_123_456_789;

fn messages() -> [Outer; 2] {
    let inner = Inner {
        x: 0.0,
        seen_ns: EPOCH_NS,
        values: vec![1.0, 2.0],
        weights: vec![0.5],
    };
    [
        Outer {
            stamp_ns: -1,
            text: "a".to_owned(),
            inner: Some(inner.clone()),
            items: vec![inner.clone(), Inner::default()],
            gain: Some(0.25),
        },
        Outer::default(),
    ]
}

#[test]
fn absent_values_are_nan_and_stamps_keep_every_nanosecond() {
    let schema = schema();
    let elements = ["inner.values[1]".to_owned()];
    let mut table = ColumnTable::new(&schema, schema.root(), &elements).expect("columns");
    for message in messages() {
        table.push(&message.encode_to_vec()).expect("a row");
    }
    let columns = table.finish();
    let names: Vec<&str> = columns.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(
        names,
        [
            "stamp_ns",
            "text",
            "inner_x",
            "inner_seen_ns",
            "inner_values_count",
            "inner_weights_count",
            "items_count",
            "gain",
            "inner_values_1"
        ]
    );
    let column = |name: &str| {
        &columns
            .iter()
            .find(|(known, _)| known == name)
            .expect(name)
            .1
    };
    let floats = |name: &str| match column(name) {
        ColumnData::F64(values) => values.clone(),
        other => panic!("{name}: {other:?}"),
    };
    assert_eq!(column("stamp_ns"), &ColumnData::I64(vec![-1, 0]));
    assert_eq!(
        column("inner_seen_ns"),
        &ColumnData::I64(vec![EPOCH_NS, -1])
    );
    assert_eq!(column("inner_values_count"), &ColumnData::I64(vec![2, 0]));
    assert_eq!(column("inner_weights_count"), &ColumnData::I64(vec![1, 0]));
    assert_eq!(column("items_count"), &ColumnData::I64(vec![2, 0]));
    for (name, value) in [("inner_x", 0.0), ("gain", 0.25), ("inner_values_1", 2.0)] {
        let values = floats(name);
        assert_eq!(values[0], value, "{name}");
        assert!(values[1].is_nan(), "{name}");
    }
    let ColumnData::Text { codes, texts } = column("text") else {
        panic!("no text");
    };
    let texts: Vec<&str> = codes
        .iter()
        .map(|code| texts[*code as usize].as_str())
        .collect();
    assert_eq!(texts, ["a", ""]);
}

#[test]
fn list_entries_become_rows() {
    let schema = schema();
    let mut entries = RowTable::new(&schema, schema.root(), "items").expect("rows");
    let mut lists = RowTable::new(&schema, schema.root(), "inner").expect("rows");
    for (time, message) in messages().iter().enumerate() {
        entries
            .push(&message.encode_to_vec(), time as u64)
            .expect("rows");
        lists
            .push(&message.encode_to_vec(), time as u64)
            .expect("rows");
    }
    let (times, columns) = entries.finish();
    assert_eq!(times, [0, 0]);
    assert_eq!(
        columns[1],
        ("seen_ns".to_owned(), ColumnData::I64(vec![EPOCH_NS, 0]))
    );
    let (times, columns) = lists.finish();
    assert_eq!(times, [0, 0]);
    assert_eq!(
        columns[0],
        ("values".to_owned(), ColumnData::F64(vec![1.0, 2.0]))
    );
    let ColumnData::F64(weights) = &columns[1].1 else {
        panic!("no numbers");
    };
    assert!(weights[0] == 0.5 && weights[1].is_nan());
    assert!(RowTable::new(&schema, schema.root(), "text").is_err());
}

#[test]
fn messages_decode_to_their_values() {
    let schema = schema();
    let fields = value::decode(&schema, schema.root(), &messages()[0].encode_to_vec());
    let fields = fields.expect("a message");
    assert_eq!(fields[0], ("stamp_ns".to_owned(), Value::Int(-1)));
    let Value::Message(inner) = &fields[2].1 else {
        panic!("no message: {fields:?}");
    };
    assert_eq!(inner[2].1, Value::Floats(vec![1.0, 2.0]));
    assert_eq!(inner[4].1, Value::Absent);
    let empty = value::decode(&schema, schema.root(), &[]).expect("a message");
    assert_eq!((&empty[2].1, &empty[4].1), (&Value::Absent, &Value::Absent));
}

#[test]
fn damaged_messages_are_errors() {
    let schema = schema();
    let mut table = ColumnTable::new(&schema, schema.root(), &[]).expect("columns");
    let message = messages()[0].encode_to_vec();
    assert!(table.push(&message[..message.len() - 1]).is_err());
    for element in ["inner", "inner.values", "inner.x[0]", "none[0]", "items[0]"] {
        assert!(
            ColumnTable::new(&schema, schema.root(), &[element.to_owned()]).is_err(),
            "{element}"
        );
    }
}

/// A file of another program: a topic of JSON, and one in an encoding that is not read.
fn write_json_log(path: &std::path::Path) {
    let file = std::fs::File::create(path).expect("a file");
    let mut writer = mcap::Writer::new(std::io::BufWriter::new(file)).expect("a writer");
    let json = writer
        .add_channel(0, "/other/state", "json", &BTreeMap::new())
        .expect("a channel");
    let cdr = writer
        .add_channel(0, "/other/cdr", "cdr", &BTreeMap::new())
        .expect("a channel");
    for number in 0..3u32 {
        let header = |channel_id| mcap::records::MessageHeader {
            channel_id,
            sequence: number,
            log_time: u64::from(number) * 1_000_000_000,
            publish_time: 0,
        };
        let text = format!(
            r#"{{"speed": {number}.5, "on": true, "name": "n{number}", "list": [1, {{"x": {number}}}], "none": null}}"#
        );
        writer
            .write_to_known_channel(&header(json), text.as_bytes())
            .expect("written");
        writer
            .write_to_known_channel(&header(cdr), &[0, 1])
            .expect("written");
    }
    writer.finish().expect("closed");
}

#[test]
fn json_fields_of_any_program_are_listed_and_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("other.mcap");
    write_json_log(&path);
    let log = TopicReader::open_any(&path).expect("a log");
    assert_eq!(
        log.field_paths(),
        [
            "/other/state.list.length",
            "/other/state.list[0]",
            "/other/state.list[1].x",
            "/other/state.name",
            "/other/state.on",
            "/other/state.speed",
        ]
    );
    let last = |path: &str| {
        let field = Field::find(log.topics(), path).expect("a field");
        let topics = [field.topic().to_owned()];
        let messages = log.chunk_messages(0, &topics, &(0..u64::MAX));
        let message = messages.expect("messages").pop().expect("a message");
        field.read(&message).expect("a value")
    };
    assert_eq!(last("/other/state.speed"), FieldValue::Number(2.5));
    assert_eq!(last("/other/state.on"), FieldValue::Number(1.0));
    assert_eq!(last("/other/state.list[1].x"), FieldValue::Number(2.0));
    assert_eq!(last("/other/state.list.length"), FieldValue::Number(2.0));
    assert_eq!(last("/other/state.name"), FieldValue::Text("n2".to_owned()));
    assert_eq!(last("/other/state.list[7]"), FieldValue::Absent);
    let error = |path: &str| format!("{:#}", Field::find(log.topics(), path).expect_err(path));
    assert!(error("/other/cdr.x").contains("cdr, not protobuf"));
    assert!(error("/nothing.x").contains("no topic"));
}

#[test]
fn each_listed_field_of_a_log_is_read_as_its_column_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.mcap");
    crate::testing::record(&path, 12, &crate::log::LogConfig::default());
    let log = TopicReader::open(&path).expect("a log");
    let everything = 0..u64::MAX;
    let mut compared = 0;
    for path in log.field_paths() {
        let field = Field::find(log.topics(), &path).unwrap_or_else(|e| panic!("{path}: {e:#}"));
        let name = path[field.topic().len() + 1..].replace(['.', '['], "_");
        let (name, elements) = (
            name.replace(']', ""),
            element_of(&path[field.topic().len() + 1..]),
        );
        let Ok((_, columns)) = log.columns(field.topic(), &elements, &everything, || Ok(())) else {
            continue;
        };
        let name = name
            .strip_suffix("_length")
            .map_or(name.clone(), |list| format!("{list}_count"));
        let Some((_, ColumnData::F64(column))) = columns.iter().find(|(column, _)| *column == name)
        else {
            continue;
        };
        let mut values = Vec::new();
        for chunk in 0..log.chunk_count() {
            let topics = [field.topic().to_owned()];
            for message in log
                .chunk_messages(chunk, &topics, &everything)
                .expect("messages")
            {
                values.push(match field.read(&message).expect("a value") {
                    FieldValue::Number(value) => value,
                    _ => f64::NAN,
                });
            }
        }
        assert_eq!(values.len(), column.len(), "{path}");
        for (value, column) in values.iter().zip(column) {
            let equal = value.to_bits() == column.to_bits() || value.is_nan() && column.is_nan();
            assert!(equal, "{path}: {value} is not {column}");
        }
        compared += 1;
    }
    assert!(compared > 100, "{compared}");
}

/// The element of a list at the end of a path, as `TopicReader::columns` takes it.
fn element_of(path: &str) -> Vec<String> {
    let is_element = path.ends_with(']') && path.matches('[').count() == 1;
    is_element.then(|| path.to_owned()).into_iter().collect()
}
