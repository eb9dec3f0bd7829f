//! Which key was pressed? A terminal sends one byte for a letter, and sequences of bytes for arrows, function keys, Alt and the mouse.

use localize::Stamp;

/// Time after which the rest of a sequence does not come any more, seconds: the Escape key alone was pressed.
const SEQUENCE_TIME: f64 = 0.5;
/// Longest parameters of a sequence that are kept, bytes.
const PARAMETERS_MAX: usize = 16;
/// End of a pasted text.
const PASTE_END: &[u8] = b"\x1b[201~";

/// A pressed key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Key {
    /// A letter, digit, sign or control character of ASCII.
    Character(u8),
    Up,
    Down,
    Left,
    Right,
    /// Escape, alone or as the begin of a sequence, or a character beyond ASCII.
    Other,
}

/// Finds the keys in a terminal's bytes.
#[derive(Debug, Default)]
pub(super) struct KeyDecoder {
    sequence: Sequence,
    last_byte: Option<Stamp>,
}

/// The sequence whose begin has come.
#[derive(Debug, Default)]
enum Sequence {
    #[default]
    None,
    /// Escape.
    Escape,
    /// Escape \[ and the parameters so far.
    Control(Vec<u8>),
    /// Escape O: an arrow of a terminal in application mode.
    Application,
    /// So many bytes more, whatever they are.
    Skipped(usize),
    /// A pasted text, of whose end so many bytes have come.
    Pasted(usize),
}

impl KeyDecoder {
    /// The key that `byte` completes. Keys with Alt, function keys, the mouse and pasted text are none.
    pub(super) fn decode(&mut self, byte: u8, now: Stamp) -> Option<Key> {
        let last = self.last_byte.replace(now);
        if last.is_some_and(|last| now - last > SEQUENCE_TIME) {
            self.sequence = Sequence::None;
        }
        let sequence = std::mem::take(&mut self.sequence);
        let (next, key) = sequence.advance(byte);
        self.sequence = next;
        key
    }
}

impl Sequence {
    fn advance(self, byte: u8) -> (Sequence, Option<Key>) {
        const ESCAPE: u8 = 0x1b;
        match (self, byte) {
            (Sequence::Skipped(bytes), _) if bytes > 1 => (Sequence::Skipped(bytes - 1), None),
            (Sequence::Skipped(_), _) => (Sequence::None, None),
            (Sequence::Pasted(matched), _) => (Self::after_pasted(matched, byte), None),
            (Sequence::None, ESCAPE) => (Sequence::Escape, Some(Key::Other)),
            (_, ESCAPE) => (Sequence::Escape, None),
            (Sequence::None, 0x80..) => (Sequence::None, Some(Key::Other)),
            (Sequence::None, _) => (Sequence::None, Some(Key::Character(byte))),
            (Sequence::Escape, b'[') => (Sequence::Control(Vec::new()), None),
            (Sequence::Escape, b'O') => (Sequence::Application, None),
            // A key with Alt.
            (Sequence::Escape, _) => (Sequence::None, None),
            (Sequence::Application, _) => (Sequence::None, arrow(byte)),
            (Sequence::Control(mut parameters), 0x20..=0x3f) => {
                if parameters.len() < PARAMETERS_MAX {
                    parameters.push(byte);
                }
                (Sequence::Control(parameters), None)
            }
            (Sequence::Control(parameters), _) => match (&parameters[..], byte) {
                ([], b'A'..=b'D') => (Sequence::None, arrow(byte)),
                // A mouse event: button, column and row.
                ([], b'M') => (Sequence::Skipped(3), None),
                // A function key of the Linux console.
                ([], b'[') => (Sequence::Skipped(1), None),
                (b"200", b'~') => (Sequence::Pasted(0), None),
                _ => (Sequence::None, None),
            },
        }
    }

    fn after_pasted(matched: usize, byte: u8) -> Sequence {
        let matched = match PASTE_END.get(matched) {
            Some(expected) if *expected == byte => matched + 1,
            _ => usize::from(byte == PASTE_END[0]),
        };
        if matched == PASTE_END.len() {
            Sequence::None
        } else {
            Sequence::Pasted(matched)
        }
    }
}

fn arrow(byte: u8) -> Option<Key> {
    match byte {
        b'A' => Some(Key::Up),
        b'B' => Some(Key::Down),
        b'C' => Some(Key::Right),
        b'D' => Some(Key::Left),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(bytes: &[u8]) -> Vec<Key> {
        let mut decoder = KeyDecoder::default();
        let decoded = bytes
            .iter()
            .filter_map(|byte| decoder.decode(*byte, Stamp(0)));
        decoded.collect()
    }

    #[test]
    fn sequences_of_special_keys_contain_no_letters() {
        for (bytes, expected) in [
            (&b"\x1b[A"[..], Some(Key::Up)),
            (b"\x1b[B", Some(Key::Down)),
            (b"\x1b[C", Some(Key::Right)),
            (b"\x1bOD", Some(Key::Left)),
            (b"\x1b[1;5A", None),
            (b"\x1b[24~", None),
            (b"\x1b[3~", None),
            (b"\x1b[[A", None),
            (b"\x1bOP", None),
            (b"\x1bw", None),
            (b"\x1b[200~wasted \x1b[ 201~ \x1b[201~", None),
            (b"\x1b[Mq !", None),
            (b"\x1b[<0;10;20M", None),
        ] {
            let mut all = vec![Key::Other];
            all.extend(expected);
            // The key after it is read as usual.
            all.push(Key::Character(b'w'));
            assert_eq!(keys(&[bytes, b"w"].concat()), all, "{bytes:?}");
        }
        assert_eq!(keys("ë".as_bytes()), [Key::Other; 2]);
    }

    #[test]
    fn letter_long_after_the_escape_key_is_a_letter() {
        let mut decoder = KeyDecoder::default();
        assert_eq!(decoder.decode(0x1b, Stamp(0)), Some(Key::Other));
        let later = Stamp::from_seconds(1.0);
        assert_eq!(decoder.decode(b'w', later), Some(Key::Character(b'w')));
    }
}
