//! How does JSON state the numbers of a message? By the JSON mapping of proto3: a number may be a text, as 64-bit ones are, and
//! null is the default.

use std::fmt;

use serde::de::{Deserializer, Error, Unexpected, Visitor};

/// A value of a field that is no message.
enum Scalar {
    Null,
    Flag(bool),
    Integer(i128),
    Float(f64),
    Text(String),
}

struct ScalarVisitor;

impl Visitor<'_> for ScalarVisitor {
    type Value = Scalar;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a text with a number, true, false or null")
    }

    fn visit_unit<E: Error>(self) -> Result<Scalar, E> {
        Ok(Scalar::Null)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<Scalar, E> {
        Ok(Scalar::Flag(value))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Scalar, E> {
        Ok(Scalar::Integer(value.into()))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Scalar, E> {
        Ok(Scalar::Integer(value.into()))
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Scalar, E> {
        Ok(Scalar::Float(value))
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<Scalar, E> {
        Ok(Scalar::Text(value.to_owned()))
    }
}

impl Scalar {
    fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ScalarVisitor)
    }

    fn unexpected<E: Error>(&self, expected: &'static str) -> E {
        let found = match self {
            Scalar::Null => Unexpected::Unit,
            Scalar::Flag(value) => Unexpected::Bool(*value),
            Scalar::Integer(_) => Unexpected::Other("another number"),
            Scalar::Float(value) => Unexpected::Float(*value),
            Scalar::Text(text) => Unexpected::Str(text),
        };
        E::invalid_value(found, &expected)
    }
}

/// A whole number.
pub(super) fn integer<'de, D: Deserializer<'de>, T: TryFrom<i128>>(
    deserializer: D,
) -> Result<T, D::Error> {
    // Every whole f64 of this range is exact as i128.
    let whole = |value: f64| (value.fract() == 0.0 && value.abs() < 1e30).then_some(value as i128);
    let scalar = Scalar::read(deserializer)?;
    let value = match &scalar {
        Scalar::Null => Some(0),
        Scalar::Integer(value) => Some(*value),
        Scalar::Float(value) => whole(*value),
        Scalar::Text(text) => {
            let exact = text.parse::<i128>().ok();
            exact.or_else(|| text.parse::<f64>().ok().and_then(whole))
        }
        Scalar::Flag(_) => None,
    };
    let value = value.and_then(|value| T::try_from(value).ok());
    value.ok_or_else(|| scalar.unexpected("a whole number of the field's range"))
}

/// A number; "NaN", "Infinity" and "-Infinity" are numbers, too.
pub(super) fn float<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    let scalar = Scalar::read(deserializer)?;
    match &scalar {
        Scalar::Null => Ok(0.0),
        Scalar::Integer(value) => Ok(*value as f32),
        Scalar::Float(value) => Ok(*value as f32),
        Scalar::Text(text) => text
            .parse()
            .map_err(|_no_number| scalar.unexpected("a number")),
        Scalar::Flag(_) => Err(scalar.unexpected("a number")),
    }
}

/// True or false.
pub(super) fn flag<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    match Scalar::read(deserializer)? {
        Scalar::Null => Ok(false),
        Scalar::Flag(value) => Ok(value),
        other => Err(other.unexpected("true or false")),
    }
}

#[cfg(test)]
mod tests {
    use crate::datagram::message::{Command, Drive, Kick};

    fn read(text: &str) -> Result<Command, serde_json::Error> {
        serde_json::from_str(text)
    }

    #[test]
    fn json_of_protobuf_libraries_is_read() {
        // As MessageToJson of the Python library writes it, with its own names and with those of the document.
        let camel = r#"{"version": 1, "session": "18446744073709551615", "sequence": "7", "validMs": 80.0,
            "drive": {"x": 0.5}, "kick": {"speed": 3.0, "lofted": true}, "needsPose": true, "boot": "77", "robot": 4,
            "stateNs": "-9223372036854775808"}"#;
        let expected = Command {
            version: 1,
            session: u64::MAX,
            sequence: 7,
            valid_ms: 80.0,
            drive: Some(Drive {
                x: 0.5,
                ..Drive::default()
            }),
            kick: Some(Kick {
                speed: 3.0,
                lofted: true,
            }),
            needs_pose: true,
            boot: 77,
            robot: 4,
            state_ns: i64::MIN,
        };
        assert_eq!(read(camel).expect("read"), expected);
        let snake = camel
            .replace("validMs", "valid_ms")
            .replace("needsPose", "needs_pose")
            .replace("stateNs", "state_ns");
        assert_eq!(read(&snake).expect("read"), expected);
        assert_eq!(
            read(&serde_json::to_string(&expected).expect("written")).expect("read"),
            expected
        );
    }

    #[test]
    fn absent_and_null_are_the_default_and_unknown_keys_are_ignored() {
        let nulls = r#"{"version": null, "session": null, "sequence": null, "valid_ms": null, "drive": null, "kick": null,
            "needs_pose": null, "boot": null, "robot": null, "state_ns": null}"#;
        for text in ["{}", nulls, r#"{"comment": [1, {"x": 2}]}"#] {
            assert_eq!(read(text).expect("read"), Command::default(), "{text}");
        }
        let drive = read(r#"{"drive": {"x": "1.5", "y": null, "z": 3}}"#).expect("read");
        assert_eq!(drive.drive.map(|drive| drive.x), Some(1.5));
        let numbers = read(r#"{"version": 1.0, "session": 1e3, "valid_ms": "NaN"}"#).expect("read");
        assert_eq!((numbers.version, numbers.session), (1, 1000));
        assert!(numbers.valid_ms.is_nan());
    }

    #[test]
    fn values_of_another_kind_or_range_are_refused() {
        for text in [
            r#"{"version": -1}"#,
            r#"{"version": 4294967296}"#,
            r#"{"session": 1.5}"#,
            r#"{"session": 1e20}"#,
            r#"{"session": "one"}"#,
            r#"{"session": true}"#,
            r#"{"valid_ms": "long"}"#,
            r#"{"valid_ms": [80]}"#,
            r#"{"drive": 1}"#,
            r#"{"needs_pose": 1}"#,
        ] {
            assert!(read(text).is_err(), "{text}");
        }
    }
}
