//! How is a message encoded? CDR, little-endian: each number aligned to its size, counted from behind the four header bytes.

use std::fmt::Display;

use serde::ser::{self, Serialize};

/// Little-endian CDR without options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Why a value has no CDR encoding. The messages of this program all have one.
#[derive(Debug, thiserror::Error)]
#[error("no CDR encoding: {0}")]
pub(crate) struct CdrError(String);

/// The bytes of a message, header included.
pub(crate) fn encode(message: &impl Serialize) -> Result<Vec<u8>, CdrError> {
    let mut writer = Writer {
        bytes: HEADER.to_vec(),
    };
    message.serialize(&mut writer)?;
    Ok(writer.bytes)
}

struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    fn put<const N: usize>(&mut self, value: [u8; N]) {
        let start = (self.bytes.len() - HEADER.len()).next_multiple_of(N) + HEADER.len();
        self.bytes.resize(start, 0);
        self.bytes.extend_from_slice(&value);
    }

    fn put_length(&mut self, length: usize) -> Result<(), CdrError> {
        let length = u32::try_from(length)
            .map_err(|error| CdrError(format!("{length} elements: {error}")))?;
        self.put(length.to_le_bytes());
        Ok(())
    }
}

impl ser::Error for CdrError {
    fn custom<T: Display>(text: T) -> Self {
        CdrError(text.to_string())
    }
}

fn unsupported<T>(what: &str) -> Result<T, CdrError> {
    Err(CdrError(format!("{what} do not occur in ROS messages")))
}

macro_rules! numbers {
    ($($name:ident: $kind:ty),*) => {$(
        fn $name(self, value: $kind) -> Result<(), CdrError> {
            self.put(value.to_le_bytes());
            Ok(())
        }
    )*};
}

impl<'a> ser::Serializer for &'a mut Writer {
    type Ok = ();
    type Error = CdrError;
    type SerializeSeq = &'a mut Writer;
    type SerializeTuple = &'a mut Writer;
    type SerializeTupleStruct = &'a mut Writer;
    type SerializeStruct = &'a mut Writer;
    type SerializeTupleVariant = ser::Impossible<(), CdrError>;
    type SerializeMap = ser::Impossible<(), CdrError>;
    type SerializeStructVariant = ser::Impossible<(), CdrError>;

    numbers! {
        serialize_i8: i8, serialize_i16: i16, serialize_i32: i32, serialize_i64: i64,
        serialize_u8: u8, serialize_u16: u16, serialize_u32: u32, serialize_u64: u64,
        serialize_f32: f32, serialize_f64: f64
    }

    fn serialize_bool(self, value: bool) -> Result<(), CdrError> {
        self.serialize_u8(value.into())
    }

    fn serialize_str(self, value: &str) -> Result<(), CdrError> {
        // The length counts the NUL behind the text.
        self.put_length(value.len() + 1)?;
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(0);
        Ok(())
    }

    fn serialize_bytes(self, value: &[u8]) -> Result<(), CdrError> {
        self.put_length(value.len())?;
        self.bytes.extend_from_slice(value);
        Ok(())
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<Self, CdrError> {
        match length {
            Some(length) => self.put_length(length)?,
            None => return unsupported("sequences of unknown length"),
        }
        Ok(self)
    }

    fn serialize_tuple(self, _length: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_tuple_struct(self, _name: &str, _length: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_struct(self, _name: &str, _length: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _name: &str,
        value: &T,
    ) -> Result<(), CdrError> {
        value.serialize(self)
    }

    fn serialize_char(self, _value: char) -> Result<(), CdrError> {
        unsupported("single characters")
    }

    fn serialize_none(self) -> Result<(), CdrError> {
        unsupported("optional values")
    }

    fn serialize_some<T: Serialize + ?Sized>(self, _value: &T) -> Result<(), CdrError> {
        unsupported("optional values")
    }

    fn serialize_unit(self) -> Result<(), CdrError> {
        Ok(())
    }

    fn serialize_unit_struct(self, _name: &str) -> Result<(), CdrError> {
        Ok(())
    }

    fn serialize_unit_variant(self, _: &str, _: u32, _: &str) -> Result<(), CdrError> {
        unsupported("enumerations")
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &str,
        _: u32,
        _: &str,
        _: &T,
    ) -> Result<(), CdrError> {
        unsupported("enumerations")
    }

    fn serialize_tuple_variant(
        self,
        _: &str,
        _: u32,
        _: &str,
        _: usize,
    ) -> Result<Self::SerializeTupleVariant, CdrError> {
        unsupported("enumerations")
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Self::SerializeMap, CdrError> {
        unsupported("maps")
    }

    fn serialize_struct_variant(
        self,
        _: &str,
        _: u32,
        _: &str,
        _: usize,
    ) -> Result<Self::SerializeStructVariant, CdrError> {
        unsupported("enumerations")
    }
}

impl ser::SerializeSeq for &mut Writer {
    type Ok = ();
    type Error = CdrError;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}

impl ser::SerializeTuple for &mut Writer {
    type Ok = ();
    type Error = CdrError;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}

impl ser::SerializeTupleStruct for &mut Writer {
    type Ok = ();
    type Error = CdrError;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}

impl ser::SerializeStruct for &mut Writer {
    type Ok = ();
    type Error = CdrError;

    fn serialize_field<T: Serialize + ?Sized>(
        &mut self,
        _name: &'static str,
        value: &T,
    ) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}
