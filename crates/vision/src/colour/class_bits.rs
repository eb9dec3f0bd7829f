//! Which of many samples have a class? One bit for each.

use wide::u8x32;

use crate::colour::lookup_table::ColourClass;

/// Samples of a word.
pub(crate) const WORD: usize = 64;

/// Bits of samples, word by word, the first lowest: set where a sample has the class, clear past the last.
#[inline]
pub(crate) fn class_bits(
    classes: &[ColourClass],
    class: ColourClass,
) -> impl Iterator<Item = u64> + '_ {
    let (words, rest) = classes.as_chunks::<WORD>();
    let last = (!rest.is_empty()).then(|| match classes.last_chunk() {
        // The rest ends a whole word, part of which was read before.
        Some(last) => word_bits(last, class) >> (WORD - rest.len()),
        None => rest
            .iter()
            .rev()
            .fold(0, |bits, &other| bits << 1 | u64::from(other == class)),
    });
    words
        .iter()
        .map(move |word| word_bits(word, class))
        .chain(last)
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

/// Number of samples of a class.
pub(crate) fn count_class(classes: &[ColourClass], class: ColourClass) -> usize {
    let words = class_bits(classes, class);
    words.map(|word| word.count_ones() as usize).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_and_counts_are_those_of_single_samples() {
        let classes: Vec<ColourClass> = (0..200u32)
            .map(|index| ColourClass((index * index / 7 % 5) as u8))
            .collect();
        for length in [0, 1, 31, 63, 64, 65, 200] {
            let classes = &classes[..length];
            for class in [ColourClass::OTHER, ColourClass::CARPET, ColourClass(200)] {
                let words: Vec<u64> = class_bits(classes, class).collect();
                assert_eq!(words.len(), length.div_ceil(WORD));
                for (index, bit) in (0..words.len() * WORD)
                    .map(|at| words[at / WORD] >> (at % WORD) & 1)
                    .enumerate()
                {
                    let expected = classes.get(index) == Some(&class);
                    assert_eq!(bit == 1, expected, "{length} {index}");
                }
                let counted = classes.iter().filter(|&&other| other == class).count();
                assert_eq!(count_class(classes, class), counted);
            }
        }
    }
}
