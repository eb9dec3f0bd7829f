//! Is every message that a decoder yields really in the bytes? Checks that share nothing with the decoders but the layouts.
//!
//! The property tests and the fuzz targets both call these.

use hw::wire::image_stream::{HEADER_BYTES, ImageHeader};
use hw::wire::{CanFrame, StreamDecoder, bno085, board, slcan, vesc, vesc_can, wit};

/// Feeds `bytes` in pieces whose sizes `cuts` gives (cycled; none: all at once) and returns what comes out.
pub(crate) fn decode_in_chunks<M>(
    mut stream: StreamDecoder<M>,
    bytes: &[u8],
    cuts: &[u8],
) -> Vec<M> {
    let mut found = Vec::new();
    let mut rest = bytes;
    let mut cuts = cuts.iter().cycle();
    while !rest.is_empty() {
        let wanted = cuts.next().map_or(rest.len(), |cut| usize::from(*cut) + 1);
        let (piece, after) = rest.split_at(wanted.min(rest.len()));
        stream.extend(piece);
        found.extend(stream.by_ref());
        rest = after;
    }
    let tally = stream.stats();
    assert_eq!(tally.bytes, bytes.len() as u64);
    assert_eq!(tally.messages, found.len() as u64);
    assert!(tally.garbage_bytes <= tally.bytes);
    found
}

/// Asserts that `wanted` follow each other in `bytes` without overlapping.
fn assert_in_order(bytes: &[u8], wanted: &[Vec<u8>]) {
    let mut rest = bytes;
    for frame in wanted {
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

/// Base board: whatever comes out is in the stream, under a right checksum.
pub(crate) fn check_board(bytes: &[u8], cuts: &[u8]) {
    let found = decode_in_chunks(board::decoder(), bytes, cuts);
    let frames: Vec<_> = found.iter().map(board::Packet::encode).collect();
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
        let (said, checksum) = payload.split_at(payload.len() - 2);
        assert_eq!(checksum, crc16(said).to_le_bytes());
    }
    assert_in_order(bytes, &frames);
}

/// BNO085: likewise, up to the three bytes that the sensor reserves.
pub(crate) fn check_bno085(bytes: &[u8], cuts: &[u8]) {
    let mut rest = bytes;
    for message in decode_in_chunks(bno085::decoder(), bytes, cuts) {
        let head = &message.encode()[..15];
        let is_it = |window: &[u8]| window[..15] == *head && sum(&window[2..18]) == window[18];
        let at = rest.windows(19).position(is_it);
        rest = &rest[at.unwrap_or_else(|| panic!("{message:?} is not in the stream")) + 19..];
    }
}

/// WitMotion: likewise.
pub(crate) fn check_wit(bytes: &[u8], cuts: &[u8]) {
    let found = decode_in_chunks(wit::decoder(), bytes, cuts);
    let frames: Vec<_> = found
        .iter()
        .map(|message| message.encode().to_vec())
        .collect();
    for frame in &frames {
        assert_eq!(sum(&frame[..10]), frame[10]);
    }
    assert_in_order(bytes, &frames);
}

/// VESC: each reply has a packet of its command and a right checksum in the stream.
pub(crate) fn check_vesc(bytes: &[u8], cuts: &[u8]) {
    let mut rest = bytes;
    for reply in decode_in_chunks(vesc::decoder(), bytes, cuts) {
        let is_it = |at: usize| {
            let length = usize::from(*rest.get(at + 1)?);
            let payload = rest.get(at + 2..at + 2 + length)?;
            let right = rest[at] == 2
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
            (right && same).then_some(at + length + 5)
        };
        let end = (0..rest.len()).find_map(is_it);
        rest = &rest[end.unwrap_or_else(|| panic!("{reply:?} is not in the stream"))..];
    }
}

/// slcan: each frame's line is in the stream, whatever the case of its digits.
pub(crate) fn check_slcan(bytes: &[u8], cuts: &[u8]) {
    let upper = |text: &[u8]| text[1..].to_ascii_uppercase();
    let mut rest = bytes;
    for line in decode_in_chunks(slcan::decoder(), bytes, cuts) {
        let slcan::SlcanMessage::Frame(frame) = line else {
            continue;
        };
        let mut text = Vec::new();
        slcan::encode(&frame, &mut text);
        text.pop();
        let is_it = |window: &[u8]| window[0] == text[0] && upper(window) == upper(&text);
        let at = rest.windows(text.len()).position(is_it);
        rest = &rest[at.unwrap_or_else(|| panic!("{frame:?} is not in the stream")) + text.len()..];
    }
}

/// Camera socket: a header that is taken says what stands in its bytes, under a right checksum.
pub(crate) fn check_image_header(bytes: &[u8]) {
    let Some(front) = bytes.first_chunk::<HEADER_BYTES>() else {
        return;
    };
    if let Some(header) = ImageHeader::decode(front) {
        let (said, checksum) = front.split_at(HEADER_BYTES - 2);
        assert_eq!(checksum, crc16(said).to_le_bytes());
        // What follows the stamp is for later versions.
        assert_eq!(header.encode()[..36], front[..36]);
    }
}

/// CAN: a frame that is taken survives the way back, and so does what a controller says in it.
pub(crate) fn check_can(bytes: &[u8]) {
    let frame = bytes.first_chunk::<16>().and_then(CanFrame::from_socketcan);
    let Some(frame) = frame else { return };
    assert_eq!(CanFrame::from_socketcan(&frame.to_socketcan()), Some(frame));
    if let Some((node, status)) = vesc_can::VescStatus::decode(&frame) {
        let again = status.encode(node);
        assert_eq!(again.id, frame.id);
        assert_eq!(vesc_can::VescStatus::decode(&again), Some((node, status)));
    }
    if let Some((node, order)) = vesc_can::VescCommand::decode(&frame) {
        assert_eq!(order.encode(node), frame);
    }
}
