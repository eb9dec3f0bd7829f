//! How large is what a client sends? WebSocket frames (RFC 6455) are measured while they pass.

use std::time::Duration;

/// Largest message of a client, bytes, over all its fragments: it subscribes to topics and sets parameters.
pub(super) const MESSAGE_BYTES_MAX: u64 = 256 * 1024;
/// Longest time from the first byte of a message to its last.
pub(super) const MESSAGE_TIME_MAX: Duration = Duration::from_secs(10);
/// Largest payload of a control frame, bytes (RFC 6455, 5.5).
const CONTROL_BYTES_MAX: u64 = 125;
/// Largest header: two bytes, a length of eight, a mask of four.
const HEADER_BYTES_MAX: usize = 14;

/// Why a connection is closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum FrameError {
    #[error("a message of more than {MESSAGE_BYTES_MAX} bytes")]
    MessageTooLong,
    #[error("an invalid control frame")]
    Control,
}

/// Measures the frames of one client.
#[derive(Debug, Default)]
pub(super) struct FrameMeter {
    header: [u8; HEADER_BYTES_MAX],
    header_bytes: usize,
    /// Bytes of the current frame's payload that are still to come.
    payload_left: u64,
    /// Bytes of the current message in its frames so far.
    message_bytes: u64,
    /// True from the first frame of a message of several until its last.
    fragmented: bool,
}

impl FrameMeter {
    /// Measures the next bytes of the client.
    pub(super) fn feed(&mut self, mut bytes: &[u8]) -> Result<(), FrameError> {
        while !bytes.is_empty() {
            if self.payload_left > 0 {
                let passed = self.payload_left.min(bytes.len() as u64);
                self.payload_left -= passed;
                bytes = &bytes[passed as usize..];
                continue;
            }
            self.header[self.header_bytes] = bytes[0];
            self.header_bytes += 1;
            bytes = &bytes[1..];
            if let Some(length) = self.payload_length() {
                self.begin_payload(length)?;
            }
        }
        Ok(())
    }

    /// True between the messages of the client.
    pub(super) fn is_between_messages(&self) -> bool {
        self.payload_left == 0 && self.header_bytes == 0 && !self.fragmented
    }

    /// Length of the payload, once the header is complete.
    fn payload_length(&self) -> Option<u64> {
        let header = &self.header[..self.header_bytes];
        let [_, second, rest @ ..] = header else {
            return None;
        };
        let mask_bytes = if second & 0x80 != 0 { 4 } else { 0 };
        let length_bytes = match second & 0x7F {
            126 => 2,
            127 => 8,
            _ => 0,
        };
        if rest.len() < length_bytes + mask_bytes {
            return None;
        }
        let long = rest[..length_bytes]
            .iter()
            .fold(0, |length, byte| (length << 8) | u64::from(*byte));
        Some(match length_bytes {
            0 => u64::from(second & 0x7F),
            _ => long,
        })
    }

    fn begin_payload(&mut self, length: u64) -> Result<(), FrameError> {
        let (is_final, opcode) = (self.header[0] & 0x80 != 0, self.header[0] & 0x0F);
        self.header_bytes = 0;
        if opcode >= 8 {
            if length > CONTROL_BYTES_MAX || !is_final {
                return Err(FrameError::Control);
            }
        } else {
            self.message_bytes = self.message_bytes.saturating_add(length);
            if self.message_bytes > MESSAGE_BYTES_MAX {
                return Err(FrameError::MessageTooLong);
            }
            self.fragmented = !is_final;
            if is_final {
                self.message_bytes = 0;
            }
        }
        self.payload_left = length;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A masked frame.
    fn frame(is_final: bool, opcode: u8, length: usize) -> Vec<u8> {
        let mut bytes = vec![opcode | if is_final { 0x80 } else { 0 }];
        match length {
            0..126 => bytes.push(0x80 | length as u8),
            126..65_536 => {
                bytes.push(0x80 | 126);
                bytes.extend((length as u16).to_be_bytes());
            }
            _ => {
                bytes.push(0x80 | 127);
                bytes.extend((length as u64).to_be_bytes());
            }
        }
        bytes.extend([1, 2, 3, 4]);
        bytes.extend(vec![0; length]);
        bytes
    }

    #[test]
    fn messages_are_measured_in_any_cut_and_with_control_frames_between_fragments() {
        let stream = [
            frame(true, 1, 5),
            frame(false, 2, 70_000),
            frame(true, 9, 3),
            frame(true, 0, 300),
            frame(true, 1, 0),
        ]
        .concat();
        for cut in [1, 2, 7, 1000, stream.len()] {
            let mut meter = FrameMeter::default();
            assert!(meter.is_between_messages());
            for (index, part) in stream.chunks(cut).enumerate() {
                assert_eq!(meter.feed(part), Ok(()), "part {index} of {cut} bytes");
            }
            assert!(meter.is_between_messages());
        }
        let mut meter = FrameMeter::default();
        meter.feed(&frame(false, 1, 5)).expect("short");
        assert!(!meter.is_between_messages(), "the message is not finished");
    }

    #[test]
    fn long_messages_are_rejected_before_their_bytes_come() {
        let mut meter = FrameMeter::default();
        let header = &frame(true, 2, MESSAGE_BYTES_MAX as usize + 1)[..14];
        assert_eq!(meter.feed(header), Err(FrameError::MessageTooLong));
        // Many small fragments of one message that never ends.
        let mut meter = FrameMeter::default();
        let fragment = frame(false, 0, 60_000);
        let accepted = (0..100)
            .take_while(|_| meter.feed(&fragment).is_ok())
            .count();
        assert_eq!(accepted as u64, MESSAGE_BYTES_MAX / 60_000);
        let mut meter = FrameMeter::default();
        assert_eq!(meter.feed(&frame(true, 9, 126)), Err(FrameError::Control));
        assert_eq!(
            FrameMeter::default().feed(&[
                0x82, 0xFF, 255, 255, 255, 255, 255, 255, 255, 255, 0, 0, 0, 0
            ]),
            Err(FrameError::MessageTooLong)
        );
    }
}
