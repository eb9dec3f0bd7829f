//! Is every decoded message contained in the bytes? Checks that are independent of the decoders' code.
//!
//! The property tests and the fuzz targets call them.

use hw::wire::image_stream::{HEADER_BYTES, ImageHeader};
use hw::wire::vesc_can::{Addressed, VescCommand, VescStatus};
use hw::wire::{CanFrame, StreamDecoder, bno085, board, slcan, vesc, wit};

/// Decodes `bytes` in pieces of `cuts` + 1 bytes (cycled; all at once if empty).
pub(crate) fn decode_in_chunks<M>(
    mut stream: StreamDecoder<M>,
    bytes: &[u8],
    cuts: &[u8],
) -> Vec<M> {
    let mut messages = Vec::new();
    let mut rest = bytes;
    let mut cuts = cuts.iter().cycle();
    while !rest.is_empty() {
        let length = cuts.next().map_or(rest.len(), |cut| usize::from(*cut) + 1);
        let (piece, after) = rest.split_at(length.min(rest.len()));
        stream.extend(piece);
        messages.extend(stream.by_ref());
        rest = after;
    }
    let stats = stream.stats();
    assert_eq!(stats.bytes, bytes.len() as u64);
    assert_eq!(stats.messages, messages.len() as u64);
    assert!(stats.garbage_bytes <= stats.bytes);
    messages
}

/// Asserts that `bytes` contains `frames` in this order without overlap.
fn assert_in_order(bytes: &[u8], frames: &[Vec<u8>]) {
    let mut rest = bytes;
    for frame in frames {
        let at = rest
            .windows(frame.len())
            .position(|window| window == &frame[..]);
        let at = at.unwrap_or_else(|| panic!("{frame:02x?} is not in the stream"));
        rest = &rest[at + frame.len()..];
    }
}

/// CRC-16/XMODEM bit by bit.
fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ (u16::from(*byte) << 8), |crc: u16, _| {
            if crc & 0x8000 == 0 {
                crc << 1
            } else {
                (crc << 1) ^ 0x1021
            }
        })
    })
}

fn sum(bytes: &[u8]) -> u8 {
    (bytes.iter().map(|byte| u32::from(*byte)).sum::<u32>() & 0xFF) as u8
}

/// Base board: every decoded frame is in the stream and has a correct checksum.
pub(crate) fn check_board(bytes: &[u8], cuts: &[u8]) {
    let packets = decode_in_chunks(board::decoder(), bytes, cuts);
    let frames: Vec<_> = packets.iter().map(board::Packet::encode).collect();
    for frame in &frames {
        let mut payload = Vec::new();
        let mut rest = &frame[..];
        while rest[0] != 0 {
            let (block, after) = rest[1..].split_at(usize::from(rest[0]) - 1);
            payload.extend_from_slice(block);
            payload.push(0);
            rest = after;
        }
        payload.pop();
        let (content, checksum) = payload.split_at(payload.len() - 2);
        assert_eq!(checksum, crc16(content).to_le_bytes());
    }
    assert_in_order(bytes, &frames);
}

/// BNO085: the same, except for the three reserved bytes.
pub(crate) fn check_bno085(bytes: &[u8], cuts: &[u8]) {
    let mut rest = bytes;
    for message in decode_in_chunks(bno085::decoder(), bytes, cuts) {
        let head = &message.encode()[..15];
        let matches = |window: &[u8]| window[..15] == *head && sum(&window[2..18]) == window[18];
        let at = rest.windows(19).position(matches);
        rest = &rest[at.unwrap_or_else(|| panic!("{message:?} is not in the stream")) + 19..];
    }
}

/// WitMotion: the same.
pub(crate) fn check_wit(bytes: &[u8], cuts: &[u8]) {
    let messages = decode_in_chunks(wit::decoder(), bytes, cuts);
    let frames: Vec<_> = messages
        .iter()
        .map(|message| message.encode().to_vec())
        .collect();
    for frame in &frames {
        assert_eq!(sum(&frame[..10]), frame[10]);
    }
    assert_in_order(bytes, &frames);
}

/// VESC: the stream contains a packet with each reply's content and a correct checksum.
pub(crate) fn check_vesc(bytes: &[u8], cuts: &[u8]) {
    let mut rest = bytes;
    for reply in decode_in_chunks(vesc::decoder(), bytes, cuts) {
        let matches = |at: usize| {
            let length = usize::from(*rest.get(at + 1)?);
            let payload = rest.get(at + 2..at + 2 + length)?;
            let valid = rest[at] == 2
                && *rest.get(at + length + 4)? == 3
                && rest[at + 2 + length..at + 4 + length] == crc16(payload).to_be_bytes();
            let same = match reply {
                vesc::Reply::Other(command) => payload.first() == Some(&command),
                vesc::Reply::Values(values) => {
                    payload.first() == Some(&4)
                        && payload.get(58) == Some(&values.node)
                        && payload[45..49] == values.tachometer.to_be_bytes()
                        && payload[23..27] == values.erpm.to_be_bytes()
                }
            };
            (valid && same).then_some(at + length + 5)
        };
        let end = (0..rest.len()).find_map(matches);
        rest = &rest[end.unwrap_or_else(|| panic!("{reply:?} is not in the stream"))..];
    }
}

/// slcan: the stream contains each frame's line, in upper or lower case.
pub(crate) fn check_slcan(bytes: &[u8], cuts: &[u8]) {
    let upper = |text: &[u8]| text[1..].to_ascii_uppercase();
    let mut rest = bytes;
    for message in decode_in_chunks(slcan::decoder(), bytes, cuts) {
        let slcan::SlcanMessage::Frame(frame) = message else {
            continue;
        };
        let mut text = Vec::new();
        slcan::encode(&frame, &mut text);
        text.pop();
        let matches = |window: &[u8]| window[0] == text[0] && upper(window) == upper(&text);
        let at = rest.windows(text.len()).position(matches);
        rest = &rest[at.unwrap_or_else(|| panic!("{frame:?} is not in the stream")) + text.len()..];
    }
}

/// Camera socket: an accepted header has the values of its bytes and a correct checksum.
pub(crate) fn check_image_header(bytes: &[u8]) {
    let Some(front) = bytes.first_chunk::<HEADER_BYTES>() else {
        return;
    };
    if let Some(header) = ImageHeader::decode(front) {
        let (content, checksum) = front.split_at(HEADER_BYTES - 2);
        assert_eq!(checksum, crc16(content).to_le_bytes());
        // The bytes after the stamp are reserved.
        assert_eq!(header.encode()[..36], front[..36]);
    }
}

/// CAN: accepted frames round-trip, and so do VESC messages in them.
pub(crate) fn check_can(bytes: &[u8]) {
    let frame = bytes.first_chunk::<16>().and_then(CanFrame::from_socketcan);
    let Some(frame) = frame else { return };
    assert_eq!(CanFrame::from_socketcan(&frame.to_socketcan()), Some(frame));
    if let Some(status) = VescStatus::decode(&frame) {
        let encoded = status.message.encode(status.node);
        assert_eq!(encoded.id, frame.id);
        assert_eq!(VescStatus::decode(&encoded), Some(status));
    }
    if let Some(Addressed { node, message }) = VescCommand::decode(&frame) {
        assert_eq!(message.encode(node), frame);
    }
}
