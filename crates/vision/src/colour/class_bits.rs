//! Which of many samples have a class? One bit for each.

use std::ops::Range;

use wide::u8x32;

use crate::colour::lookup_table::ColourClass;

/// Samples of a word.
pub(crate) const WORD: usize = 64;

/// Bits of a range of samples, word by word, the first lowest: set where a sample has the class, clear past the last.
#[inline]
pub(crate) fn class_bits(
    classes: &[ColourClass],
    samples: Range<usize>,
    class: ColourClass,
) -> impl Iterator<Item = u64> + '_ {
    let (words, rest) = classes[samples.clone()].as_chunks::<WORD>();
    let last = (!rest.is_empty()).then(|| match classes[..samples.end].last_chunk() {
        // The rest ends a whole word, which may begin before the range.
        Some(last) => word_bits(last, class) >> (WORD - rest.len()),
        None => {
            let bits = rest.iter().map(|&other| u64::from(other == class));
            bits.rev().fold(0, |word, bit| word << 1 | bit)
        }
    });
    let words = words.iter().map(move |word| word_bits(word, class));
    words.chain(last)
}

#[inline]
fn word_bits(classes: &[ColourClass; WORD], class: ColourClass) -> u64 {
    // A loop, not `map`, which the compiler does not inline for so many.
    let mut levels = [0; WORD];
    for (level, class) in levels.iter_mut().zip(classes) {
        *level = class.0;
    }
    let wanted = u8x32::splat(class.0);
    let (halves, _) = levels.as_chunks::<{ WORD / 2 }>();
    let [low, high] = [0, 1].map(|half| u8x32::from(halves[half]).simd_eq(wanted).to_bitmask());
    u64::from(low) | u64::from(high) << (WORD / 2)
}

/// Number of samples of a class in a range.
pub(crate) fn count_class(
    classes: &[ColourClass],
    samples: Range<usize>,
    class: ColourClass,
) -> usize {
    let words = class_bits(classes, samples, class);
    words.map(|word| word.count_ones() as usize).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_and_counts_are_those_of_single_samples() {
        let classes: Vec<ColourClass> = (0..300u32)
            .map(|index| ColourClass((index * index / 7 % 5) as u8))
            .collect();
        for samples in [0..0, 0..1, 3..34, 0..63, 9..73, 5..70, 100..300] {
            for class in [ColourClass::OTHER, ColourClass::CARPET, ColourClass(200)] {
                let words: Vec<u64> = class_bits(&classes, samples.clone(), class).collect();
                assert_eq!(words.len(), samples.len().div_ceil(WORD));
                let singly = &classes[samples.clone()];
                for index in 0..words.len() * WORD {
                    let bit = words[index / WORD] >> (index % WORD) & 1;
                    assert_eq!(bit == 1, singly.get(index) == Some(&class), "{samples:?}");
                }
                let counted = singly.iter().filter(|&&other| other == class).count();
                assert_eq!(count_class(&classes, samples.clone(), class), counted);
            }
        }
    }
}
