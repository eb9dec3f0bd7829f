//! How is a damaged input made from a good one? By small random changes, with the same result for the same seed.

use rand::{Rng, RngExt};

/// Values at which lengths and counts break.
const EDGES: [u64; 12] = [
    0,
    1,
    0x7f,
    0x80,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    1 << 40,
    u64::MAX / 2,
    u64::MAX,
];
/// Texts at which parsers of numbers and tables break.
const WORDS: [&str; 14] = [
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-0",
    "99999999999999999999",
    "[",
    "]",
    "\"",
    "\n",
    ",",
    "=",
    "\u{feff}",
    "0x",
];

/// A changed copy of `input`, at most `length_max` bytes long. `other` is a second input to take pieces from.
pub(crate) fn mutate(input: &[u8], other: &[u8], length_max: usize, rng: &mut impl Rng) -> Vec<u8> {
    let mut bytes = input.to_vec();
    for _ in 0..1 << rng.random_range(0..5) {
        change(&mut bytes, other, rng);
    }
    bytes.truncate(length_max);
    bytes
}

fn change(bytes: &mut Vec<u8>, other: &[u8], rng: &mut impl Rng) {
    let place = rng.random_range(0..=bytes.len());
    let rest = bytes.len() - place;
    let length = rng.random_range(0..=rest.min(64));
    match rng.random_range(0..10) {
        0 if rest > 0 => bytes[place] ^= 1 << rng.random_range(0..8),
        1 if rest > 0 => bytes[place] = rng.random(),
        2 => {
            let edge = EDGES[rng.random_range(0..EDGES.len())];
            let size = [1, 2, 4, 8][rng.random_range(0..4)].min(rest);
            let edge = if rng.random() {
                edge
            } else {
                edge.swap_bytes()
            };
            bytes[place..place + size].copy_from_slice(&edge.to_le_bytes()[..size]);
        }
        3 => drop(bytes.drain(place..place + length)),
        4 => {
            let piece = bytes[place..place + length].to_vec();
            let to = rng.random_range(0..=bytes.len());
            bytes.splice(to..to, piece);
        }
        5 => {
            let word = WORDS[rng.random_range(0..WORDS.len())];
            bytes.splice(place..place, word.bytes());
        }
        6 if !other.is_empty() => {
            let from = rng.random_range(0..other.len());
            let to = rng.random_range(from..=other.len().min(from + 256));
            bytes.splice(place..place + length, other[from..to].iter().copied());
        }
        7 => bytes.truncate(place),
        8 => bytes[place..place + length].fill(rng.random()),
        // A text's number.
        _ => {
            let digits = bytes
                .iter()
                .enumerate()
                .filter(|(_, byte)| byte.is_ascii_digit());
            let places: Vec<usize> = digits.map(|(place, _)| place).collect();
            if !places.is_empty() {
                bytes[places[rng.random_range(0..places.len())]] = rng.random_range(b'0'..=b'9');
            }
        }
    }
}
