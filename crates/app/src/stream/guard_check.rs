//! What does the guard make of a client's bytes? The same steps as for a connection, without one, for fuzzing.

use super::config::StreamConfig;
use super::frame_meter::FrameMeter;
use super::handshake_request::{check_origin, head_length};

/// Takes the bytes of a client in pieces of `piece_bytes` (at least 1). Returns the reason for which it would be
/// disconnected, or how far it came.
pub fn check_client_bytes(bytes: &[u8], piece_bytes: usize) -> String {
    let mut end = 0;
    let head_bytes = loop {
        match head_length(&bytes[..end]) {
            Ok(Some(head_bytes)) => break head_bytes,
            Ok(None) if end == bytes.len() => return "no complete request".to_owned(),
            Ok(None) => end = bytes.len().min(end + piece_bytes.max(1)),
            Err(error) => return error.to_string(),
        }
    };
    let (head, rest) = bytes.split_at(head_bytes);
    if let Err(error) = check_origin(head, &StreamConfig::default().origins) {
        return error.to_string();
    }
    let mut meter = FrameMeter::default();
    for piece in rest.chunks(piece_bytes.max(1)) {
        if let Err(error) = meter.feed(piece) {
            return error.to_string();
        }
    }
    if meter.is_between_messages() {
        "between messages".to_owned()
    } else {
        "within a message".to_owned()
    }
}
