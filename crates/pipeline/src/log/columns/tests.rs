use foxglove::prost_types::field_descriptor_proto::{Label, Type};
use foxglove::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
};
use prost::Message;

use super::layout::Schema;
use super::plan::{ColumnData, ColumnTable};
use super::rows::RowTable;
use super::value::{self, Value};

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
