//! Which fields does an encoded message have? Decodes protobuf's wire format without the message type.

/// Why bytes cannot be decoded by the schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum ProtobufError {
    /// The message ends inside a field.
    #[error("the message ends inside a field")]
    Truncated,
    /// A field has a wire type that protobuf does not define.
    #[error("field {0} has an undefined wire type")]
    WireType(u32),
    /// A field's wire type differs from the one of its type in the schema.
    #[error("field {0} is not encoded as its schema says")]
    Mismatch(u32),
    /// Messages are nested deeper than `DEPTH_MAX`.
    #[error("messages are nested too deeply")]
    Depth,
    /// A text is not UTF-8.
    #[error("a text is not UTF-8")]
    Text,
}

/// Protobuf's own limit of the nesting depth.
pub(super) const DEPTH_MAX: usize = 100;

/// Encoded value of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum WireValue<'a> {
    Varint(u64),
    Fixed64([u8; 8]),
    Bytes(&'a [u8]),
    Fixed32([u8; 4]),
}

/// Reads the fields of a message in the order in which they are encoded.
pub(super) struct FieldReader<'a> {
    rest: &'a [u8],
}

impl<'a> FieldReader<'a> {
    pub(super) fn new(message: &'a [u8]) -> Self {
        FieldReader { rest: message }
    }

    /// Field number and value; `None` at the end of the message. Groups (deprecated) are skipped.
    pub(super) fn next_field(&mut self) -> Result<Option<(u32, WireValue<'a>)>, ProtobufError> {
        let mut group_depth = 0usize;
        while !self.rest.is_empty() {
            let key = read_varint(&mut self.rest)?;
            let number = u32::try_from(key >> 3).unwrap_or(u32::MAX);
            let value = match key & 7 {
                0 => WireValue::Varint(read_varint(&mut self.rest)?),
                1 => WireValue::Fixed64(self.take_array()?),
                2 => {
                    let length = read_varint(&mut self.rest)?;
                    let length = usize::try_from(length).unwrap_or(usize::MAX);
                    WireValue::Bytes(self.take(length)?)
                }
                3 => {
                    group_depth += 1;
                    continue;
                }
                4 => {
                    group_depth = group_depth
                        .checked_sub(1)
                        .ok_or(ProtobufError::WireType(number))?;
                    continue;
                }
                5 => WireValue::Fixed32(self.take_array()?),
                _ => return Err(ProtobufError::WireType(number)),
            };
            if group_depth == 0 {
                return Ok(Some((number, value)));
            }
        }
        Ok(None)
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], ProtobufError> {
        let (taken, rest) = self
            .rest
            .split_at_checked(length)
            .ok_or(ProtobufError::Truncated)?;
        self.rest = rest;
        Ok(taken)
    }

    fn take_array<const N: usize>(&mut self) -> Result<[u8; N], ProtobufError> {
        let (taken, rest) = self
            .rest
            .split_first_chunk()
            .ok_or(ProtobufError::Truncated)?;
        self.rest = rest;
        Ok(*taken)
    }
}

/// Reads a base-128 varint. Bits beyond the 64th are dropped, as in other decoders.
pub(super) fn read_varint(bytes: &mut &[u8]) -> Result<u64, ProtobufError> {
    let mut value = 0u64;
    for shift in (0..70).step_by(7) {
        let (byte, rest) = bytes.split_first().ok_or(ProtobufError::Truncated)?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f).checked_shl(shift).unwrap_or(0);
        if byte & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(ProtobufError::Truncated)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_every_wire_type_are_read_and_groups_skipped() {
        // 1: varint 150; 2: bytes "ab"; group 3 with a varint inside; 4: fixed32; 5: fixed64.
        let message = [
            0x08, 0x96, 0x01, 0x12, 2, b'a', b'b', 0x1b, 0x08, 1, 0x1c, 0x25, 1, 0, 0, 0, 0x29, 2,
            0, 0, 0, 0, 0, 0, 0,
        ];
        let mut reader = FieldReader::new(&message);
        let mut fields = Vec::new();
        while let Some(field) = reader.next_field().expect("a message") {
            fields.push(field);
        }
        assert_eq!(
            fields,
            [
                (1, WireValue::Varint(150)),
                (2, WireValue::Bytes(b"ab")),
                (4, WireValue::Fixed32([1, 0, 0, 0])),
                (5, WireValue::Fixed64([2, 0, 0, 0, 0, 0, 0, 0])),
            ]
        );
    }

    #[test]
    fn truncated_and_endless_values_are_errors() {
        for message in [&[0x08][..], &[0x12, 5, 1], &[0x25, 1], &[0xff; 11], &[0x1c]] {
            assert!(
                FieldReader::new(message).next_field().is_err(),
                "{message:?}"
            );
        }
    }
}
