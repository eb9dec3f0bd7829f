//! Weighted sums of the three bytes of pixels, 32 pixels at a time.
//!
//! The compiler sorts the bytes into planes first, which takes longer than the sums.

use wide::bytemuck::cast;
use wide::{i16x16, u8x32, u16x16, u32x8};

/// Pixels and bytes at a time.
const BLOCK: usize = 32;
const BLOCK_BYTES: usize = 3 * BLOCK;

/// Weights of the bytes of a pixel in their order, of 256 in all.
#[derive(Clone, Copy)]
pub(crate) struct RgbWeights {
    weights: [u16; 3],
    /// For the first and third byte of each pixel, and for the second.
    outer: i16x16,
    middle: i16x16,
}

impl RgbWeights {
    pub(crate) fn new(weights: [u16; 3]) -> Self {
        let [first, second, third] = weights.map(|weight| weight as i16);
        let pairs = |pair: [i16; 2]| i16x16::from(std::array::from_fn(|lane| pair[lane % 2]));
        RgbWeights {
            weights,
            outer: pairs([first, third]),
            middle: pairs([second, 0]),
        }
    }

    /// Weights pixels of three bytes, one value for each.
    pub(crate) fn weigh(&self, bytes: &[u8], values: &mut [u8]) {
        let (blocks, rest) = values.as_chunks_mut::<BLOCK>();
        let is_whole = rest.is_empty();
        for (values, bytes) in blocks.iter_mut().zip(bytes.as_chunks().0) {
            *values = self.weigh_block(bytes);
        }
        if is_whole {
            return;
        }
        // The rest ends a whole block, part of which was weighted before.
        if let (Some(values), Some(bytes)) = (values.last_chunk_mut(), bytes.last_chunk()) {
            *values = self.weigh_block(bytes);
            return;
        }
        for (value, pixel) in values.iter_mut().zip(bytes.as_chunks().0) {
            *value = self.weigh_pixel(pixel);
        }
    }

    fn weigh_pixel(&self, pixel: &[u8; 3]) -> u8 {
        let products = pixel.iter().zip(self.weights);
        let sum: u16 = products
            .map(|(&byte, weight)| u16::from(byte) * weight)
            .sum();
        (sum >> 8) as u8
    }

    #[inline(always)]
    fn weigh_block(&self, bytes: &[u8; BLOCK_BYTES]) -> [u8; BLOCK] {
        // Groups of four pixels, one in each half of a vector. The last one ends where the block ends.
        let a = self.sums(bytes, [0, 48], WORDS);
        let b = self.sums(bytes, [12, 60], WORDS);
        let c = self.sums(bytes, [24, 72], WORDS);
        let d = self.sums(bytes, [36, 80], LAST_WORDS);
        let upper = u32x8::splat(0xff00);
        // Byte k of word j of a half is the value of pixel j in group k.
        let values: u8x32 =
            cast(a >> 8u32 | b & upper | (c & upper) << 8u32 | (d & upper) << 16u32);
        values
            .swizzle_half_relaxed(u8x32::from(TRANSPOSED))
            .to_array()
    }

    /// Weighted sums of eight pixels; `starts`: first bytes of the vector's halves, `words`: places of the pixels in them.
    #[inline(always)]
    fn sums(&self, bytes: &[u8; BLOCK_BYTES], starts: [usize; 2], words: [u8; 32]) -> u32x8 {
        let mut halves = [0; 32];
        halves[..16].copy_from_slice(&bytes[starts[0]..][..16]);
        halves[16..].copy_from_slice(&bytes[starts[1]..][..16]);
        let words = u8x32::from(halves).swizzle_half_relaxed(u8x32::from(words));
        let pairs: u16x16 = cast(words);
        let outer: i16x16 = cast(pairs & u16x16::splat(0xff));
        let middle: i16x16 = cast(pairs >> 8u32);
        cast(outer.dot(self.outer) + middle.dot(self.middle))
    }
}

/// Marks a byte that becomes zero.
const ZERO: u8 = u8::MAX;
/// Spreads three bytes each of four pixels over words of four.
const WORDS: [u8; 32] = spread([0, 0]);
/// The upper half's pixels begin at its fifth byte.
const LAST_WORDS: [u8; 32] = spread([0, 4]);

const fn spread(starts: [u8; 2]) -> [u8; 32] {
    let mut places = [ZERO; 32];
    let mut at = 0;
    while at < places.len() {
        let (pixel, byte) = (at % 16 / 4, at % 4);
        if byte < 3 {
            places[at] = starts[at / 16] + (3 * pixel + byte) as u8;
        }
        at += 1;
    }
    places
}

/// Transposes the four by four bytes of each half.
const TRANSPOSED: [u8; 32] = {
    let mut places = [0; 32];
    let mut at = 0;
    while at < places.len() {
        places[at] = (at % 4 * 4 + at % 16 / 4) as u8;
        at += 1;
    }
    places
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_of_pixels_are_weighted_as_single_ones() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        let mut bytes: Vec<u8> = (0..3 * 150).map(|_| random()).collect();
        bytes[..90].fill(u8::MAX);
        for weights in [[77, 150, 29], [256, 0, 0], [0, 0, 256], [0, 255, 1]] {
            let weights = RgbWeights::new(weights);
            for pixels in [0, 4, 28, 32, 36, 64, 100, 150] {
                let mut values = vec![0; pixels];
                weights.weigh(&bytes[..3 * pixels], &mut values);
                let single = bytes
                    .as_chunks()
                    .0
                    .iter()
                    .map(|pixel| weights.weigh_pixel(pixel));
                assert!(single.take(pixels).eq(values.iter().copied()), "{pixels}");
            }
        }
    }
}
