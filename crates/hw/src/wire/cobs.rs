//! How does a zero byte mark the end of a frame? Consistent overhead byte stuffing (Cheshire & Baker 1999).
//!
//! For payloads of up to 253 bytes: the overhead is one byte, and no block of 254 bytes without a zero can occur.

/// Appends the encoding of `payload`, which has no zeros and is one byte longer.
pub(crate) fn encode(payload: &[u8], frame: &mut Vec<u8>) {
    debug_assert!(payload.len() < 254);
    for block in payload.split(|byte| *byte == 0) {
        frame.push(block.len() as u8 + 1);
        frame.extend_from_slice(block);
    }
}

/// Decodes a frame (without its final zero) to the front of `payload` and returns the payload's length.
///
/// `None` if the frame contains a zero, is truncated, or decodes to more bytes than `payload` has.
pub(crate) fn decode(frame: &[u8], payload: &mut [u8]) -> Option<usize> {
    let mut length = 0;
    let mut rest = frame;
    while let Some((code, after)) = rest.split_first() {
        let block = after.get(..usize::from(*code).checked_sub(1)?)?;
        if block.contains(&0) {
            return None;
        }
        payload
            .get_mut(length..length + block.len())?
            .copy_from_slice(block);
        length += block.len();
        rest = &after[block.len()..];
        if !rest.is_empty() {
            *payload.get_mut(length)? = 0;
            length += 1;
        }
    }
    (!frame.is_empty()).then_some(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_matches_examples_of_the_cobs_paper() {
        for (payload, frame) in [
            (&[][..], &[1][..]),
            (&[0], &[1, 1]),
            (&[0, 0], &[1, 1, 1]),
            (&[0x11, 0x22, 0, 0x33], &[3, 0x11, 0x22, 2, 0x33]),
            (&[0x11, 0, 0, 0], &[2, 0x11, 1, 1, 1]),
        ] {
            let mut encoded = Vec::new();
            encode(payload, &mut encoded);
            assert_eq!(encoded, frame);
            let mut decoded = [9; 8];
            let length = decode(frame, &mut decoded).expect("a payload");
            assert_eq!(&decoded[..length], payload);
        }
    }

    #[test]
    fn truncated_zero_containing_or_oversized_frames_are_rejected() {
        let mut payload = [0; 4];
        for frame in [&[][..], &[3, 1], &[0, 1], &[3, 1, 0], &[6, 1, 2, 3, 4, 5]] {
            assert_eq!(decode(frame, &mut payload), None, "{frame:?}");
        }
    }
}
