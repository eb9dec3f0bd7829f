//! How is a record of an MCAP file laid out? An opcode, a length and fields; numbers are little-endian.

use std::collections::BTreeMap;

use mcap::records::op;

/// Size of opcode and length before a record's content, bytes.
pub(super) const RECORD_HEADER_BYTES: usize = 9;

/// A record under construction. Texts, bytes and maps have their length before them.
pub(super) struct RecordEncoder(Vec<u8>);

impl RecordEncoder {
    /// Starts a record with an opcode of [`op`].
    pub(super) fn new(opcode: u8) -> Self {
        let mut bytes = vec![0; RECORD_HEADER_BYTES];
        bytes[0] = opcode;
        RecordEncoder(bytes)
    }

    pub(super) fn u16(mut self, number: u16) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    pub(super) fn u32(mut self, number: u32) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    pub(super) fn u64(mut self, number: u64) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    /// Bytes without a length.
    pub(super) fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend(bytes);
        self
    }

    /// Bytes after a length of 32 bits.
    pub(super) fn bytes(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).raw(bytes)
    }

    pub(super) fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    pub(super) fn text_map(self, map: &BTreeMap<String, String>) -> Self {
        let mut content = RecordEncoder(Vec::new());
        for (key, value) in map {
            content = content.text(key).text(value);
        }
        self.bytes(&content.0)
    }

    /// A number for each channel.
    pub(super) fn channel_map(self, numbers: &[(u16, u64)]) -> Self {
        let mut content = RecordEncoder(Vec::new());
        for &(channel, number) in numbers {
            content = content.u16(channel).u64(number);
        }
        self.bytes(&content.0)
    }

    /// The content so far, without opcode and length.
    pub(super) fn content(&self) -> &[u8] {
        &self.0[RECORD_HEADER_BYTES..]
    }

    /// The record's bytes, if `following` bytes of its content are written after them.
    pub(super) fn finish(mut self, following: usize) -> Vec<u8> {
        let length = (self.0.len() - RECORD_HEADER_BYTES + following) as u64;
        self.0[1..RECORD_HEADER_BYTES].copy_from_slice(&length.to_le_bytes());
        self.0
    }
}

/// Appends a message; `time`: nanoseconds, when it was logged and published.
pub(super) fn append_message(
    bytes: &mut Vec<u8>,
    channel: u16,
    sequence: u32,
    time: u64,
    data: &[u8],
) {
    // Channel, sequence and two times.
    let length = 22 + data.len() as u64;
    bytes.push(op::MESSAGE);
    bytes.extend(length.to_le_bytes());
    bytes.extend(channel.to_le_bytes());
    bytes.extend(sequence.to_le_bytes());
    bytes.extend(time.to_le_bytes());
    bytes.extend(time.to_le_bytes());
    bytes.extend(data);
}
